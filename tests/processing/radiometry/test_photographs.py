"""Merging of photographs, against the scene that the simulated camera saw."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.radiometry import photograph_kernel
from processing.radiometry.hdr import PixelStatus
from processing.radiometry.photographs import merge_photographs, merge_tables
from processing.radiometry.response import Response
from simulators.picture import log_exposure
from tests.processing.radiometry.pictures import bracket, camera, scene, true_value
from tests.reference import photographs as reference

FIVE = 4.0 ** np.arange(-2, 3)


def known_response(curve="srgb", sigma_dn=0.5):
    """What a perfect calibration of this camera would say, with little noise."""
    truth = log_exposure(curve)
    truth[0] = truth[1] - 1
    noise = np.full_like(truth, sigma_dn)
    return Response(truth, np.zeros_like(truth), noise, np.full(3, sigma_dn), "Virtual P1")


def ramp(shape=(120, 400), decades=4.0):
    """Radiance that rises smoothly, so that every exposure enters and leaves its range somewhere."""
    radiance = np.exp(np.log(10) * decades * np.linspace(-0.5, 0.5, shape[1]))
    return np.broadcast_to(radiance[None, :, None], (*shape, 3))


def test_merge_is_unbiased_where_exposures_switch_and_knows_its_variance():
    """Before coding: within 0.3 % in 60 groups of radiance, the variance within 10 %, over all switching zones."""
    shooter = camera("srgb")
    radiance = ramp((300, 400))
    merged = merge_photographs(bracket(shooter, radiance, FIVE, coded=False), FIVE).radiance
    true = true_value(shooter, radiance)
    groups = np.array_split(np.arange(30, 390), 60)
    measured = (merged.status == PixelStatus.OK)[:, 30:390]
    assert measured.mean() > 0.99
    error = merged.value / true - 1
    assert max(abs(np.nanmean(error[:, group, 1])) for group in groups) < 0.003
    z = ((merged.value - true) / np.sqrt(merged.variance))[:, 30:390]
    assert np.mean(z[measured] ** 2) == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize(("curve", "bound"), [("srgb", 0.01), ("filmic", 0.01), ("film", 0.015)])
def test_merge_through_jpeg_stays_within_a_percent(curve, bound):
    """4:2:0, quality 92, the response from another bracket, radiance in 40 groups over all switching zones.

    Three different curves: JPEG's channels mix what they bent differently.
    """
    shooter, radiance = camera(curve), ramp()
    response = merge_photographs(bracket(shooter, scene(), FIVE), FIVE).response
    merged = merge_photographs(bracket(shooter, radiance, FIVE), FIVE, response).radiance
    error = merged.value / true_value(shooter, radiance) - 1
    groups = np.array_split(np.arange(40, 380), 40)
    assert max(abs(np.nanmean(error[:, group, c])) for group in groups for c in range(3)) < bound


@settings(max_examples=20, deadline=None)
@given(st.floats(1e-6, 1e6), st.permutations(range(4)), st.booleans())
def test_unit_of_exposure_and_order_do_not_matter(factor, order, steep):
    rng = np.random.default_rng(5)
    codes = rng.integers(0, 256, (4, 6, 7, 3)).astype(np.uint8) // [[[[8]]], [[[3]]], [[[2]]], [[[1]]]]
    codes = codes.astype(np.uint8)
    log_t = np.log([0.1, 0.3, 1, 2])
    tables = merge_tables(known_response("linear" if steep else "srgb"))
    order = np.array(order)
    one = photograph_kernel.merge_photographs(codes, log_t, *tables)
    other = photograph_kernel.merge_photographs(codes[order], log_t[order] + np.log(factor), *tables)
    np.testing.assert_allclose(other[0] * factor, one[0], rtol=2e-3)
    np.testing.assert_array_equal(np.isnan(other[0]), np.isnan(one[0]))


def test_kernel_and_its_plain_twin_agree():
    stack = bracket(camera("film"), scene(4, (48, 60), 6.0), FIVE)
    arguments = stack, np.log(FIVE), *merge_tables(known_response("film", 1.0))
    ours, plain = photograph_kernel.merge_photographs(*arguments), reference.merge_photographs(*arguments)
    np.testing.assert_allclose(ours[0], plain[0], rtol=2e-3)
    np.testing.assert_allclose(ours[1], plain[1], rtol=2e-2)
    assert np.mean(ours[2] != plain[2]) < 1e-3


def test_clipped_everywhere_is_saturated_and_black_everywhere_is_dark():
    radiance = scene(6).copy()
    radiance[0:8, 0:8], radiance[16:32, 16:32] = 1e6, 1e-6
    merged = merge_photographs(bracket(camera(), radiance, FIVE, coded=False), FIVE).radiance
    assert (merged.status[2:6, 2:6] == PixelStatus.SATURATED).all()
    assert np.isnan(merged.value[2:6, 2:6]).all()
    assert (merged.status[20:28, 20:28] == PixelStatus.DARK).all()
    assert (merged.value[20:28, 20:28] < np.nanpercentile(merged.value, 1)).all()


@pytest.mark.parametrize("level", [0, 255])
def test_pictures_all_black_or_white_say_so_with_a_response(level):
    merged = merge_photographs(np.full((2, 8, 8, 3), level, np.uint8), [1.0, 2.0], known_response()).radiance
    assert (merged.status == (PixelStatus.SATURATED if level else PixelStatus.DARK)).all()
    with pytest.raises(ImageError, match="overlap"):
        merge_photographs(np.full((2, 8, 8, 3), level, np.uint8), [1.0, 2.0])


def test_one_photograph_with_a_response_is_enough():
    shooter, radiance = camera("film"), scene(7)
    merged = merge_photographs(bracket(shooter, radiance, [1.0], coded=False), [1.0], known_response("film")).radiance
    known = merged.status == PixelStatus.OK
    assert known.mean() > 0.5
    error = merged.value[known] / true_value(shooter, radiance)[known] - 1
    assert abs(np.median(error)) < 0.003


def test_scale_is_kept_across_iso_aperture_and_times():
    """One response, three brackets of one camera with other settings: the same radiance."""
    settings_ = [({"iso": 100, "f_number": 4.0}, 1.0), ({"iso": 800, "f_number": 8.0}, 0.5), ({"f_number": 2.0}, 0.3)]
    radiance, found = ramp((40, 200), 1.0), []
    for changes, time in settings_:
        shooter = camera(**changes)
        exposure = np.array([time, time * 4]) * shooter.iso / 100 / shooter.f_number**2
        stack = bracket(shooter, radiance, [time, time * 4], coded=False)
        value = merge_photographs(stack, exposure, known_response()).radiance.value
        found.append(np.median(value, axis=0))
    np.testing.assert_allclose(found[1], found[0], rtol=0.05)  # noise of 40 rows
    np.testing.assert_allclose(found[2], found[0], rtol=0.05)


def test_a_ratio_of_ten_thousand_leaves_a_gap_that_is_told():
    """Black in one and white in the other is known to lie between: dark, with the end of the range as deviation."""
    radiance = ramp((20, 300), 8.0)
    merged = merge_photographs(
        bracket(camera(), radiance, [1e-3, 10.0], coded=False), [1e-3, 10.0], known_response()
    ).radiance
    gap = merged.status == PixelStatus.DARK
    assert gap.any()
    assert (merged.value[gap] ** 2 <= merged.variance[gap]).all()
    true = true_value(camera(), radiance)
    known = merged.status == PixelStatus.OK
    assert abs(np.median(merged.value[known] / true[known]) - 1) < 0.003


def test_what_contradicts_itself_is_refused_with_the_reason():
    shooter, radiance = camera(), scene(8)
    stack = bracket(shooter, radiance, FIVE)
    swapped = FIVE[[0, 2, 1, 3, 4]]
    with pytest.raises(ImageError, match=r"b has more exposure than c but is darker"):
        merge_photographs(stack, swapped, names=list("abcde"))
    wrong = FIVE * [1, 1, 0.4, 1, 1]
    with pytest.raises(ImageError, match=r"c has 2\.\d* times its stated exposure"):
        merge_photographs(stack, wrong, known_response(), names=list("abcde"))


@pytest.mark.parametrize(
    ("codes", "exposure", "reason"),
    [
        (np.full((1, 8, 8, 3), 100, np.uint8), [1.0], "two or more"),
        (np.full((2, 8, 8, 3), 100, np.uint8), [1.0, 1.0], "two or more"),
        (np.full((1, 8, 8, 3), 100.0), [1.0], "uint8"),
        (np.full((2, 8, 8, 3), 100, np.uint8), [1.0, 0.0], "positive"),
        (np.full((2, 8, 8, 3), 100, np.uint8), [1.0, np.nan], "positive"),
    ],
)
def test_what_is_no_bracket_is_refused(codes, exposure, reason):
    with pytest.raises(ImageError, match=reason):
        merge_photographs(codes, exposure)


def test_a_response_of_other_channels_is_refused():
    with pytest.raises(ImageError, match="not one camera"):
        merge_photographs(np.full((1, 8, 8, 1), 100, np.uint8), [1.0], known_response())


def test_the_share_of_the_response_in_the_variance():
    """Where every sample is exact, what remains is the curve's own error."""
    exact = known_response(sigma_dn=1e-3)
    doubtful = Response(exact.log_exposure, np.full((256, 3), 0.02), exact.code_sigma_dn, exact.coding_sigma_dn)
    merged = merge_photographs(np.full((1, 4, 4, 3), 90, np.uint8), [1.0], doubtful).radiance
    np.testing.assert_allclose(np.sqrt(merged.variance) / merged.value, 0.02, rtol=0.01)


