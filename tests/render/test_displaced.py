"""The truth of bodies covered with a sample, against the far field and against bodies known by formulas."""

import numpy as np
import pytest

from render.arrays import unit
from render.camera import look_at
from render.picture import Picture
from render.scene import Light, light
from render.shapes import cylinder_surface, placed, plane_surface, sphere_surface
from simulators.far_field import first_hits, lit, one_period, reflected
from simulators.layout import direction
from simulators.samples.bodies import terrain
from tests.benchmarks.yardsticks.bands import BAND_PX, flip_map, mask_iou, shadow_band, silhouette_band
from tests.benchmarks.yardsticks.covered import Covered
from tests.benchmarks.yardsticks.displaced import NOTHING, Displaced, TruePicture
from tests.benchmarks.yardsticks.mitsuba_displaced import matt, rendered
from tests.benchmarks.yardsticks.sample_periods import Period, period

SEED, ALBEDO = 3, 0.5
FAR = 500.0  # of the eye, against which bodies of length 1 are small


def plate(depth: float) -> Period:
    """A matt plane under the reference plane."""
    values = np.broadcast_to([ALBEDO, ALBEDO, ALBEDO, 0.0, 1.0], (24, 24, 5))
    ground = terrain(np.full((24, 24), -depth), values, 1.0)
    return Period(ground.vertices, ground.faces, ground.normals, ground.surface, 1e-4)


def view_from(way: np.ndarray, size: int, side: float):
    """A camera so far away that its rays are parallel to a thousandth of a radian."""
    return look_at(FAR * way, np.zeros(3), (size, size), field_of_view_rad=2 * np.arctan(0.5 * side / FAR))


@pytest.mark.parametrize("depth", [0.0, 0.05, 0.2])
def test_a_plane_sample_on_a_cylinder_is_a_thinner_cylinder(depth):
    """Of radius R - s h, with s the root of a tile's length times its height, lit by the cosine of its own normal."""
    radius, height, tiles = 0.5, 2.0, (8, 4)
    body = Displaced([Covered(cylinder_surface(radius, height), tiles, plate(depth))])
    scale = np.sqrt(2 * np.pi * radius / tiles[0] * height / tiles[1])
    sun = Light(unit(np.array([1.0, 0.4, 0.0])), np.ones(3))
    seen = body.seen(view_from(np.array([1.0, 0.0, 0.0]), 160, 1.2), [sun], 1)
    pixel = 1.2 / 160
    across = (np.arange(160) - 79.5) * pixel
    thinner = radius - scale * depth
    shown = seen.picture.coverage[80] > 0
    assert abs(shown.sum() * pixel - 2 * thinner) <= 2 * pixel
    inside = np.abs(across) < 0.95 * thinner
    normal = np.stack([np.sqrt(thinner**2 - across[inside] ** 2), across[inside], 0 * across[inside]], axis=1) / thinner
    expected = ALBEDO / np.pi * np.maximum(normal @ sun.direction, 0.0)
    # The triangles' shadow ends a facet of 360 / (8 * 24) deg before the normals' does.
    turned = expected > ALBEDO / np.pi * np.sin(np.radians(360 / 192))
    np.testing.assert_allclose(seen.picture.radiance[80][inside][turned, 0], expected[turned], atol=3e-3)


@pytest.mark.parametrize("sample", ["brick", "pipe"])
def test_on_a_plane_it_is_what_the_far_field_sees(sample):
    """Another tracer for reliefs, and another mesh of the bodies: but for rays along edges, the same values."""
    to_light, to_eye = direction(np.radians(120), np.radians(50)), direction(np.radians(30), np.radians(50))
    camera = view_from(to_eye, 60, 0.4)
    flat = Displaced([Covered(plane_surface(1.0), (1, 1), period(sample, SEED))])
    seen = flat.seen(camera, [Light(to_light, np.ones(3))], 1)
    body, period_m = one_period(sample, SEED, (to_light[None], to_eye[None]))
    hits = first_hits((body, period_m), _ground(camera) * period_m, to_eye, 0.0)
    expected = reflected(hits, lit(body, hits, to_light), to_light, to_eye) * to_light[2]
    found = seen.picture.radiance.reshape(-1, 3)
    error = np.abs(found - expected).max(axis=1) / expected.max()
    assert np.mean(error < 0.02) > 0.95
    assert seen.picture.coverage.min() == 1


def _ground(camera) -> np.ndarray:
    """Points (n, 3) of z = 0 that the pixels show, within half a unit."""
    u, v = np.meshgrid(np.arange(camera.size[0]), np.arange(camera.size[1]))
    ways = np.stack([u.ravel(), v.ravel(), np.ones(u.size)], axis=1) @ np.linalg.inv(camera.matrix).T
    ways = ways @ camera.camera_from_world[:3, :3]
    return camera.eye - camera.eye[2] / ways[:, 2:] * ways


