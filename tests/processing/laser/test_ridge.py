"""The ridge of stripes whose place is known, against the bound that noise sets."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.laser.ridge import stripe_ridge, stripe_sigma
from tests.reference.ridge import ridge_points

NOISE = 0.02  # of the stripe's height


def stripe(shape, sigma_px, angle_rad=0.0, offset_px=0.0):
    """A Gaussian stripe of height 1 through the middle of an image."""
    rows, columns = np.indices(shape, float)
    across = (columns - shape[1] / 2) * np.cos(angle_rad) + (rows - shape[0] / 2) * np.sin(angle_rad)
    return np.exp(-0.5 * ((across - offset_px) / sigma_px) ** 2)


def errors(ridge, shape, sigma_px, angle_rad=0.0, offset_px=0.0):
    """Signed distances from the stripe, of points whose filter lies in the image."""
    u, v = (ridge.uv_px - np.array(shape)[::-1] / 2).T
    inside = (np.abs(u) < shape[1] / 2 - 5 * sigma_px - 2) & (np.abs(v) < shape[0] / 2 - 5 * sigma_px - 2)
    return (u * np.cos(angle_rad) + v * np.sin(angle_rad) - offset_px)[inside]


@pytest.mark.parametrize("sigma_px", [1.0, 2.0, 4.0, 8.0])
def test_noise_moves_the_ridge_as_far_as_the_bound_says(sigma_px):
    """Over 2 sqrt(pi) sigma rows, which the filter averages, no unbiased estimate is better: noise / sqrt(pi) height.

    Of about 500 independent places the RMS is known to 4 %; the ridge's own deviation says the same.
    """
    shape = (int(1800 * sigma_px), int(12 * sigma_px) + 10)
    angle = 2.0 / shape[0]  # over two pixels, so that all places within one occur
    image = stripe(shape, sigma_px, angle) + np.random.default_rng(3).normal(0, NOISE, shape)
    ridge = stripe_ridge(image, sigma_px, 0.1)
    error = errors(ridge, shape, sigma_px, angle)
    assert len(error) > 0.98 * shape[0]
    rms, bound = np.sqrt(np.mean(error**2)), NOISE / np.sqrt(np.pi)
    assert rms == pytest.approx(bound, rel=0.12)
    assert abs(error.mean()) < 4 * bound / np.sqrt(500)
    assert np.median(ridge.deviation_px(NOISE)) == pytest.approx(bound, rel=0.06)


@given(st.floats(0.6, 8), st.floats(-0.75, 0.75), st.floats(-4, 4))
@settings(max_examples=40, deadline=None)
def test_ridge_has_no_bias_whatever_width_and_angle(sigma_px, angle, offset):
    """A two-hundredth of a pixel; of profiles that the pixels hardly sample, a twentieth."""
    shape, filtered_px = (90, 140), max(sigma_px, 0.8)
    error = errors(
        stripe_ridge(stripe(shape, sigma_px, angle, offset), filtered_px, 0.05), shape, filtered_px, angle, offset
    )
    assert np.abs(error).max(initial=0) < (0.005 if sigma_px >= 1 else 0.06)


@given(st.floats(2, 6), st.floats(-0.75, 0.75), st.floats(-4, 4))
@settings(max_examples=20, deadline=None)
def test_a_saturated_core_moves_the_ridge_little(sigma_px, angle, offset):
    """Clipped at four tenths: the profile's new edges are sharper than pixels, which costs a twentieth of one."""
    shape, filtered_px = (120, 170), 1.5 * sigma_px
    clipped = np.minimum(stripe(shape, sigma_px, angle, offset), 0.4)
    error = errors(stripe_ridge(clipped, filtered_px, 0.05), shape, filtered_px, angle, offset)
    assert np.abs(error).max(initial=0) < 0.06


@given(st.integers(0, 10**6), st.floats(0.7, 5), st.booleans(), st.sampled_from([np.float32, np.float64, np.uint16]))
@settings(max_examples=30, deadline=None)
def test_kernel_is_its_twin(seed, sigma_px, masked, kind):
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 60, 2))
    image = (1000 * rng.random(shape)).astype(kind)
    mask = rng.random(shape) < 0.8 if masked else np.ones(shape, bool)
    ridge = stripe_ridge(image, sigma_px, 5.0, mask)
    uv_px, strength, rival = ridge_points(image, sigma_px, 5.0, mask)
    np.testing.assert_allclose(ridge.uv_px, uv_px, atol=1e-6)
    np.testing.assert_allclose(ridge.strength, strength, rtol=1e-9)
    np.testing.assert_allclose(ridge.rival, rival, rtol=1e-9)
    assert np.abs(ridge.lines - ridge.uv_px[:, 1]).max(initial=0) <= 0.6
    assert (np.diff(ridge.lines) > 0).all()