def test_white_pixels_that_jpeg_moved_are_no_measurements():
    """A lamp of 10 000 on black through JPEG: its own light to a percent, where a shorter exposure shows it.

    Beside it, where codes of 244 and 247 agree with the shorter exposure, they count.
    """
    response, exposure = known_response(), np.array([1.0, 8.0, 16.0])
    light = response.light
    codes = np.zeros((3, 1, 2, 3), np.uint8)
    codes[:, 0, 0] = np.array([[200], [247], [244]])
    codes[:, 0, 1] = np.searchsorted(light[:, 0], light[244, 0] * exposure / 16)[:, None]
    merged = merge_photographs(codes[[2, 0, 1]], exposure[[2, 0, 1]], response, names=list("abc")).radiance
    np.testing.assert_allclose(merged.value[0, 0], light[200], rtol=0.01)
    np.testing.assert_allclose(merged.value[0, 1], light[244] / 16, rtol=0.01)
    radiance = np.full((48, 48, 3), 0.05)
    radiance[20:28, 20:28] = 10_000.0
    times = 4.0 ** np.arange(-7, 2)
    stack = bracket(camera(), radiance, times)
    near = (stack >= 236) & (stack < 252)
    assert near[:, 19:29, 19:29].any(), "the case is there"
    found = merge_photographs(stack, times, response).radiance.value[22:26, 22:26]
    assert np.abs(found / true_value(camera(), radiance)[22:26, 22:26] - 1).max() < 0.05
