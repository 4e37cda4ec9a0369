"""Response curves of photographs, against the curve of the simulated camera."""

import cv2
import numpy as np
import pytest

from processing.errors import ImageError
from processing.radiometry import response_kernel
from processing.radiometry.response import Response, exposure_errors, recover_response, srgb_log_exposure
from processing.radiometry.response_file import read_response, write_response
from simulators.picture import log_exposure
from tests.processing.radiometry.pictures import INSIDE, bracket, camera, curve_rms, scene
from tests.reference import photographs as reference

FIVE = 4.0 ** np.arange(-2, 3)


@pytest.mark.parametrize("curve", ["gamma", "shoulder", "film", "flat", "linear"])
def test_known_curves_are_recovered_through_jpeg(curve):
    """All within 0.6 %, where the noise of one code is 1 %; and the stated deviation is no less than half the error."""
    truth = log_exposure(curve)
    response, log_time = recover_response(bracket(camera(curve), scene(), FIVE), FIVE)
    assert curve_rms(response.log_exposure, truth) < 0.006
    error = (response.log_exposure - truth)[INSIDE]
    sigma = np.maximum(response.log_exposure_sigma[INSIDE], 1e-4)
    assert np.sqrt(np.mean((error / sigma) ** 2)) < 2
    assert np.abs(log_time).max() < 0.01
    assert (np.diff(response.log_exposure, axis=0) > 0).all()


@pytest.mark.parametrize("times", [[0.5, 1.0], [0.25, 1.0, 4.0], [0.03, 0.09, 1.5, 5.7]])
def test_any_bracket_gives_a_better_curve_than_opencv(times):
    """The independent referees: Debevec and Malik, and Robertson, as OpenCV solves them, on the same stack."""
    stack, truth, times = bracket(camera("filmic"), scene(1), times), log_exposure("filmic"), np.asarray(times)
    seconds = times.astype(np.float32)
    debevec = np.log(cv2.createCalibrateDebevec(samples=300).process(list(stack), seconds)[:, 0].astype(np.float64))
    robertson = np.log(cv2.createCalibrateRobertson().process(list(stack), seconds)[:, 0].astype(np.float64))
    assert curve_rms(debevec, truth) < 0.1  # they solve the same problem
    response, _ = recover_response(stack, times)
    assert curve_rms(response.log_exposure, truth) < min(curve_rms(debevec, truth), curve_rms(robertson, truth))


def test_channels_that_agree_share_a_curve():
    """Grey stays grey. That channels which differ are told apart, the curve `film` above shows."""
    one, _ = recover_response(bracket(camera("srgb"), scene(), FIVE), FIVE)
    between = np.ptp(one.log_exposure[INSIDE], axis=1)
    assert between.max() < 0.01


def test_the_noise_of_a_code_is_found_with_its_shape():
    """Before coding: shot noise through the curve, larger in channels that the white balance multiplies."""
    shooter = camera("srgb", full_e=4000.0)
    response, _ = recover_response(bracket(shooter, scene(2, decades=3), FIVE, coded=False), FIVE)
    code = np.array([60, 128, 200])
    x = np.exp(srgb_log_exposure())
    slope = np.gradient(x)[code]
    for c, balance in enumerate(shooter.white_balance):
        electrons = x[code] / balance * shooter.full_e
        before = np.sqrt(electrons + shooter.read_noise_e**2) / shooter.full_e * balance / slope
        np.testing.assert_allclose(response.code_sigma_dn[code, c], np.sqrt(before**2 + 1 / 12), rtol=0.1)


def test_a_wrong_exposure_is_found_and_does_not_bend_the_curve():
    """A lamp that flickers by 20 % in one of six exposures."""
    times = 4.0 ** np.arange(-3, 3)
    true = times * np.array([1, 1.2, 1, 1, 1, 1])
    stack = bracket(camera("filmic"), scene(3, decades=5), true)
    response, log_time = recover_response(stack, times)
    relative = log_time - np.median(log_time)
    np.testing.assert_allclose(relative, np.log(true / times), atol=0.02)
    assert curve_rms(response.log_exposure, log_exposure("filmic")) < 0.02
    again = exposure_errors(stack, times, response)
    np.testing.assert_allclose(again - np.median(again), np.log(true / times), atol=0.02)


@pytest.mark.parametrize("wrong", [[1, 1.05], [1.04, 0.96], [0.96, 1, 1.04]])
def test_times_of_few_exposures_may_be_off_and_the_deviation_says_so(wrong):
    """Labels of shutter and aperture are rounded by some percent, which two or three exposures cannot tell."""
    times = 2.0 ** np.arange(len(wrong))
    response, _ = recover_response(bracket(camera("filmic"), scene(4), times * wrong), times)
    error = (response.log_exposure - log_exposure("filmic"))[INSIDE]
    assert np.sqrt(np.mean(error**2)) > 0.01
    assert np.sqrt(np.mean((error / np.maximum(response.log_exposure_sigma[INSIDE], 1e-4)) ** 2)) < 2


def test_pictures_without_overlap_have_no_response():
    grey = np.full((1, 8, 8, 3), 100, np.uint8)
    with pytest.raises(ImageError, match="overlap"):
        recover_response(np.concatenate([grey * 0, grey * 0 + 255]), np.array([1.0, 2.0]))


def test_pictures_of_different_scenes_or_without_shades_have_no_response():
    times = np.array([0.25, 1.0, 4.0])
    with pytest.raises(ImageError, match="no response fits"):
        recover_response(np.concatenate([bracket(camera(), scene(i), times[i : i + 1]) for i in range(3)]), times)
    with pytest.raises(ImageError, match=r"no response fits|overlap"):
        recover_response(bracket(camera(), np.full((48, 48, 3), 1.0), times), times)


def test_a_saved_response_is_the_same(tmp_path):
    truth, plain = log_exposure("film"), np.ones((256, 3))
    truth[0] = truth[1] - 1
    response = Response(truth, 0.01 * plain, plain, plain[0], "Camera")
    write_response(tmp_path / "r.json", response)
    again = read_response(tmp_path / "r.json")
    np.testing.assert_allclose(again.log_exposure, response.log_exposure, atol=1e-6)
    np.testing.assert_allclose(again.light, response.light, rtol=1e-4)
    assert again.camera == "Camera"
    (tmp_path / "r.json").write_text((tmp_path / "r.json").read_text().replace("0.0,", "null,", 1))
    with pytest.raises(ImageError, match="not a response"):
        read_response(tmp_path / "r.json")
    with pytest.raises(ImageError, match="cannot be read"):
        read_response(tmp_path / "absent.json")


def test_kernel_and_its_plain_twin_agree():
    rng = np.random.default_rng(0)
    curve = srgb_log_exposure()
    codes = rng.integers(0, 256, (300, 4)).astype(np.uint8)
    codes[:150] = np.clip(rng.integers(5, 120, (150, 1)) * [0.6, 1, 1.4, 2] + rng.normal(0, 2, (150, 4)), 0, 255)
    weight = 1 / np.gradient(curve) ** 2
    weight[:10] = weight[240:] = 0
    at = np.rint(np.interp(np.linspace(curve[0], curve[-1], 2001), curve, np.arange(256))).astype(np.intp)
    grid = float(curve[0]), 2000 / float(curve[-1] - curve[0]), at
    arguments = codes, np.log([0.4, 1.0, 2.1, 4.5]), np.exp(curve), weight, grid
    for ours, plain in zip(
        response_kernel.normal_equations(*arguments), reference.normal_equations(*arguments), strict=True
    ):
        np.testing.assert_allclose(ours, plain, rtol=1e-9, atol=1e-6)
