from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.materials.limb import SphereImage
from processing.materials.photographs import BodyPhotographs
from processing.materials.reflectance_map import reflectance_maps
from processing.materials.sight import CircleSight
from processing.materials.white_card import WhiteCard, card_irradiance
from processing.products import sphere_normals
from tests.reference.sphere import arm_lights, photograph

CFA = np.array([[0, 1], [1, 2]], np.uint8)
LIGHTS_DEG = (-60, -20, 20, 60)
RADIUS_M, DISTANCE, FOCAL_PX = 0.05, 22.0, 1500.0
CENTRE, SIZE = (101.3, 88.6), (200, 210)
RADIUS_PX = FOCAL_PX / np.sqrt(DISTANCE**2 - 1)  # of the limb
CARD = WhiteCard(0.0, -0.065, 0.04, 0.011, 0.9)
POWER = 5.0  # irradiance in the centre, in the unit of the radiance


def seen(centre=CENTRE, radius_px=RADIUS_PX, distance=DISTANCE):
    return CircleSight(SphereImage(np.array(centre), radius_px, np.eye(3) * 0.01, np.empty((0, 2))), distance)


def scene(card=CARD, albedo=0.6, lights_deg=LIGHTS_DEG):
    positions = arm_lights(lights_deg)
    place = (card.right_m / RADIUS_M, card.up_m / RADIUS_M, card.width_m / RADIUS_M, card.height_m / RADIUS_M)
    settings = {"size": SIZE, "centre": CENTRE, "focal_px": FOCAL_PX, "distance": DISTANCE, "albedo": albedo}
    images = POWER * np.stack(
        [photograph(light, **settings, card=(*place, card.reflectance), samples=4) for light in positions]
    )
    lights, count = positions / 12.0, len(positions)
    variance, reach_m = np.full(images.shape, 0.04), np.full(count, 12 * RADIUS_M)
    return BodyPhotographs(images, variance, CFA, lights, reach_m, RADIUS_M, np.zeros(count, int))


def test_a_matt_sphere_gives_albedo_over_pi_times_the_cosine():
    maps = reflectance_maps(scene(), seen(), np.full((4, 3), POWER), 48)
    normal = sphere_normals(48)
    cosine = (maps.lights() * normal).sum(axis=-1)
    expected = np.maximum(cosine, 0)[..., None] * 0.6 / np.pi
    # Interpolation over two pixels of a curved surface; next to the terminator the kink is blurred.
    away = np.abs(cosine) > 0.06
    assert np.abs(maps.reflectance_cos - expected)[away].max() < 0.004 * 0.6 / np.pi


def test_the_orthographic_assumption_costs_what_perspective_moves(arm_directions):
    """At 22 radii the middle of the map is magnified by 4.7 %: one texel in twenty."""
    normal = sphere_normals(48)
    near, far, distant = (seen(distance=distance).image_points(normal) for distance in (DISTANCE, np.inf, 1e7))
    shift = np.linalg.norm(near - far, axis=-1)
    assert 0.01 * seen().sphere.radius_px < shift.max() < 0.03 * seen().sphere.radius_px
    np.testing.assert_allclose(distant, far, atol=1e-4)


def test_image_points_are_the_pinhole_projection(rng):
    normal = sphere_normals(9)
    point = normal + np.array([0, 0, DISTANCE])
    projected = np.array(CENTRE) + FOCAL_PX * point[..., :2] / point[..., 2:]
    np.testing.assert_allclose(seen().image_points(normal), projected, atol=1e-9)


def test_variance_is_that_of_the_interpolated_value(rng):
    """Noise on the mosaic comes out of the map with the variance that the map states."""
    clean = scene()
    sigma = 0.2
    reference = reflectance_maps(clean, seen(), np.full((4, 3), POWER), 32)
    total = np.zeros(reference.reflectance_cos.shape)
    for _ in range(12):
        noisy = replace(clean, radiance=clean.radiance + sigma * rng.normal(size=clean.radiance.shape))
        error = reflectance_maps(noisy, seen(), np.full((4, 3), POWER), 32).reflectance_cos
        total += (error - reference.reflectance_cos) ** 2
    # 12 x 12 288 samples, each texel's own 12 independent: the mean ratio is good to about 1 %.
    assert abs((total / 12 / reference.variance).mean() - 1) < 0.05


