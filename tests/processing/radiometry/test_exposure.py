"""Exposure times by what the frames of a stack say of the same pixels."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.radiometry.exposure import ExposureTimes, TimesVerdict, exposure_times, times_error
from processing.radiometry.overlap_kernel import overlap_sums
from processing.radiometry.sensor import Sensor
from tests.processing.radiometry.test_hdr import EXPOSURE_S, SENSOR, photograph
from tests.reference import overlap as twin

quick = settings(max_examples=8, deadline=None)
FLICKER = np.array([1.01, 0.99, 1.01, 0.99, 1.0])


def scene(shape=(96, 128), decades=1.5, seed=0):
    """Waves and texture around 1000 e-/s."""
    y, x = np.indices(shape)
    grain = np.random.default_rng(seed).normal(size=shape)
    return 10 ** (3 + decades * np.sin(y / 11) * np.cos(x / 17) + 0.1 * grain)


SCENE = scene()


def bound(radiance, exposure_s):
    """Cramer-Rao covariance of the log scales in the gauge of a zero mean: every pixel's radiance is unknown too."""
    mean = np.multiply.outer(exposure_s, np.ravel(radiance))
    known = np.where(mean < SENSOR.saturation_e, mean**2 / (mean + SENSOR.dark_variance_e2), 0)
    information = np.diag(known.sum(1)) - (known / np.maximum(known.sum(0), 1e-300)) @ known.T
    gauge = np.eye(len(exposure_s)) - 1 / len(exposure_s)
    return gauge @ np.linalg.pinv(information, hermitian=True) @ gauge


SCENES = {
    "waves": SCENE,
    "ramp": np.tile(np.geomspace(1.5, 4e5, 128), (96, 1)),
    "noise of five decades": 10 ** np.random.default_rng(3).uniform(0, 5.5, (96, 128)),
    "a flat wall": np.full((96, 128), 5000.0),
}


@pytest.mark.parametrize("name", SCENES)
def test_error_reaches_the_bound_and_sigma_says_so(name):
    """60 stacks times 4 free scales determine an rms to 4.6 %; both limits allow for three times that."""
    rng, true_s = np.random.default_rng(1), EXPOSURE_S * FLICKER
    truth = np.log(FLICKER) - np.log(FLICKER).mean()
    limit = np.sqrt(np.diag(bound(SCENES[name], true_s)))
    found = [exposure_times(photograph(SCENES[name], true_s, rng), EXPOSURE_S, SENSOR) for _ in range(60)]
    error = np.array([np.log(one.scale) for one in found]) - truth
    assert np.sqrt(np.mean((error / limit) ** 2)) < 1.05 + 0.138
    assert np.sqrt(np.mean((error / [one.sigma for one in found]) ** 2)) == pytest.approx(1, abs=0.138)
    assert np.abs(error.mean(0) / limit).max() < 4.5 / np.sqrt(60)
    assert all(one.verdict == TimesVerdict.CORRECTED for one in found)


def test_sums_equal_their_numpy_twin():
    rng = np.random.default_rng(0)
    raw = photograph(scene((40, 50)), EXPOSURE_S, rng).reshape(5, 2, 20, 50).astype(np.float32)
    raw[2, 0, 3:9] = np.nan
    numbers = (256.0, 4095.0, 4.0, SENSOR.dark_variance_e2)
    ceiling, edges = 14000 / EXPOSURE_S, np.array([10.0, 100.0, 1000.0])
    sums, counts = overlap_sums(raw, EXPOSURE_S, numbers, ceiling, edges)
    expected_sums, expected_counts = twin.overlap_sums(raw, EXPOSURE_S, numbers, ceiling, edges)
    np.testing.assert_array_equal(counts, expected_counts)
    np.testing.assert_allclose(sums, expected_sums, rtol=1e-12)


@quick
@given(st.integers(0, 2**32), st.floats(1e-5, 1e5))
def test_the_unit_of_time_does_not_matter(seed, factor):
    raw = photograph(SCENE, EXPOSURE_S * FLICKER, np.random.default_rng(seed))
    one, other = exposure_times(raw, EXPOSURE_S, SENSOR), exposure_times(raw, EXPOSURE_S * factor, SENSOR)
    np.testing.assert_allclose(other.scale, one.scale, rtol=1e-6)
    np.testing.assert_allclose(other.sigma, one.sigma, rtol=1e-3)


