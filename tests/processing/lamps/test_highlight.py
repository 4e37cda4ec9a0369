"""Spots of about a pixel in a Bayer mosaic: placed to their own deviation, whatever their brightness and place."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.lamps.highlight import find_highlights
from processing.radiometry.hdr import PixelStatus, Radiance, merge_exposures
from processing.radiometry.sensor import Sensor
from simulators.glint import Spots, add_spots

CFA = np.array([[0, 1], [1, 2]], np.uint8)
SENSOR = Sensor(256, 4095, 4.0, 4.0)
CHANNELS = np.array([0.6, 1.0, 0.72])
SHAPE = (40, 44)


def mosaic(spots, width_px=0.5, background=200.0):
    """Noise-free electrons per second of spots ((u, v), light of white) over an even background."""
    image = np.zeros((*SHAPE, 3), np.float32)
    for uv_px, light in spots:
        add_spots(image, Spots(np.array([uv_px]), light * CHANNELS[None]), width_px)
    rows, columns = np.indices(SHAPE)
    picked = np.take_along_axis(image, CFA[rows % 2, columns % 2][..., None], axis=2)
    return picked[..., 0] + background


def merged(rate, exposures_s, rng):
    frames = []
    for exposure_s in exposures_s:
        electrons = rng.poisson(rate * exposure_s) + rng.normal(0, SENSOR.read_noise_e, rate.shape)
        frames.append(np.clip(np.round(256 + electrons / 4), 0, 4095).astype(np.uint16))
    return merge_exposures(np.stack(frames), exposures_s, SENSOR)


def test_the_place_is_right_within_its_deviation():
    rng, normalised = np.random.default_rng(0), []
    for _ in range(150):
        uv_px = rng.uniform(18, 22, 2)
        rate = mosaic([(uv_px, 10 ** rng.uniform(5.3, 6.5))], rng.uniform(0.4, 0.8))
        found = find_highlights(merged(rate, [0.01], rng), CFA, np.array([20.0, 20.0]), 6)
        off = found[0].uv_px - uv_px
        normalised.append(off @ np.linalg.solve(found[0].covariance_px2, off) / 2)
    # 300 numbers: their root mean square scatters by 4 %
    assert 0.9 < np.sqrt(np.mean(normalised)) < 1.1


def test_light_is_told_by_channel():
    found = find_highlights(
        merged(mosaic([((20.3, 19.6), 3e6)]), [0.004], np.random.default_rng(0)), CFA, np.array([20.0, 20.0]), 6
    )
    np.testing.assert_allclose(found[0].light, 3e6 * CHANNELS, rtol=0.05)
    assert found[0].width_px == pytest.approx(0.5, abs=0.05)


@given(st.floats(-6, 6))
@settings(max_examples=15, deadline=None)
def test_the_unit_of_radiance_does_not_matter(power):
    radiance = merged(mosaic([((20.3, 19.6), 1e6)]), [0.01], np.random.default_rng(1))
    factor = 10.0**power
    scaled = Radiance(radiance.value * np.float32(factor), radiance.variance * np.float32(factor**2), radiance.status)
    one, other = (find_highlights(r, CFA, np.array([20.0, 20.0]), 6)[0] for r in (radiance, scaled))
    np.testing.assert_allclose(other.uv_px, one.uv_px, atol=1e-4)
    np.testing.assert_allclose(other.covariance_px2, one.covariance_px2, rtol=1e-2)


def test_two_spots_are_both_told_the_brightest_first():
    rate = mosaic([((14.2, 20.7), 5e5), ((27.6, 18.1), 2e6)])
    found = find_highlights(merged(rate, [0.005], np.random.default_rng(2)), CFA, np.array([20.0, 20.0]), 12)
    assert len(found) == 2
    np.testing.assert_allclose(found[0].uv_px, (27.6, 18.1), atol=0.05)
    np.testing.assert_allclose(found[1].uv_px, (14.2, 20.7), atol=0.1)


def test_a_saturated_spot_is_placed_by_its_flanks():
    uv_px, errors = np.array([20.3, 19.8]), []
    for seed in range(20):
        radiance = merged(mosaic([(uv_px, 5e7)], 0.8), [0.005], np.random.default_rng(seed))
        assert radiance.count(PixelStatus.SATURATED) >= 4
        found = find_highlights(radiance, CFA, np.array([21.0, 21.0]), 8)[0]
        off = found.uv_px - uv_px
        errors.append(off @ np.linalg.solve(found.covariance_px2, off) / 2)
        assert np.hypot(*off) < 0.05
    assert np.sqrt(np.mean(errors)) < 2  # what saturates is chosen by its own noise: a little optimistic


def test_a_bracket_has_the_core_as_well():
    rate = mosaic([((20.3, 19.8), 1.5e7)])
    found = find_highlights(merged(rate, [0.001, 0.008], np.random.default_rng(0)), CFA, np.array([20.0, 20.0]), 6)[0]
    np.testing.assert_allclose(found.uv_px, (20.3, 19.8), atol=0.03)


@pytest.mark.parametrize("uv_px", [(0.4, 20.2), (42.2, 1.3), (20.0, 38.4)])
def test_spots_at_the_border_are_placed_too(uv_px):
    radiance = merged(mosaic([(uv_px, 3e6)]), [0.004], np.random.default_rng(3))
    found = find_highlights(radiance, CFA, np.array(uv_px), 6)
    np.testing.assert_allclose(found[0].uv_px, uv_px, atol=0.1)


def test_a_dark_picture_has_none():
    radiance = merged(mosaic([], background=0.0), [0.01], np.random.default_rng(4))
    assert find_highlights(radiance, CFA, np.array([20.0, 20.0]), 15) == ()


def test_a_hot_pixel_is_no_spot():
    rate = mosaic([], background=0.0)
    rate[20, 21] += 1e6
    assert find_highlights(merged(rate, [0.01], np.random.default_rng(5)), CFA, np.array([20.0, 20.0]), 15) == ()


def test_what_lies_beyond_the_reach_is_not_looked_at():
    radiance = merged(mosaic([((35.0, 30.0), 3e6)]), [0.004], np.random.default_rng(6))
    assert find_highlights(radiance, CFA, np.array([12.0, 12.0]), 8) == ()


def test_missing_pixels_take_no_part():
    radiance = merged(mosaic([((20.3, 19.6), 1e6)]), [0.01], np.random.default_rng(7))
    value, variance = radiance.value.copy(), radiance.variance.copy()
    value[19, 20], variance[21, 19] = np.nan, np.nan
    value[30:], variance[30:] = np.nan, np.nan
    found = find_highlights(Radiance(value, variance, radiance.status), CFA, np.array([20.0, 20.0]), 6)
    np.testing.assert_allclose(found[0].uv_px, (20.3, 19.6), atol=0.1)
    nothing = np.full(SHAPE, np.nan, np.float32)
    missing = Radiance(nothing, nothing, np.full(SHAPE, PixelStatus.MISSING, np.uint8))
    assert find_highlights(missing, CFA, np.array([20.0, 20.0]), 6) == ()
