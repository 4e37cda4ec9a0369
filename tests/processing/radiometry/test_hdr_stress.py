"""Merging at the ends of what a stack can be: each gives the right answer or one clear error."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.radiometry.hdr import PixelStatus, merge_exposures
from processing.radiometry.merge_kernel import BLOCK_PX
from processing.radiometry.sensor import PixelCorrection, Sensor
from tests.processing.radiometry.test_hdr import EXPOSURE_S, SENSOR, bracketed, photograph

WIDE = Sensor(black_dn=0, white_dn=65535, gain_e_per_dn=0.5, read_noise_e=2)
quick = settings(max_examples=40, deadline=None)


def test_all_saturated_and_all_dark():
    white = merge_exposures(np.full((3, 4, 5), 4095, np.uint16), [0.1, 1, 0.01], SENSOR)
    assert np.isnan(white.value).all()
    assert np.isnan(white.variance).all()
    assert white.count(PixelStatus.SATURATED) == 20
    black = merge_exposures(np.full((3, 4, 5), 256, np.uint16), [0.1, 1, 0.01], SENSOR)
    assert black.count(PixelStatus.DARK) == 20
    np.testing.assert_array_equal(black.value, 0)
    np.testing.assert_allclose(black.variance, SENSOR.dark_variance_e2 / (0.1**2 + 1 + 0.01**2), rtol=1e-5)


def test_sixteen_bits_from_end_to_end():
    raw = np.array([[[0, 1, 65534, 65535]], [[0, 0, 40, 65535]]], np.uint16)
    merged = merge_exposures(raw, [1.0, 1e-3], WIDE)
    wanted = [PixelStatus.DARK, PixelStatus.DARK, PixelStatus.OK, PixelStatus.SATURATED]
    assert merged.status.tolist() == [wanted]
    assert merged.value[0, 0] == 0
    # The long exposure, 32 767 electrons, outweighs the short one a thousandfold.
    assert abs(merged.value[0, 2] - 32767) < 0.5 * np.sqrt(32767)


@pytest.mark.parametrize("ratio", [1.5, 60.0, 1e3, 1e6])
def test_exposure_ratios_up_to_a_million(ratio):
    """Levels that only one of two exposures resolves have that one's mean and variance."""
    rng = np.random.default_rng(4)
    for mean_e, time in ((5000.0, 1.0), (8000.0, 1 / ratio)):
        merged = merge_exposures(
            photograph(np.full((100, 100), mean_e / time), [1.0, 1 / ratio], rng), [1, 1 / ratio], SENSOR
        )
        error = (merged.value - mean_e / time) / np.sqrt(merged.variance)
        assert abs(error.mean()) < 0.05  # five times its own deviation
        assert abs((error**2).mean() - 1) < 0.07


def test_a_saturated_exposure_far_below_its_ceiling_pulls_up_to_it():
    """The short exposure sees nothing, the long one at least 15 354 electrons in a second: so that is the least."""
    for ratio in (1e2, 1e3, 1e4):
        merged = merge_exposures(np.array([[[4095]], [[255]]], np.uint16), [1.0, 1 / ratio], SENSOR)
        assert abs(merged.value[0, 0] - SENSOR.saturation_e) < 6 * np.sqrt(SENSOR.saturation_e)


@quick
@given(bracketed(), st.floats(1e-6, 1e6))
def test_gain_is_but_a_unit(stack, factor):
    """Electrons of another size: value scales, its variance by the square, the status stays."""
    raw, exposure = stack
    other = Sensor(256, 4095, 4 * factor, 4 * factor)
    one, scaled = merge_exposures(raw, exposure, SENSOR), merge_exposures(raw, exposure, other)
    bright = merge_exposures(raw, exposure, Sensor(256, 4095, 4e6, 4.0))
    assert np.isfinite(scaled.value[one.status != PixelStatus.SATURATED]).all()
    np.testing.assert_array_equal(one.status == PixelStatus.SATURATED, scaled.status == PixelStatus.SATURATED)
    assert (bright.variance[np.isfinite(bright.variance)] > 0).all()