@quick
@given(st.integers(0, 2**32), st.permutations(range(5)))
def test_the_order_of_frames_does_not_matter(seed, order):
    raw = photograph(SCENE, EXPOSURE_S * FLICKER, np.random.default_rng(seed))
    one = exposure_times(raw, EXPOSURE_S, SENSOR)
    other = exposure_times(raw[order], EXPOSURE_S[order], SENSOR)
    np.testing.assert_allclose(other.scale, one.scale[order], rtol=1e-6)


@quick
@given(st.integers(0, 2**32))
def test_float_counts_give_the_same_times(seed):
    raw = photograph(SCENE, EXPOSURE_S, np.random.default_rng(seed))
    whole, single, double = (exposure_times(raw.astype(d), EXPOSURE_S, SENSOR) for d in ("u2", "f4", "f8"))
    np.testing.assert_array_equal(whole.scale, single.scale)
    np.testing.assert_array_equal(whole.scale, double.scale)


def test_right_times_stay_as_stated():
    """A false correction of any of 25 stacks would be one of 125 departures beyond four sigma: 0.8 % in all."""
    rng = np.random.default_rng(5)
    for _ in range(25):
        found = exposure_times(photograph(SCENE, EXPOSURE_S, rng), EXPOSURE_S, SENSOR)
        assert found.verdict == TimesVerdict.CONSISTENT
        np.testing.assert_array_equal(found.exposure_s, EXPOSURE_S)


@quick
@given(st.integers(0, 2**32), st.integers(0, 4), st.sampled_from([0.25, 0.5, 2.0, 4.0]))
def test_one_time_that_is_wrong_is_named_and_measured(seed, frame, factor):
    stated_s = EXPOSURE_S.copy()
    stated_s[frame] *= factor
    raw = photograph(SCENE, EXPOSURE_S, np.random.default_rng(seed))
    found = exposure_times(raw, stated_s, SENSOR)
    assert found.verdict == TimesVerdict.CONTRADICTED
    assert found.gross.tolist() == [frame]
    assert not found.swapped
    np.testing.assert_allclose(found.exposure_s, EXPOSURE_S, rtol=5e-3)
    message = str(times_error(found, list("abcde")))
    assert message.startswith("wrong exposure times")
    assert f"{'abcde'[frame]} states {stated_s[frame]:.4g} s and measures" in message


@quick
@given(st.integers(0, 2**32), st.sets(st.integers(0, 4), min_size=2, max_size=2))
def test_two_swapped_times_are_called_that(seed, pair):
    one, other = pair
    stated_s = EXPOSURE_S.copy()
    stated_s[[one, other]] = stated_s[[other, one]]
    found = exposure_times(photograph(SCENE, EXPOSURE_S, np.random.default_rng(seed)), stated_s, SENSOR)
    assert found.verdict == TimesVerdict.CONTRADICTED
    assert found.swapped
    assert sorted(found.gross.tolist()) == sorted(pair)
    np.testing.assert_allclose(found.exposure_s, EXPOSURE_S, rtol=5e-3)
    assert str(times_error(found, list("abcde"))).startswith("swapped exposure times")


@quick
@given(st.integers(0, 2**32), st.floats(0.0, 0.35), st.integers(0, 4))
def test_what_moved_does_not_matter(seed, share, frame):
    rng = np.random.default_rng(seed)
    raw = photograph(SCENE, EXPOSURE_S * FLICKER, rng)
    rows = int(share * SCENE.shape[0])
    raw[frame, :rows] = photograph(SCENE[:rows, ::-1] * 3, EXPOSURE_S[frame : frame + 1], rng)[0]
    found = exposure_times(raw, EXPOSURE_S, SENSOR)
    truth = np.log(FLICKER) - np.log(FLICKER).mean()
    assert (
        np.abs((np.log(found.scale) - truth) / found.sigma).max() < 6
    )  # of 40 draws, with room for what is half hidden
    if share > 0.1:
        assert found.disturbed_share > 0.3 * share


