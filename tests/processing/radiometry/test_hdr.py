"""Merging a bracketed stack."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from processing.errors import ImageError
from processing.radiometry.hdr import PixelStatus, merge_exposures
from processing.radiometry.sensor import PixelCorrection, Sensor
from tests.reference import hdr as twin

SENSOR = Sensor(black_dn=256, white_dn=4095, gain_e_per_dn=4, read_noise_e=4)
EXPOSURE_S = np.geomspace(1 / 30, 2, 5)
quick = settings(max_examples=40, deadline=None)


def photograph(radiance, exposure_s, rng, sensor=SENSOR):
    """Counts (k, ...) of a radiance image in electrons per second, by the sensor's own noise model."""
    mean = np.multiply.outer(np.asarray(exposure_s, float), radiance)
    electrons = rng.poisson(mean) + rng.normal(0, sensor.read_noise_e, mean.shape)
    dn = np.rint(electrons / sensor.gain_e_per_dn + sensor.black_dn)
    return np.clip(dn, 0, sensor.white_dn).astype(np.uint16)


def bound(radiance, exposure_s, sensor=SENSOR):
    """Cramer-Rao variance of the radiance, exposures that saturate left out (Gaussian form)."""
    t = np.asarray(exposure_s)[:, None]
    information = t**2 / (radiance * t + sensor.dark_variance_e2) * (radiance * t < sensor.saturation_e)
    return 1 / information.sum(0)


@st.composite
def stacks(draw):
    frames = draw(st.integers(1, 7))
    shape = (frames, draw(st.integers(1, 4)), draw(st.integers(1, 5)))
    raw = draw(hnp.arrays(np.uint16, shape, elements=st.integers(0, 4095)))
    exposure = draw(hnp.arrays(np.float64, frames, elements=st.floats(1e-4, 30)))
    return raw, exposure


