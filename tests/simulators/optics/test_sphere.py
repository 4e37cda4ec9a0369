import numpy as np
import pytest

from simulators.layout import direction
from simulators.lens import rays, sample_points
from simulators.truth import limb_circle

ARMS_RAD = np.radians([-60, -50, -40, -30, -20, -10, 10, 20, 30, 40, 50, 60])


@pytest.fixture(scope="module")
def hits(studio):
    camera = studio.layout.cameras["front"]
    return studio.scene("sphere").trace(camera.rig_from_camera[:3, 3], rays(camera, sample_points(camera, 1)))


def _on_sphere(hits) -> np.ndarray:
    return np.abs(np.linalg.norm(hits.points, axis=1) - 0.05) < 1e-9


def test_the_limb_is_the_circle_that_perspective_makes(studio, hits):
    """Area of the seen pixels against the circle: 177 px of radius, a tenth of a pixel."""
    camera = studio.layout.cameras["front"]
    centre, radius = limb_circle(camera, 0.05)
    distance = np.linalg.norm(camera.rig_from_camera[:3, 3])
    # the lens shrinks it by k1 r^2 of about 0.02 %, and being off the axis stretches it by less
    assert radius == pytest.approx(camera.matrix[0, 0] * 0.05 / np.sqrt(distance**2 - 0.05**2), rel=1e-3)
    on = hits.ray[_on_sphere(hits)]
    row, column = np.divmod(on, camera.width_px)
    assert np.sqrt(len(on) / np.pi) == pytest.approx(radius, abs=0.1)
    np.testing.assert_allclose((column.mean(), row.mean()), centre, atol=0.1)


def test_no_arm_position_shades_the_card_or_lets_it_shade_the_sphere(studio, hits):
    """Shadows of convex bodies: the sphere's lit points are exactly those that face the lamp."""
    scene, on_sphere = studio.scene("sphere"), _on_sphere(hits)
    assert 1000 < (~on_sphere).sum()
    for arm_rad in ARMS_RAD:
        source = 0.6 * direction(arm_rad, 0.0)
        lit = scene.lit(hits, source)
        assert lit[~on_sphere].all()
        facing = np.einsum("nk,nk->n", hits.points, source - hits.points) > 0
        np.testing.assert_array_equal(lit[on_sphere], facing[on_sphere])


def test_the_sphere_does_shade_a_card_behind_it(studio, hits):
    scene, on_sphere = studio.scene("sphere"), _on_sphere(hits)
    assert not scene.lit(hits, np.array([0.3, 0.0, 0.6]))[~on_sphere].all()


def test_the_stone_is_uneven_but_stands_up(hits):
    on = _on_sphere(hits)
    own = hits.points[on] / 0.05
    cosine = np.einsum("nk,nk->n", own, hits.normals[on])
    assert 0.8 < cosine.min() < 0.999
    albedo = hits.material.albedo[on]
    assert albedo.std() > 0.03
    assert 0 < albedo.min() < albedo.max() < 1


def test_the_same_seed_gives_the_same_stone(studio):
    scene = studio.scene("sphere")
    first, again = (scene.normal_hits(np.array([[1.0, 0, 0], [0, 0.6, 0.8]])) for _ in range(2))
    np.testing.assert_array_equal(first.material.albedo, again.material.albedo)