def test_a_ball_throws_its_shadow_on_the_floor_and_its_own_relief_throws_none_from_afar():
    depth, lifted = 0.05, np.eye(4)
    lifted[2, 3] = 0.6
    ball = Covered(placed(sphere_surface(0.2), lifted), (4, 2), plate(depth))
    floor = Covered(plane_surface(2.0), (4, 4), plate(0.0))
    sun = light(0.0, np.radians(60))
    seen = Displaced([ball, floor]).seen(view_from(unit(np.array([0.0, -1e-3, 1.0])), 120, 1.6), [sun], 2)
    assert set(np.unique(seen.body)) == {0, 1}
    on_floor = (seen.body == 1) & (seen.shadow > 0.5)
    row, column = (np.argwhere(on_floor).mean(axis=0) - 59.5) * 1.6 / 120
    assert np.hypot(row, column) == pytest.approx(0.6 / np.tan(np.radians(60)), abs=0.15)
    assert np.all(seen.picture.radiance[on_floor & (seen.shadow == 1)] == 0)
    assert not np.nan_to_num(seen.shadow[seen.body == 0]).any()


def test_mitsuba_sees_the_same():
    """Another tracer and another way to shade; its samples in a pixel lie elsewhere, so edges differ by a few of 64."""
    pytest.importorskip("mitsuba", reason="Mitsuba is not installed")
    x, y = np.meshgrid(*2 * [np.arange(24) / 24 * 2 * np.pi])
    values = np.dstack([0.4 + 0.3 * np.sin(x), 0.4 + 0.3 * np.cos(y), 0.5 + 0.0 * x, 0.05 + 0.0 * x, 0.4 + 0.0 * x])
    ground = terrain(0.06 * np.cos(x) * np.sin(y) - 0.06, values, 1.0)
    waves = Period(ground.vertices, ground.faces, ground.normals, ground.surface, 1e-4)
    ball = Displaced([matt(Covered(cylinder_surface(0.5, 6.0), (6, 12), waves))])
    camera, sun = look_at([3.0, 0.0, 1.0], [0.0, 0.0, 0.0], (48, 36), field_of_view_rad=0.4), light(0.5, 0.5, 2.0)
    ours, other = ball.seen(camera, [sun], 8).picture, rendered(ball, camera, sun, 64)
    assert mask_iou(ours, other) > 0.98
    inside = (ours.coverage == 1) & (other.coverage == 1)
    away = np.abs(ours.radiance - other.radiance)[inside].max(axis=1)
    assert np.median(away) < 0.02 * ours.radiance[inside].mean()
    assert flip_map(ours, other).mean() < 0.03


def _disc(radius: float, level: float = 1.0, size: int = 90) -> Picture:
    place = np.arange(size) - (size - 1) / 2
    inside = (np.hypot(*np.meshgrid(place, place)) < radius).astype(np.float32)
    return Picture(np.repeat(level * inside[..., None], 3, axis=2), inside)


def test_bands_lie_along_borders_and_hold_the_errors_of_a_wrong_outline():
    true, wide = _disc(24.0), _disc(27.0)
    body = np.where(true.coverage > 0, 0, NOTHING)
    split = np.where(np.arange(90) < 45, 1.0, 0.0) * np.ones((90, 1))
    known = TruePicture(true, body, np.where(true.coverage > 0, split, np.nan))
    band = silhouette_band(known)
    place = np.hypot(*np.meshgrid(np.arange(90) - 44.5, np.arange(90) - 44.5))
    assert band[np.abs(place - 24) < BAND_PX - 1].all()
    assert not band[np.abs(place - 24) > BAND_PX + 1].any()
    assert flip_map(true, true).max() == 0
    error = flip_map(true, wide)
    assert error[band].mean() > 10 * error[~band].mean()
    assert mask_iou(true, wide) == pytest.approx((24 / 27) ** 2, abs=0.02)
    assert mask_iou(true, true) == 1
    edge = shadow_band(known)
    assert edge[45, 45]
    assert not (edge & band).any()
    assert not shadow_band(TruePicture(true, body, np.where(true.coverage > 0, 1.0, np.nan))).any()


def test_how_bright_the_scene_is_does_not_matter():
    one, other = _disc(24.0), _disc(27.0)
    brighter = [Picture(1000 * picture.radiance, picture.coverage) for picture in (one, other)]
    np.testing.assert_array_equal(flip_map(one, other), flip_map(*brighter))