@st.composite
def bracketed(draw):
    """Stacks that some scene gives: the noise model's own samples."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    exposure = np.geomspace(0.01, 0.01 * 2.0 ** draw(st.integers(1, 9)), draw(st.integers(1, 8)))
    return photograph(10 ** rng.uniform(-1, 6, (4, 5)), exposure, rng), exposure


@quick
@given(bracketed())
def test_merge_equals_its_numpy_twin(stack):
    raw, exposure = stack
    merged = merge_exposures(raw, exposure, SENSOR)
    value, variance = twin.merge_exposures(raw, exposure, SENSOR)
    known = merged.status != PixelStatus.SATURATED
    error = (merged.value - value)[known] / np.sqrt(variance[known])
    # The kernel stops within 0.01 of a standard deviation and 1 % of the variance; 1e-6 is float32's own rounding.
    assert np.all(np.abs(error) < 0.015 + 1e-6 * np.abs(value[known]) / np.sqrt(variance[known]))
    np.testing.assert_allclose(merged.variance[known], variance[known], rtol=0.015)


@quick
@given(bracketed(), st.floats(1e-6, 1e6))
def test_longer_exposures_of_a_dimmer_scene_are_the_same_measurement(stack, factor):
    raw, exposure = stack
    one, other = merge_exposures(raw, exposure, SENSOR), merge_exposures(raw, exposure * factor, SENSOR)
    np.testing.assert_allclose(other.value * factor, one.value, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(other.variance * factor**2, one.variance, rtol=1e-4)
    np.testing.assert_array_equal(one.status, other.status)


@quick
@given(bracketed(), st.randoms(use_true_random=False))
def test_order_of_frames_does_not_matter(stack, random):
    raw, exposure = stack
    order = list(range(len(exposure)))
    random.shuffle(order)
    one, other = merge_exposures(raw, exposure, SENSOR), merge_exposures(raw[order], exposure[order], SENSOR)
    np.testing.assert_allclose(other.value, one.value, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(other.variance, one.variance, rtol=1e-4)


@quick
@given(stacks())
def test_any_stack_gives_finite_values_or_a_reason(stack):
    merged = merge_exposures(*stack, SENSOR)
    known = merged.status != PixelStatus.SATURATED
    assert np.isfinite(merged.value[known]).all()
    assert (merged.variance[known] > 0).all()
    assert np.isnan(merged.value[~known]).all()
    np.testing.assert_array_equal(~known, (stack[0] >= SENSOR.white_dn).all(0))


@quick
@given(bracketed())
def test_float_counts_merge_like_whole_ones(stack):
    raw, exposure = stack
    whole, single, double = (merge_exposures(raw.astype(d), exposure, SENSOR) for d in ("u2", "f4", "f8"))
    np.testing.assert_array_equal(whole.value, single.value)
    np.testing.assert_array_equal(whole.value, double.value)


def test_error_reaches_the_bound_and_the_variance_says_so():
    """Over 5.4 decades, in 64 groups of 16 000 samples: error over the Cramer-Rao bound, bias, predicted variance."""
    rng = np.random.default_rng(7)
    radiance = np.geomspace(1.5, 4.3e5, 256)
    merged = merge_exposures(photograph(np.tile(radiance, (4000, 1)), EXPOSURE_S, rng), EXPOSURE_S, SENSOR)
    error, limit = merged.value.astype(np.float64) - radiance, bound(radiance, EXPOSURE_S)
    square = (error**2 / limit).mean(0).reshape(64, 4).mean(1)
    assert np.sqrt(square.mean()) < 1.01
    assert np.median(np.sqrt(square)) < 1.002
    assert np.sqrt(square.max()) < 1.1  # where a frame switches off its codes carry less than the bound assumes
    bias = (error / radiance).mean(0).reshape(64, 4).mean(1)
    # A group knows its bias to 0.0005 at 100 electrons per second, better above.
    assert np.abs(bias[radiance[::4] > 100]).max() < 0.002
    darkest = radiance < 15
    assert abs(error[:, darkest].mean() / radiance[darkest].mean()) < 0.003
    predicted = (merged.variance / limit).mean(0).reshape(64, 4).mean(1)
    assert abs(predicted.mean() / square.mean() - 1) < 0.01
    # A group's mean square is known to 1.1 %; where frames switch off, the variance says what a sample has met.
    np.testing.assert_allclose(predicted, square, rtol=0.06)


@pytest.mark.parametrize("switching", range(1, 5))
def test_where_an_exposure_switches_off_there_is_no_step(switching):
    """Levels within four deviations of its saturation: bias under 0.3 %, error and variance as elsewhere."""
    rng = np.random.default_rng(switching)
    sigma_e = np.sqrt(SENSOR.saturation_e + SENSOR.dark_variance_e2)
    radiance = (SENSOR.saturation_e + sigma_e * np.arange(-4, 5)) / EXPOSURE_S[switching]
    merged = merge_exposures(photograph(np.tile(radiance, (20_000, 1)), EXPOSURE_S, rng), EXPOSURE_S, SENSOR)
    error = merged.value.astype(np.float64) - radiance
    # 20 000 samples of 1.6 % at most know their mean to 0.01 %.
    assert (np.abs(error.mean(0)) < 0.003 * radiance).all()
    assert (error**2 / bound(radiance, EXPOSURE_S)).mean() < 1.2
    assert abs(merged.variance.mean() / (error**2).mean() - 1) < 0.1


def test_up_to_a_hundred_exposures():
    rng = np.random.default_rng(1)
    exposure = np.geomspace(1e-3, 2, 100)
    radiance = np.full((40, 40), 2e4)
    merged = merge_exposures(photograph(radiance, exposure, rng), exposure, SENSOR)
    # 1600 pixels: their mean is within five of its own standard deviations.
    assert abs(merged.value.mean() - 2e4) < 5 * np.sqrt(merged.variance.mean() / 1600)


def test_single_exposure_is_scaled_counts():
    raw = np.array([[[256, 356, 200, 4095]]], np.uint16)
    merged = merge_exposures(raw, [0.5], SENSOR)
    np.testing.assert_allclose(merged.value[0, :3], [0, 800, -448], atol=1e-3)
    assert merged.status.tolist() == [[PixelStatus.DARK, PixelStatus.OK, PixelStatus.DARK, PixelStatus.SATURATED]]


def test_non_finite_samples_are_left_out():
    raw = np.full((3, 1, 4), 1256.0)
    raw[0, 0, 0] = np.nan
    raw[:, 0, 1] = np.nan
    raw[:, 0, 2] = np.inf
    raw[1, 0, 3] = -np.inf
    merged = merge_exposures(raw, [1.0, 1.0, 1.0], SENSOR)
    np.testing.assert_allclose(merged.value[0, [0, 3]], 4000, rtol=1e-6)
    wanted = [PixelStatus.OK, PixelStatus.MISSING, PixelStatus.SATURATED, PixelStatus.OK]
    assert merged.status.tolist() == [wanted]
    assert merged.count(PixelStatus.MISSING) == 1


def unequal_pixels(shape, rng):
    """Fixed pattern, dark current, unequal response with vignetting, and one hot pixel in a thousand."""
    return PixelCorrection(
        offset_dn=rng.normal(0, 3, shape).astype(np.float32),
        dark_e_s=rng.exponential(20, shape).astype(np.float32),
        flat=rng.uniform(0.5, 1.1, shape).astype(np.float32),
        hot=rng.random(shape) < 1e-3,
    )


def test_corrected_pixels_are_those_of_an_ideal_sensor():
    rng = np.random.default_rng(5)
    pixels, radiance = unequal_pixels((200, 300), rng), np.geomspace(30, 3e5, 300)
    mean = np.multiply.outer(EXPOSURE_S, pixels.flat * radiance + pixels.dark_e_s)
    dn = (rng.poisson(mean) + rng.normal(0, SENSOR.read_noise_e, mean.shape)) / SENSOR.gain_e_per_dn
    raw = np.clip(np.rint(dn + SENSOR.black_dn + pixels.offset_dn), 0, SENSOR.white_dn).astype(np.uint16)
    merged = merge_exposures(raw, EXPOSURE_S, SENSOR, pixels)
    np.testing.assert_array_equal(merged.status == PixelStatus.HOT, pixels.hot)
    assert np.isnan(merged.value[pixels.hot]).all()
    error = ((merged.value - radiance) / np.sqrt(merged.variance))[~pixels.hot]
    # 60 000 samples: mean known to 0.004, mean square to 0.006.
    assert abs(error.mean()) < 0.02
    assert abs((error**2).mean() - 1) < 0.03


def test_what_is_not_known_of_the_correction_adds_to_the_variance():
    raw, flat = np.full((1, 2, 2), 1256, np.uint16), np.full((2, 2), 0.5, np.float32)
    none, zero = np.zeros((2, 2), bool), np.zeros((2, 2), np.float32)
    known = merge_exposures(raw, [1.0], SENSOR, PixelCorrection(zero, zero, flat, none))
    vague = merge_exposures(raw, [1.0], SENSOR, PixelCorrection(zero, zero, flat, none, zero + 9, zero + 1e-4))
    np.testing.assert_allclose(vague.variance - known.variance, (9 + 8000**2 * 1e-4) / 0.25, rtol=1e-5)


@pytest.mark.parametrize(
    ("shape", "exposure"),
    [((2, 3), [1, 2]), ((2, 3, 3), [1]), ((0, 3, 3), []), ((1, 3, 3), [0]), ((1, 3, 3), [np.nan])],
)
def test_what_is_no_stack_is_refused(shape, exposure):
    with pytest.raises(ImageError):
        merge_exposures(np.zeros(shape, np.uint16), exposure, SENSOR)


def test_a_correction_that_does_not_fit_is_refused():
    shape = (3, 3)
    sound = unequal_pixels(shape, np.random.default_rng(0))
    with pytest.raises(ImageError, match="pixels"):
        merge_exposures(np.zeros((1, 3, 4), np.uint16), [1], SENSOR, sound)
    with pytest.raises(ImageError, match="positive"):
        PixelCorrection(sound.offset_dn, sound.dark_e_s, sound.flat * 0, sound.hot)
    with pytest.raises(ImageError, match="shapes"):
        PixelCorrection(sound.offset_dn[1:], sound.dark_e_s, sound.flat, sound.hot)
