"""Samples that are no height fields: rays against a referee that tries all triangles, and what a body must be."""

import numpy as np
import pytest

from simulators.layout import HolderLayout, direction
from simulators.samples.grass import grass_mesh
from simulators.samples.peanut import peanut_mesh
from simulators.samples.pipe import pipe_mesh
from simulators.samples.weave import weave_mesh
from simulators.studio import Studio
from tests.reference.triangles import Triangles

HOLDER = HolderLayout()
PERIOD_M = HOLDER.opening_m - 2 * HOLDER.margin_m
DEPTH_M = 1.05 * HOLDER.depth_m
MESHES = {"weave": weave_mesh, "peanut": peanut_mesh, "grass": grass_mesh, "pipe": pipe_mesh}


@pytest.fixture(scope="module", params=MESHES)
def name(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def scene(studio, name):
    return studio.scene(name)


@pytest.fixture(scope="module")
def sample(scene):
    return scene.sample


@pytest.fixture(scope="module")
def referee(sample) -> Triangles:
    return Triangles(sample.mesh.vertices[sample.mesh.faces])


def _ways_in(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Ways from all over the reference plane to under the opening's bottom, up to 75 deg from upright."""
    rng = np.random.default_rng(seed)
    starts = np.column_stack([rng.uniform(-0.03, 0.03, (count, 2)), np.zeros(count)])
    slope, azimuth = np.tan(rng.uniform(0, np.radians(75), count)), rng.uniform(-np.pi, np.pi, count)
    down = np.column_stack([slope * np.cos(azimuth), slope * np.sin(azimuth), -np.ones(count)])
    return starts, down * DEPTH_M


def _camera_rays(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays from one eye onto the sample."""
    rng = np.random.default_rng(seed)
    eye = direction(rng.uniform(-3, 3), rng.uniform(0.3, 1.5))
    way = np.column_stack([rng.uniform(-0.028, 0.028, (count, 2)), np.full(count, -0.001)]) - eye
    return eye, way / np.linalg.norm(way, axis=1, keepdims=True)


def test_first_hits_are_those_of_all_triangles_tried(sample, referee):
    starts, ways = _ways_in(150, 1)
    hits = sample.trace(starts, ways)
    found = np.full(len(starts), np.inf)
    found[hits.ray] = np.linalg.norm(hits.points - starts[hits.ray], axis=1) / np.linalg.norm(ways[hits.ray], axis=1)
    expected = np.array([referee.first_crossing(*ray) for ray in zip(starts, ways, strict=True)])
    assert (
        np.isclose(found, expected, rtol=0, atol=5e-8 / DEPTH_M).mean() >= 0.99
    )  # of rays that graze an edge the two may hit different triangles
    beside = np.cross(hits.points - starts[hits.ray], ways[hits.ray]) / np.linalg.norm(ways[hits.ray], axis=1)[:, None]
    assert np.abs(beside).max() < 1e-7


def test_shadows_are_those_of_all_triangles_tried(scene, sample, referee):
    hits = scene.trace(*_camera_rays(80, 2))
    source = 0.9 * direction(2.0, np.radians(40))
    lit = scene.lit(hits, source)
    starts = hits.points + sample.offset_m * hits.normals
    ways = source - starts
    facing = np.einsum("nk,nk->n", ways, hits.normals) > 0
    ends = ways * np.minimum(-starts[:, 2:] / ways[:, 2:], 1.0)  # nothing stands above the reference plane
    free = np.array([not len(referee.crossings(*way)) for way in zip(starts, ends, strict=True)])
    inside = (np.abs(starts + ends) <= HOLDER.opening_m / 2).all(axis=1)  # past the walls
    np.testing.assert_array_less(0.1, [lit.mean(), 1 - lit.mean()])
    assert np.mean(lit == (facing & free & inside)) >= 0.98


def test_normals_look_out_of_the_bodies(scene):
    """To the side that was hit, but for the rounding of facets near the outline of a body."""
    eye, way = _camera_rays(4000, 3)
    hits = scene.trace(eye, way)
    np.testing.assert_allclose(np.linalg.norm(hits.normals, axis=1), 1, atol=1e-6)
    toward = -np.einsum("nk,nk->n", hits.normals, way[hits.ray])
    assert np.mean(toward > 0) > 0.97
    assert np.quantile(toward, 0.001) > -0.6


def test_smooth_normals_are_near_those_of_the_facets(sample):
    """Where the surface turns sharply, at the edges of blades and between plies, they lie between two facets'."""
    corners = sample.mesh.vertices[sample.mesh.faces]
    facets = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(facets, axis=1)
    cosine = np.einsum("nk,njk->n", facets, sample.mesh.normals[sample.mesh.faces]) / area / 3
    assert np.mean(cosine > 0) > 0.995
    assert np.average(cosine, weights=area) > np.cos(np.radians(20))


def test_one_place_has_several_heights_and_bodies_are_closed(name, referee):
    """Straight down, a ray leaves every body that it enters, and ends in the ground: no height field, no open seam."""
    starts, _ = _ways_in(300, 4)
    down = np.array([0.0, 0.0, -DEPTH_M])
    layers = np.array([len(referee.crossings(start, down)) for start in starts])
    assert np.mean(layers >= 3) > 0.2
    assert np.mean(layers % 2 == 1) > 0.99  # the others meet an edge, which is two triangles'
    # Yarns and shells press each other in a little, blades are rooted in the soil and brush through each other.
    nested = np.mean([referee.nesting(start, down) > 1 for start in starts])
    assert nested < (0.15 if name == "grass" else 0.05)


def test_a_slanting_ray_sees_what_hides_from_above(sample):
    """Points that slanting rays hit and over which something else lies."""
    starts, ways = _ways_in(4000, 5)
    hits = sample.trace(starts, ways)
    inside = (np.abs(hits.points[:, :2]) < 0.029).all(axis=1)
    above = hits.points[inside] * [1, 1, 0]
    top = sample.trace(above, np.tile([0.0, 0.0, -DEPTH_M], (len(above), 1)))
    assert np.mean(top.points[:, 2] > hits.points[inside, 2] + 1e-4) > 0.05


def test_a_period_further_everything_is_the_same(sample):
    starts, ways = _ways_in(2000, 6)
    starts[:, :2] = -0.0295 + 0.005 * (starts[:, :2] + 0.03) / 0.06  # beyond one edge, with room for its copies
    ways = ways * [0.05, 0.05, 1.0]
    for shift in ([PERIOD_M, 0, 0], [0, PERIOD_M, 0], [PERIOD_M, PERIOD_M, 0]):
        here, there = sample.trace(starts, ways), sample.trace(starts + shift, ways)
        np.testing.assert_array_equal(here.ray, there.ray)
        same = np.linalg.norm(here.points + shift - there.points, axis=1) < 2e-8  # a few of float32's roundings
        assert same.mean() > 0.995  # the others graze an edge
        close = np.isclose(here.material.albedo, there.material.albedo, atol=1e-3).all(axis=1)
        assert np.mean(close | ~same) == 1.0


def test_bodies_stay_in_their_box_and_cover_the_floor(sample):
    heights = sample.mesh.vertices[:, 2]
    assert heights.min() == pytest.approx(-HOLDER.depth_m, abs=1e-8)
    assert -0.0008 < heights.max() < -0.0001
    starts, ways = _ways_in(3000, 7)
    inside = (np.abs(starts[:, :2] + ways[:, :2]) < HOLDER.opening_m / 2).all(axis=1)
    assert np.isin(np.flatnonzero(inside), sample.trace(starts, ways).ray).all()


def test_surfaces_are_plausible_and_vary(sample):
    values = sample.mesh.surface
    assert 0.01 < values[:, :3].min() <= values[:, :3].max() < 0.9
    assert values[:, :3].std(axis=0).min() > 0.03
    assert 0 <= values[:, 3].min() <= values[:, 3].max() < 0.15
    assert 0.2 < values[:, 4].min() <= values[:, 4].max() <= 1


def test_the_seed_makes_the_sample(name, sample, optics):
    other = MESHES[name](HOLDER, 2)
    again = optics._studio.scene(name).sample.mesh
    for what in ("vertices", "faces", "normals", "surface"):
        np.testing.assert_array_equal(getattr(again, what), getattr(sample.mesh, what))
    assert other.vertices.shape != again.vertices.shape or np.any(other.vertices != again.vertices)


def test_the_true_displacement_leads_to_the_first_triangle(optics, studio, pose, name, referee):
    texels = 10
    here = pose(sample=name, turntable_rad=0.7)
    depth = np.load(optics.truth("displacement", here, camera="cam3", texels=texels)["path"]).ravel()
    grid = (np.arange(texels) + 0.5) / texels * PERIOD_M - PERIOD_M / 2
    x, y = np.meshgrid(grid, -grid)
    start = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    eye = studio.to_scene(here, optics.layout.cameras["cam3"].rig_from_camera[:3, 3])
    way = (start - eye) / np.linalg.norm(start - eye, axis=1, keepdims=True)
    end = start + depth[:, None] * way
    inside = (np.abs(end[:, :2]) < HOLDER.opening_m / 2 - 1e-9).all(axis=1)
    reach = 0.008
    expected = [reach * referee.first_crossing(*ray) for ray in zip(start[inside], reach * way[inside], strict=True)]
    assert np.mean(np.abs(depth[inside] - expected) < 1e-7) >= 0.99


def test_lamps_and_laser_draw_it(optics, pose, name):
    lit = optics.rate("cam5", pose(sample=name, lamps=(("lamp4", 1.0),)))[80:160, 110:210]  # inside the opening
    assert 3000 < np.median(lit) < 40000
    assert lit.std() > 0.3 * lit.mean()
    fan = optics.layout.laser.fan_rad(240, pose().laser_elevation_rad)
    stripe = optics.laser_rate("cam5", pose(sample=name, laser_on=True, laser_sweep=(fan, fan)))
    assert 0.002 < np.mean(stripe > 1e3) < 0.05


def test_the_true_btf_is_lit_and_shaded(optics, pose, name):
    """Every texel is seen; shadows of bodies on bodies leave some of them black."""
    image = np.load(optics.truth("btf", pose(sample=name), camera="cam6", lamp="lamp2", texels=48, samples=1)["path"])
    assert np.isfinite(image).all()
    assert 0.02 < np.mean(image.max(axis=-1) == 0) < 0.7
    assert image.max() < 2


def test_an_unknown_sample_is_told_with_those_that_there_are():
    with pytest.raises(ValueError, match="no sample 'felt': one of none, white, brick, weave, peanut, grass, pipe"):
        Studio(1, "small").scene("felt")
