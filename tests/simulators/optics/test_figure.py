"""The figure: shape, shadows, and what truth says of its normals."""

import numpy as np
import pytest

from simulators.lens import rays, sample_points
from tests.reference.triangles import Triangles


@pytest.fixture(scope="module")
def here(pose):
    return pose(sample="figure")


@pytest.fixture(scope="module")
def scene(studio):
    return studio.scene("figure")


@pytest.fixture(scope="module")
def hits(studio, scene):
    camera = studio.layout.cameras["front"]
    return scene.trace(camera.rig_from_camera[:3, 3], rays(camera, sample_points(camera, 1)))


@pytest.mark.parametrize("camera", ["front", "cam7"])
def test_true_normals_are_those_of_the_true_points(optics, here, camera):
    """Against the cross product of differences between neighbouring pixels' points, away from outlines."""
    points = np.load(optics.truth("points", here, camera=camera)["path"])
    normals = np.load(optics.truth("normals", here, camera=camera)["path"])
    axes = optics.layout.cameras[camera].rig_from_camera[:3, :3]
    right, down = points[1:-1, 2:] - points[1:-1, :-2], points[2:, 1:-1] - points[:-2, 1:-1]
    measured = np.cross(down, right) @ axes * [1, -1, -1]
    size = np.linalg.norm(measured, axis=-1, keepdims=True)
    inside = (size[..., 0] < 4 * np.nanmedian(size)) & np.isfinite(normals[1:-1, 1:-1]).all(axis=-1)
    cosine = np.einsum("nk,nk->n", (measured / size)[inside], normals[1:-1, 1:-1][inside])
    error_deg = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    assert inside.sum() > 2000
    # differences of central pixels are off by their curvature over two pixels, 0.6 to 1 mm
    assert np.median(error_deg) < 0.5
    assert np.quantile(error_deg, 0.95) < 3


def test_true_normals_face_the_camera_and_leave_out_the_card(optics, here):
    normals = np.load(optics.truth("normals", here, camera="front")["path"])
    seen = np.isfinite(normals[..., 0])
    np.testing.assert_allclose(np.linalg.norm(normals[seen], axis=-1), 1, atol=1e-6)
    assert np.quantile(normals[seen][:, 2], 0.01) > -0.05
    rows, columns = np.nonzero(seen)
    upper, left = rows < np.median(rows), columns < np.median(columns)
    assert normals[seen][upper, 1].mean() > 0.2 > -0.2 > normals[seen][~upper, 1].mean()
    assert normals[seen][left, 0].mean() < -0.2 < 0.2 < normals[seen][~left, 0].mean()
    points = np.load(optics.truth("points", here, camera="front")["path"])
    radius = np.linalg.norm(points, axis=-1)
    np.testing.assert_array_equal(seen, radius < 0.0451)
    assert np.count_nonzero(radius > 0.0451) > 1000  # the card


def test_there_is_truth_of_normals_for_bodies_alone(optics, pose):
    with pytest.raises(ValueError, match="'brick' is neither sphere nor figure"):
        optics.truth("normals", pose(sample="brick"), camera="front")


def test_of_the_glazed_sphere_they_are_the_spheres(optics, pose):
    here = pose(sample="sphere-glaze")
    points = np.load(optics.truth("points", here, camera="cam3")["path"])
    normals = np.load(optics.truth("normals", here, camera="cam3")["path"])
    seen = np.isfinite(normals[..., 0])
    turned = points[seen] / 0.05 @ optics.layout.cameras["cam3"].rig_from_camera[:3, :3] * [1, -1, -1]
    np.testing.assert_allclose(normals[seen], turned, atol=1e-6)


def test_it_shades_itself_where_a_triangle_is_in_the_way(scene, hits):
    body = np.flatnonzero(scene.card.on_body(hits.points))
    source = np.array([0.3, 0.5, 0.2])
    lit = scene.lit(hits, source)[body]
    starts = (hits.points + scene.body.offset_m * hits.normals)[body]
    facing = np.einsum("nk,nk->n", source - starts, hits.normals[body]) > 0
    assert 0.02 < np.mean(facing & ~lit) < 0.5  # cast shadows, not attached ones
    referee = Triangles(scene.body.mesh.vertices[scene.body.mesh.faces])
    some = np.flatnonzero(facing)[:: facing.sum() // 60]
    free = np.array([not len(referee.crossings(start, 0.3 * (source - start))) for start in starts[some]])
    assert np.mean(free == lit[some]) >= 0.98


def test_the_card_beside_it_is_seen_and_lit(studio, scene, hits):
    card = ~scene.card.on_body(hits.points)
    assert card.sum() > 1000
    assert scene.lit(hits, np.array([0.6, 0.0, 0.0]))[card].all()
    np.testing.assert_allclose(hits.material.albedo[card], studio.layout.sphere.card_albedo)


def test_it_is_as_large_as_it_says_glossy_in_places_and_textured(scene):
    mesh = scene.body.mesh
    assert np.linalg.norm(mesh.vertices, axis=1).max() == pytest.approx(0.045, rel=1e-6)
    assert np.linalg.norm(mesh.vertices, axis=1).min() > 0.015
    roughness, albedo = mesh.surface[:, 4], mesh.surface[:, :3]
    assert np.mean(roughness < 0.4) > 0.1
    assert np.mean(roughness > 0.55) > 0.1
    assert albedo.std(axis=0).min() > 0.05
    assert 0 < albedo.min() < albedo.max() < 0.9


def test_lamps_draw_it(optics, here, pose):
    lit = optics.rate("cam5", pose(sample="figure", lamps=(("lamp4", 1.0),)))
    dark = optics.rate("cam5", here)
    assert np.mean(lit > 10 * dark) > 0.1