@quick
@given(bracketed(), st.integers(0, 2**32))
def test_a_pixel_depends_on_its_own_samples_alone(stack, seed):
    """Whatever stands beside it, and wherever in a block: the same value but for float32's rounding."""
    raw, exposure = stack
    rng = np.random.default_rng(seed)
    around = rng.integers(0, 4096, (len(exposure), 1, BLOCK_PX + 40)).astype(np.uint16)
    at = rng.integers(0, BLOCK_PX + 40 - 20)
    around[:, 0, at : at + 20] = raw.reshape(len(exposure), 20)
    alone, beside = merge_exposures(raw, exposure, SENSOR), merge_exposures(around, exposure, SENSOR)
    np.testing.assert_allclose(beside.value[0, at : at + 20], alone.value.ravel(), rtol=2e-5, atol=1e-4)
    np.testing.assert_array_equal(beside.status[0, at : at + 20], alone.status.ravel())


@quick
@given(bracketed())
def test_frames_of_nan_and_dead_frames_change_nothing(stack):
    raw, exposure = stack
    one = merge_exposures(raw, exposure, SENSOR)
    nan = np.full((1, *raw.shape[1:]), np.nan, np.float32)
    other = merge_exposures(np.concatenate([nan, raw, nan]), [3.0, *exposure, 1e-3], SENSOR)
    known = np.isfinite(one.value)
    assert (np.abs(other.value - one.value) < 0.015 * np.sqrt(one.variance))[known].all()  # the merge's own tolerance
    np.testing.assert_array_equal(np.isfinite(other.value), known)
    nothing = merge_exposures(np.concatenate([nan, nan]), [1.0, 2.0], SENSOR)
    assert nothing.count(PixelStatus.MISSING) == nothing.status.size


@quick
@given(bracketed())
def test_a_correction_that_says_nothing_changes_nothing(stack):
    raw, exposure = stack
    zero = np.zeros(raw.shape[1:], np.float32)
    neutral = PixelCorrection(zero, zero, zero + 1, zero > 0)
    one, other = merge_exposures(raw, exposure, SENSOR), merge_exposures(raw, exposure, SENSOR, neutral)
    np.testing.assert_allclose(other.value, one.value, rtol=1e-6)
    np.testing.assert_allclose(other.variance, one.variance, rtol=1e-6)
    np.testing.assert_array_equal(other.status, one.status)


def test_a_hundred_exposures_reach_their_bound():
    """Also where a third of them saturates, and in any order."""
    rng = np.random.default_rng(1)
    exposure = rng.permutation(np.geomspace(1e-3, 2, 100))
    merged = merge_exposures(photograph(np.full((100, 100), 5e4), exposure, rng), exposure, SENSOR)
    error = (merged.value.astype(float) - 5e4) / np.sqrt(merged.variance)
    assert abs(error.mean()) < 0.05
    assert abs((error**2).mean() - 1) < 0.07


def test_equal_times_average():
    rng = np.random.default_rng(8)
    raw = photograph(np.full((50, 50), 2000.0), [1.0] * 4, rng)
    merged = merge_exposures(raw, [1.0] * 4, SENSOR)
    np.testing.assert_allclose(merged.value, (raw.mean(0) - 256) * 4, rtol=1e-5)


def test_views_and_other_types_are_what_they_show():
    rng = np.random.default_rng(9)
    raw = photograph(10 ** rng.uniform(0, 5, (6, 8)), EXPOSURE_S, rng)
    one = merge_exposures(raw, EXPOSURE_S, SENSOR)
    for same in (raw.astype(">u2"), np.asfortranarray(raw), raw.astype(np.int32), np.repeat(raw, 2, axis=2)[..., ::2]):
        np.testing.assert_array_equal(merge_exposures(same, EXPOSURE_S, SENSOR).value, one.value)
    empty = merge_exposures(raw[:, :0], EXPOSURE_S, SENSOR)
    assert empty.value.shape == (0, 8)


@pytest.mark.parametrize("times", [[0.0, 1.0], [-1.0, 1.0], [np.nan, 1.0], [np.inf, 1.0]])
def test_times_that_are_none_are_named(times):
    with pytest.raises(ImageError, match="positive and finite"):
        merge_exposures(np.zeros((2, 3, 3), np.uint16), times, SENSOR)


@pytest.mark.parametrize("counts", [np.zeros((1, 2, 2), complex), np.zeros((1, 2, 2), bool), np.full((1, 2, 2), "a")])
def test_what_is_no_number_is_refused(counts):
    with pytest.raises(ImageError, match="counts"):
        merge_exposures(counts, [1.0], SENSOR)


def test_frames_of_different_sizes_are_refused():
    ragged = np.empty(2, object)
    ragged[:] = [np.zeros((2, 2), np.uint16), np.zeros((2, 3), np.uint16)]
    with pytest.raises(ImageError, match="shape"):
        merge_exposures(ragged, [1.0, 2.0], SENSOR)