def test_large_images_are_shared_among_cores_without_a_seam():
    image = 1000 * np.random.default_rng(5).random((610, 700))
    ridge = stripe_ridge(image, 3.0, 5.0)
    uv_px, strength, rival = ridge_points(image, 3.0, 5.0, np.ones(image.shape, bool))
    np.testing.assert_allclose(ridge.uv_px, uv_px, atol=1e-6)
    np.testing.assert_allclose(ridge.strength, strength, rtol=1e-9)
    np.testing.assert_allclose(ridge.rival, rival, rtol=1e-9)


@given(st.integers(0, 10**6), st.floats(-12, 12), st.floats(-1e3, 1e3))
@settings(max_examples=25, deadline=None)
def test_ridge_knows_no_unit_and_no_zero(seed, decades, dark):
    image = np.random.default_rng(seed).random((40, 50)) + stripe((40, 50), 2.0, 0.2)
    factor = 10.0**decades
    one, other = stripe_ridge(image, 2.0, 0.3), stripe_ridge(factor * (image + dark), 2.0, 0.3 * factor)
    np.testing.assert_allclose(other.uv_px, one.uv_px, atol=1e-6)
    np.testing.assert_allclose(other.strength, factor * one.strength, rtol=1e-6)


@given(st.integers(0, 10**6), st.floats(0.8, 3))
@settings(max_examples=25, deadline=None)
def test_a_mirrored_image_has_the_mirrored_ridge(seed, sigma_px):
    image = np.random.default_rng(seed).random((30, 44)) + stripe((30, 44), sigma_px, 0.3)
    one, left, down = (stripe_ridge(view, sigma_px, 0.1) for view in (image, image[:, ::-1], image[::-1]))
    np.testing.assert_allclose(left.uv_px * [-1, 1] + [43, 0], one.uv_px, atol=1e-9)
    np.testing.assert_allclose((down.uv_px * [1, -1] + [0, 29])[::-1], one.uv_px, atol=1e-9)


@pytest.mark.parametrize("angle", [0.6, 0.785, 0.97])
def test_rows_and_columns_see_one_stripe(angle):
    """Scanned along columns, the points of a slanted stripe lie on the same line."""
    shape = (80, 80)
    image = stripe(shape, 2.0, angle, 1.3)
    rows, columns = stripe_ridge(image, 2.0, 0.1), stripe_ridge(image.T, 2.0, 0.1)
    assert np.abs(errors(rows, shape, 2.0, angle, 1.3)).max() < 0.01
    assert np.abs(errors(replace(columns, uv_px=columns.uv_px[:, ::-1]), shape, 2.0, angle, 1.3)).max() < 0.01


def test_a_second_stripe_is_told_as_rival():
    image = stripe((40, 90), 2.0, 0.0, -20.0) + 0.6 * stripe((40, 90), 2.0, 0.0, 15.0)
    ridge = stripe_ridge(image, 2.0, 0.05)
    np.testing.assert_allclose(ridge.uv_px[:, 0], 25.0, atol=0.01)
    np.testing.assert_allclose(ridge.rival / ridge.strength, 0.6, atol=0.01)
    np.testing.assert_allclose(stripe_ridge(image, 2.0, 0.3).rival, 0.0)


def test_missing_pixels_hide_what_is_near_them_only():
    image = stripe((60, 60), 1.5)
    image[30, 28] = np.nan
    ridge = stripe_ridge(image, 1.5, 0.05)
    assert np.isfinite(ridge.uv_px).all()
    assert set(range(60)) - set(np.rint(ridge.uv_px[:, 1]).astype(int)) == set(range(24, 37))


@pytest.mark.parametrize("sigma_px", [1.0, 2.3, 5.0])
def test_sigma_of_a_stripe_is_found(sigma_px):
    """Within a tenth, with noise."""
    shape = (200, 120)
    image = 30 * stripe(shape, sigma_px, 0.3) + np.random.default_rng(0).normal(0, 0.6, shape)
    assert stripe_sigma(image) == pytest.approx(sigma_px, rel=0.1)


def test_images_and_masks_that_do_not_fit_are_refused():
    with pytest.raises(ImageError, match="mask"):
        stripe_ridge(np.zeros((4, 5)), 1.0, 1.0, np.ones((5, 4), bool))
    with pytest.raises(ImageError, match="grey"):
        stripe_ridge(np.zeros((4, 5, 3)), 1.0, 1.0)
    assert len(stripe_ridge(np.zeros((4, 5)), 1.0, 0.0).uv_px) == 0