def test_missing_sites_make_missing_texels_and_nothing_else():
    clean = scene()
    broken = clean.radiance.copy()
    broken[1, 90, 100] = np.nan
    whole = reflectance_maps(clean, seen(), np.full((4, 3), POWER), 48)
    holed = reflectance_maps(replace(clean, radiance=broken), seen(), np.full((4, 3), POWER), 48)
    missing = np.isnan(holed.reflectance_cos)
    assert 0 < missing[1].sum() < 100
    assert not missing[[0, 2, 3]].any()
    assert (np.isnan(holed.variance) == missing).all()
    np.testing.assert_array_equal(holed.reflectance_cos[~missing], whole.reflectance_cos[~missing])


def test_a_sphere_cut_by_the_border_loses_only_what_is_outside():
    clean = scene()
    cut = replace(clean, radiance=clean.radiance[:, :, 60:], variance=clean.variance[:, :, 60:])
    maps = reflectance_maps(cut, seen((CENTRE[0] - 60, CENTRE[1])), np.full((4, 3), POWER), 48)
    whole = reflectance_maps(clean, seen(), np.full((4, 3), POWER), 48)
    there = np.isfinite(maps.reflectance_cos)
    assert 0.5 < there.mean() < 1
    np.testing.assert_allclose(maps.reflectance_cos[there], whole.reflectance_cos[there], rtol=1e-5, atol=1e-7)


def test_the_card_tells_the_irradiance_in_the_centre():
    np.testing.assert_allclose(card_irradiance(scene(), seen(), CARD), POWER, rtol=2e-3)


def test_a_card_in_the_spheres_shadow_is_left_out():
    """Beside the sphere the card is dark under the lights of the other side; these get the others' reading."""
    beside = WhiteCard(0.072, 0.0, 0.016, 0.04, 0.9)
    photographs = scene(beside)
    np.testing.assert_allclose(card_irradiance(photographs, seen(), beside), POWER, rtol=3e-3)
    with pytest.raises(ImageError, match="shadowed"):
        card_irradiance(scene(beside, lights_deg=(-60, -55)), seen(), beside)


def test_a_card_outside_the_image_is_named():
    with pytest.raises(ImageError, match="card"):
        card_irradiance(scene(), seen(), WhiteCard(0.0, -0.2, 0.04, 0.011, 0.9))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-6, 6), st.floats(-3, 3))
def test_maps_are_linear_in_radiance_over_irradiance(seed, decades, decades_of_light):
    """On mosaics of noise with gaps, whose texels must stay gaps."""
    rng = np.random.default_rng(seed)
    radiance, variance = rng.normal(size=(2, 50, 60)), rng.uniform(0.1, 1, (2, 50, 60))
    radiance[rng.random(radiance.shape) < 0.01] = np.nan
    distant = np.full(2, np.inf)
    lights = np.array([[0.0, 0.6, -0.8], [0.6, 0.0, -0.8]])
    shot = BodyPhotographs(radiance, variance, CFA, lights, distant, RADIUS_M, np.zeros(2, int))
    sphere, light = seen((30.2, 24.7), 20.0), rng.uniform(1, 2, (2, 3))
    factor, brighter = 10**decades, 10**decades_of_light
    scaled = replace(shot, radiance=radiance * factor, variance=variance * factor**2)
    one, other = reflectance_maps(shot, sphere, light, 16), reflectance_maps(scaled, sphere, light * brighter, 16)
    np.testing.assert_allclose(other.reflectance_cos * brighter / factor, one.reflectance_cos, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(other.variance * (brighter / factor) ** 2, one.variance, rtol=1e-5)


def test_lights_and_images_must_agree():
    clean = scene()
    with pytest.raises(ImageError, match="lights"):
        replace(clean, radiance=clean.radiance[:2])
