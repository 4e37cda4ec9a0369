"""Response curves of photographs, and their merging."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.radiometry.hdr import PixelStatus
from processing.radiometry.photographs import merge_photographs
from processing.radiometry.response import recover_response

TIMES_S = np.geomspace(1 / 500, 2, 6)


def srgb(x):
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-12) ** (1 / 2.4) - 0.055)


def contrast(x):
    """sRGB with an S-curve on top, as cameras' picture styles are."""
    y = srgb(x)
    return y + 0.4 * y * (1 - y) * (y - 0.5)


def scene(rng, shape=(60, 80, 3)):
    """Radiance over four decades such that every pixel is somewhere within range."""
    return np.exp(rng.uniform(np.log(0.02), np.log(100), shape))


def photographs(radiance, exposure_s, curve, rng):
    linear = np.clip(
        np.multiply.outer(exposure_s, radiance) + rng.normal(0, 3e-4, (len(exposure_s), *radiance.shape)), 0, 1
    )
    return np.clip(np.rint(255 * curve(linear) + rng.normal(0, 0.7, linear.shape)), 0, 255).astype(np.uint8)


def true_log_exposure(curve):
    x = np.linspace(0, 1, 100_001)
    g = np.log(np.maximum(np.interp(np.arange(256) / 255, curve(x), x), 1e-9))
    return g - g[128]


@pytest.mark.parametrize("curve", [srgb, contrast])
@pytest.mark.parametrize("exposure_s", [TIMES_S, TIMES_S[::2], [0.01, 0.03, 0.5, 1.9]])
def test_known_curves_are_recovered(curve, exposure_s):
    rng = np.random.default_rng(3)
    response = recover_response(photographs(scene(rng), exposure_s, curve, rng), np.asarray(exposure_s))
    error = (response.log_exposure - true_log_exposure(curve))[20:245]
    # Code noise is 1 % of the light and more; some thousand pixels and a polynomial of degree five leave a tenth.
    assert np.abs(error).max() < 0.02
    assert 0.5 < response.code_sigma_dn < 1.5  # 0.76: noise and rounding


def test_a_linear_camera_is_recovered_too():
    """Farther from sRGB than any picture style; the polynomial still follows within 3 %."""
    rng = np.random.default_rng(3)
    response = recover_response(photographs(scene(rng), TIMES_S, lambda x: x, rng), TIMES_S)
    assert np.abs(response.log_exposure - true_log_exposure(lambda x: x))[20:245].max() < 0.03


def test_merged_photographs_are_proportional_to_the_scene_and_know_their_error():
    rng = np.random.default_rng(4)
    radiance = scene(rng)
    merged, _ = merge_photographs(photographs(radiance, TIMES_S, srgb, rng), TIMES_S)
    known = merged.status == PixelStatus.OK
    assert known.mean() > 0.95
    ratio = merged.value[known] / radiance[known]
    assert np.std(ratio) / np.mean(ratio) < 0.03
    normalised = (ratio / np.median(ratio) - 1) * merged.value[known] / np.sqrt(merged.variance[known])
    assert 0.6 < 1.4826 * np.median(np.abs(normalised)) < 1.4  # weights chosen by the noisy code itself: no more


@settings(max_examples=10, deadline=None)
@given(st.floats(1e-3, 1e3), st.permutations(range(4)))
def test_unit_of_time_and_order_do_not_matter(factor, order):
    rng = np.random.default_rng(5)
    stack = photographs(scene(rng, (20, 20, 3)), TIMES_S[::2], srgb, rng)[[0, 1, 2, 2]]
    times = np.append(TIMES_S[::2], TIMES_S[-2] * 1.001)
    order = np.array(order)
    one, _ = merge_photographs(stack, times)
    other, _ = merge_photographs(stack[order], times[order] * factor)
    np.testing.assert_allclose(other.value * factor, one.value, rtol=1e-3)


def test_clipped_everywhere_is_saturated_and_black_everywhere_is_dark():
    rng = np.random.default_rng(6)
    radiance = scene(rng)
    radiance[0, 0], radiance[1, 1] = 1e9, 1e-9
    merged, _ = merge_photographs(photographs(radiance, TIMES_S, srgb, rng), TIMES_S)
    assert (merged.status[0, 0] == PixelStatus.SATURATED).all()
    assert np.isnan(merged.value[0, 0]).all()
    assert (merged.status[1, 1] == PixelStatus.DARK).all()
    assert (merged.value[1, 1] < np.nanpercentile(merged.value, 1)).all()


def test_a_single_or_disjoint_bracket_is_refused():
    grey = np.full((1, 8, 8, 3), 100, np.uint8)
    with pytest.raises(ImageError, match="two or more"):
        merge_photographs(grey, [1.0])
    with pytest.raises(ImageError, match="two or more"):
        merge_photographs(np.repeat(grey, 2, 0), [1.0, 1.0])
    with pytest.raises(ImageError, match="uint8"):
        merge_photographs(grey.astype(float), [1.0])
    with pytest.raises(ImageError, match="overlap"):
        merge_photographs(np.stack([grey[0] * 0, grey[0] * 0 + 255]), [1.0, 2.0])


def test_response_is_closer_to_the_truth_than_opencvs():
    """The independent referee: Debevec and Malik as OpenCV solves it, on the same stack."""
    rng = np.random.default_rng(5)
    stack = photographs(scene(rng), TIMES_S, contrast, rng)
    referee = cv2.createCalibrateDebevec(samples=300).process(list(stack), TIMES_S.astype(np.float32))
    inside = slice(20, 236)
    truth = true_log_exposure(contrast)[inside]
    free = np.log(referee[:, 0, 1].astype(np.float64))
    error_of_referee = np.std(free[inside] - free[128] - truth)
    error = np.std(recover_response(stack, TIMES_S).log_exposure[inside] - truth)
    assert error_of_referee < 0.05  # both solve the same problem
    assert error < error_of_referee
