"""Maps of pixels: what shrinking promises, for any numbers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import CalibrationError
from processing.radiometry.frame_series import Frame, gather
from processing.radiometry.pixel_maps import DarkSums, flat_map, offset_map, shrunk

EVERY = np.ones((40, 50), bool)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 1000), st.floats(0, 3), st.floats(1e-3, 3), st.floats(1e-6, 1e6))
def test_shrinking_scales_with_its_values_and_never_overshoots(seed, spread, noise, scale):
    values = np.random.default_rng(seed).normal(0, np.hypot(spread, noise), EVERY.shape)
    first = shrunk(values, noise**2, EVERY)
    again = shrunk(scale * values, (scale * noise) ** 2, EVERY)
    np.testing.assert_allclose(again.values, scale * first.values, rtol=1e-6, atol=1e-12 * scale)
    np.testing.assert_allclose(again.variance, scale**2 * first.variance, rtol=1e-6)
    assert (np.abs(first.values) <= np.abs(values) + 1e-12).all()
    assert (first.values * values >= 0).all()
    assert (first.variance <= noise**2 * (1 + 1e-9)).all()


@pytest.mark.parametrize("noise", [0.1, 0.5, 2.0])
def test_a_shrunk_map_is_nearer_to_the_truth_by_what_its_variance_says(noise):
    rng = np.random.default_rng(1)
    truth = rng.normal(0, 0.5, (400, 500))
    measured = truth + rng.normal(0, noise, truth.shape)
    found = shrunk(measured, noise**2, np.ones(truth.shape, bool))
    error = (found.values - truth).var()
    assert error < min((measured - truth).var(), truth.var())
    assert error == pytest.approx(found.variance.mean(), rel=0.06)  # the spread is known to 5 % at worst
    assert found.deviation == pytest.approx(0.5, abs=4 * found.sigma + 0.003)


def test_a_pixel_that_stands_out_keeps_its_value():
    values = np.random.default_rng(2).normal(0, 1, EVERY.shape)
    values[7, 8] = 40.0
    found = shrunk(values, 1.0, EVERY)
    assert found.values[7, 8] == 40.0
    assert found.variance[7, 8] == 1.0
    assert np.abs(found.values).max() == 40.0


def test_columns_of_their_own_are_kept_though_pixels_are_not_known():
    rng = np.random.default_rng(3)
    columns = rng.normal(0, 0.3, 500)
    found = offset_map(columns + rng.normal(0, 2, (400, 500)), 4.0, np.ones((400, 500), bool))
    assert np.std(found.values - (columns - columns.mean())) < 0.15  # 2 / sqrt(400) and a little


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 100), st.floats(1e-3, 1e5))
def test_a_flat_has_mean_one_in_every_channel_whatever_the_light(seed, light):
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[0:40, 0:50]
    rate = light * (1 - 0.001 * (rows - 20)) * (1 + rows % 2 + columns % 2) * rng.normal(1, 0.01, EVERY.shape)
    found, sound = flat_map(rate, np.full(EVERY.shape, 1e-6), EVERY)
    assert sound.all()
    for r, c in ((0, 0), (0, 1), (1, 0), (1, 1)):
        assert found.values[r::2, c::2].mean() == pytest.approx(1, abs=1e-4)


def test_a_line_needs_two_exposures():
    sums = DarkSums()
    sums.add(gather([Frame(np.full((8, 8), level, np.uint16), 0.0) for level in (256, 257)], 1.0), 1.0)
    with pytest.raises(CalibrationError, match="one exposure only"):
        sums.line()