def test_two_frames_share_their_disagreement():
    raw = photograph(SCENE, [0.1, 1.0], np.random.default_rng(0))
    found = exposure_times(raw, [0.1, 2.0], SENSOR)
    assert found.verdict == TimesVerdict.CONTRADICTED
    np.testing.assert_allclose(found.scale, [np.sqrt(2), 1 / np.sqrt(2)], rtol=5e-3)
    message = str(times_error(found, ["a", "b"]))
    assert "of a (0.1 s) and b (2 s) one is stated to have 20 times the other's light and has" in message


UNDETERMINED = {
    "all dark": (np.zeros_like(SCENE), EXPOSURE_S),
    "all saturated": (np.full_like(SCENE, 1e9), EXPOSURE_S),
    "a ratio of a million": (SCENE, [1e-6, 1.0]),
    "a ratio of a million over ten decades": (10 ** np.random.default_rng(0).uniform(0, 10, (64, 64)), [1e-6, 1.0]),
    "one frame": (SCENE, [1.0]),
}


@pytest.mark.parametrize("name", UNDETERMINED)
def test_without_overlap_the_stated_times_stay(name):
    radiance, times = UNDETERMINED[name]
    found = exposure_times(photograph(radiance, times, np.random.default_rng(2)), times, SENSOR)
    assert found.verdict == TimesVerdict.UNDETERMINED
    np.testing.assert_array_equal(found.exposure_s, times)
    assert np.isinf(found.sigma).all()


def test_frames_of_nan_or_without_overlap_keep_their_time_and_the_others_are_measured():
    raw = photograph(SCENE, EXPOSURE_S * FLICKER, np.random.default_rng(0)).astype(np.float32)
    raw[1, 20:30] = np.nan
    raw[3] = np.nan
    found = exposure_times(raw, EXPOSURE_S, SENSOR)
    assert np.isinf(found.sigma).tolist() == [False, False, False, True, False]
    assert found.scale[3] == 1
    others = [0, 1, 2, 4]
    truth = np.log(FLICKER[others]) - np.log(FLICKER[others]).mean()
    assert np.abs((np.log(found.scale[others]) - truth) / found.sigma[others]).max() < 5


def test_a_hundred_exposures():
    """The shortest hold too few counts above the black level to be compared, and keep their times."""
    times = np.geomspace(1e-3, 2, 100)
    jitter = np.exp(np.random.default_rng(0).normal(0, 0.03, 100))
    found = exposure_times(photograph(SCENE, times * jitter, np.random.default_rng(1)), times, SENSOR)
    known = np.isfinite(found.sigma)
    assert known.sum() > 70
    truth = np.log(jitter[known]) - np.log(jitter[known]).mean()
    pull = (np.log(found.scale[known]) - truth) / found.sigma[known]
    assert np.sqrt(np.mean(pull**2)) == pytest.approx(1, abs=0.3)


def test_a_black_level_that_is_off_feigns_no_flicker():
    radiance = np.tile(np.geomspace(20, 2e4, 128), (96, 1))
    raw = photograph(radiance, EXPOSURE_S, np.random.default_rng(0)).astype(np.float32) + np.float32(0.1)
    found = exposure_times(raw, EXPOSURE_S, SENSOR)
    assert found.verdict == TimesVerdict.CONSISTENT


def test_a_converter_that_clips_the_darks_does_no_harm():
    sensor = Sensor(black_dn=0, white_dn=4095, gain_e_per_dn=4, read_noise_e=12)
    found = exposure_times(photograph(SCENE, EXPOSURE_S, np.random.default_rng(0), sensor), EXPOSURE_S, sensor)
    assert found.verdict == TimesVerdict.CONSISTENT


@pytest.mark.parametrize(
    ("shape", "times"), [((2, 3), [1, 2]), ((2, 3, 3), [1]), ((0, 3, 3), []), ((1, 3, 3), [-1]), ((1, 3, 3), [np.inf])]
)
def test_what_is_no_stack_is_refused(shape, times):
    with pytest.raises(ImageError):
        exposure_times(np.zeros(shape, np.uint16), times, SENSOR)


def test_a_time_is_gross_beyond_doubt_only():
    """A frame 25 % off is gross where that is known to a percent, not where it is known to a tenth."""
    for sigma, gross in ((0.005, [0]), (0.1, [])):
        found = ExposureTimes(np.ones(3), np.array([1.25, 1.0, 1.0]), np.full(3, sigma), 0.0)
        assert found.gross.tolist() == gross
