"""Peak times: at the Cramer-Rao bound, with a variance that is true, and a status instead of an exception."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.laser import pulse
from processing.laser.ambient import ambient_change
from processing.laser.estimators import Estimator
from processing.laser.peak_tracker import track_peaks
from processing.laser.space_time import PeakStatus, PulseSettings, fit_peaks, peak_times, typical_width
from processing.radiometry.sensor import Sensor
from tests.benchmarks.yardsticks.located_sweeps import brick
from tests.reference import space_time as twin

SENSOR = Sensor(256.0, 4095.0, 4.0, 4.0)


def pulses(times, middles, amplitude, width, seed=0, background=40.0):
    """Frames (t, 1, n) in raw_dn of Gaussian pulses."""
    rng = np.random.default_rng(seed)
    u = (np.asarray(times, float)[:, None] - middles) / width
    electrons = rng.poisson(amplitude * np.exp(-0.5 * u * u) + background)
    dn = (electrons + rng.normal(0, SENSOR.read_noise_e, electrons.shape)) / SENSOR.gain_e_per_dn + SENSOR.black_dn
    return np.clip(np.rint(dn), 0, SENSOR.white_dn).astype(np.uint16)[:, None, :]


def bound(width, amplitude, frames=60, background=40.0, full_e=np.inf):
    """Cramer-Rao bound of the time in frames, over sub-frame positions; amplitude, background and width unknown too."""
    found = []
    for middle in frames / 2 + np.linspace(0, 1, 11):
        u = (np.arange(frames) - middle) / width
        bell = np.exp(-0.5 * u * u)
        variance = amplitude * bell + background + SENSOR.dark_variance_e2
        weight = np.where(amplitude * bell + background < full_e, 1 / variance + 0.5 / variance**2, 0.0)
        slopes = np.stack([amplitude * bell * u / width, bell, np.ones(frames), amplitude * bell * u * u])
        found.append(np.linalg.inv((slopes * weight) @ slopes.T)[0, 0])
    return float(np.sqrt(np.mean(found)))


@pytest.mark.parametrize("width", [0.7, 1.5, 3.0])
@pytest.mark.parametrize("amplitude", [100, 1000, 10000])
def test_peak_time_reaches_the_bound(width, amplitude):
    """The error is within 5 % of the bound and sigma says so itself; 4000 pulses tell both to 1.2 %."""
    middles = np.random.default_rng(1).uniform(20, 40, 4000)
    peaks = peak_times(pulses(range(60), middles, amplitude, width), SENSOR)
    ok = peaks.status[0] == PeakStatus.OK
    error = peaks.time_frames[0][ok] - middles[ok]
    assert ok.mean() > 0.998
    assert np.sqrt(np.mean(error**2)) / bound(width, amplitude) < 1.05
    assert 0.95 < np.sqrt(np.mean(error**2 / peaks.variance[0][ok])) < 1.08
    assert np.abs(error).max() < 6 * bound(width, amplitude)


def test_saturated_tops_cost_little_more_than_their_samples():
    """A third above full well, the pulse is timed by its flanks, within 10 % of what they allow."""
    middles = np.random.default_rng(1).uniform(20, 40, 4000)
    amplitude = 1.3 * SENSOR.saturation_e
    peaks = peak_times(pulses(range(60), middles, amplitude, 1.5), SENSOR, PulseSettings(width_frames=1.5))
    ok = peaks.status[0] == PeakStatus.OK
    error = peaks.time_frames[0][ok] - middles[ok]
    assert ok.mean() > 0.99
    assert np.sqrt(np.mean(error**2)) < 1.1 * bound(1.5, amplitude, full_e=SENSOR.saturation_e)
    assert 0.9 < np.sqrt(np.mean(error**2 / peaks.variance[0][ok])) < 1.15


def any_stack(seed, width, amplitude, frames):
    """Twelve pixels, dark, cut off, doubled and saturated ones among them."""
    rng = np.random.default_rng(seed)
    stack = pulses(range(frames), rng.uniform(-2, frames + 2, 12), amplitude, width, seed)
    return np.maximum(stack, pulses(range(frames), rng.uniform(-20, 2 * frames, 12), 0.6 * amplitude, width, seed + 1))


def careful_fits(stack, width):
    """What the careful fit alone makes of every pixel, without the lanes: rows (pixels, FIELDS)."""
    sweep = track_peaks(stack).sweep(np.zeros(0, np.float32))
    camera = SENSOR.black_dn, SENSOR.gain_e_per_dn, SENSOR.dark_variance_e2, SENSOR.saturation_e
    rows = np.empty((stack.shape[2], pulse.FIELDS))
    for pixel, row in enumerate(rows):
        pulse.fit_pixel(pixel, sweep, (camera, (width, 0.2, 3.5 * width + 1.0), (5.0, 0.4)), row)
    return rows


ANY = {
    "seed": st.integers(0, 10**6),
    "width": st.floats(0.6, 3.0),
    "amplitude": st.floats(20.0, 40000.0),
    "frames": st.integers(1, 70),
}


@given(**ANY)
@settings(max_examples=30, deadline=None, derandomize=True)
def test_kernel_equals_its_twin(seed, width, amplitude, frames):
    """Same statuses, times, variances and amplitudes as plain NumPy, whatever the pixel.

    Both take the same steps until one moves the time by less than a thousandth of sigma, the amplitude by less than a
    hundredth: where rounding makes one of them stop a step earlier, they are no further apart.
    """
    stack = any_stack(seed, width, amplitude, frames)
    for pixel, row in enumerate(careful_fits(stack, width)):
        time, variance, amplitude_e, status = twin.peak_time(stack[:, 0, pixel], SENSOR, width, 0.2)
        assert row[pulse.STATUS] == status
        if status == PeakStatus.OK:
            assert row[pulse.TIME] == pytest.approx(time, abs=1e-3 * np.sqrt(variance))
            assert row[pulse.VARIANCE] == pytest.approx(variance, rel=0.02)
            assert row[pulse.AMPLITUDE] == pytest.approx(amplitude_e, rel=0.01)


@given(**ANY)
@settings(max_examples=30, deadline=None, derandomize=True)
def test_lanes_equal_the_careful_fit(seed, width, amplitude, frames):
    """Same statuses; times and amplitudes within 0.3 of their sigmas, variances within 15 %.

    Lanes stop where the last step gained less than 0.02 of chi square: it was shorter than 0.14 sigma, and as each is
    at most two thirds of the one before it, what remains is less than 0.3. Their variance is that before the last step,
    which changed amplitude (six sigmas and more) and width by 3 %, and leaves out what time and shape of a pulse share:
    5 % at the width of 0.65 below which lanes decide nothing.
    """
    stack = any_stack(seed, width, amplitude, frames)
    assume(ambient_change(stack[:, 0], SENSOR.black_dn, width).size == 0)  # two stripes of twelve pixels can look so
    peaks = peak_times(stack, SENSOR, PulseSettings(width_frames=width))
    for pixel, row in enumerate(careful_fits(stack, width)):
        assert peaks.status[0, pixel] == row[pulse.STATUS]
        if row[pulse.STATUS] == PeakStatus.OK:
            sigma, noise = np.sqrt(row[[pulse.VARIANCE, pulse.AMPLITUDE_VARIANCE]])
            assert peaks.time_frames[0, pixel] == pytest.approx(row[pulse.TIME], abs=0.3 * sigma)
            assert peaks.amplitude_e[0, pixel] == pytest.approx(row[pulse.AMPLITUDE], abs=0.3 * noise)
            assert peaks.variance[0, pixel] == pytest.approx(row[pulse.VARIANCE], rel=0.15)
        else:
            assert np.isnan(peaks.time_frames[0, pixel])


@pytest.mark.parametrize("width", [0.7, 1.5, 3.0])
@pytest.mark.parametrize("times_full", [1.3, 3.0])
def test_a_wholly_saturated_sweep_tells_its_width(width, times_full):
    """Flanks tell the pulses' width where no top does, and none of their light is taken for a lamp that moves."""
    middles = np.random.default_rng(1).uniform(20, 50, 1000)
    amplitude = times_full * SENSOR.saturation_e
    profiles = track_peaks(pulses(range(70), middles, amplitude, width))
    assert ambient_change(profiles.sample_dn, SENSOR.black_dn, width).size == 0
    assert typical_width(profiles, SENSOR, PulseSettings()) == pytest.approx(width, rel=0.02)
    peaks = fit_peaks(profiles, SENSOR, PulseSettings())
    ok = peaks.status[0] == PeakStatus.OK
    error = (peaks.time_frames[0] - middles)[ok]
    assert ok.mean() > 0.75
    assert np.sqrt(np.mean(error**2)) < 1.2 * bound(width, amplitude, 70, full_e=SENSOR.saturation_e)
    assert 0.9 < np.sqrt(np.mean(error**2 / peaks.variance[0][ok])) < 1.1  # four standard errors of 800


def test_centroids_of_a_stream_are_those_of_the_array():
    """A stream keeps twelve frames on either side: wider pulses have no centroid, and their status says so."""
    for width, known in [(3.9, True), (4.1, False)]:
        stack = pulses(range(80), np.linspace(35, 45, 50), 3000.0, width)
        array, stream = (
            peak_times(frames, SENSOR, PulseSettings(width, estimator=Estimator.CENTROID))
            for frames in (stack, iter(stack))
        )
        np.testing.assert_array_equal(array.time_frames, stream.time_frames)
        assert np.all((array.status == PeakStatus.OK) == known)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=20, deadline=None, derandomize=True)
def test_a_reversed_sweep_is_the_same_measurement(seed):
    """Up to where the steps of a fit end, from either side."""
    stack = pulses(range(50), np.random.default_rng(seed).uniform(10, 40, 20), 3000.0, 1.2, seed)
    forth = peak_times(stack, SENSOR, PulseSettings(width_frames=1.2))
    back = peak_times(stack[::-1], SENSOR, PulseSettings(width_frames=1.2))
    assert np.array_equal(forth.status, back.status)
    assert np.all(np.abs(forth.time_frames - (49 - back.time_frames)) < 0.3 * np.sqrt(forth.variance))


def test_one_pass_over_any_iterable():
    """A generator of frames gives what the array gives, bit by bit."""
    stack = pulses(range(60), np.linspace(5, 55, 40), 2000.0, 1.0)
    array, stream = peak_times(stack, SENSOR), peak_times((frame for frame in stack), SENSOR)
    np.testing.assert_array_equal(array.time_frames, stream.time_frames)
    np.testing.assert_array_equal(array.variance, stream.variance)


def test_pixels_outside_the_mask_are_not_wanted():
    """They say so; those inside are measured as if there were no mask."""
    stack = pulses(range(60), np.linspace(15, 45, 400), 1500.0, 1.0)
    mask = np.arange(400)[None] % 3 == 0
    full, part = (peak_times(stack, SENSOR, PulseSettings(1.0), mask=m) for m in (None, mask))
    assert np.all(part.status[~mask] == PeakStatus.NOT_WANTED)
    assert np.all(np.isnan(part.time_frames[~mask]))
    np.testing.assert_array_equal(part.time_frames[mask], full.time_frames[mask])
    with pytest.raises(ImageError, match="mask"):
        peak_times(stack, SENSOR, mask=mask[:, 1:])


@pytest.mark.parametrize("estimator", [Estimator.CENTROID, Estimator.PARABOLA])
@pytest.mark.parametrize("width", [0.8, 1.5, 2.5])
@pytest.mark.parametrize("amplitude", [3000, 10000])
def test_other_estimators_say_how_good_they_are(estimator, width, amplitude):
    """Worse than the bound, and their variances say by how much, systematic errors included."""
    middles = np.random.default_rng(2).uniform(20, 40, 4000)
    peaks = peak_times(pulses(range(60), middles, amplitude, width), SENSOR, PulseSettings(width, estimator=estimator))
    ok = peaks.status[0] == PeakStatus.OK
    error = peaks.time_frames[0][ok] - middles[ok]
    assert ok.mean() > 0.99
    assert np.sqrt(np.mean(error**2)) > 0.98 * bound(width, amplitude)
    assert 0.8 < np.sqrt(np.mean(error**2 / peaks.variance[0][ok])) < 1.25


@pytest.mark.parametrize("ambient", ["ramp", "flicker"])
def test_moving_ambient_light_neither_shifts_nor_doubles(ambient):
    """A lamp that moves by 30 % of a pulse's height: times keep to their bound, and no pulse is called double."""
    rng, middles = np.random.default_rng(4), np.random.default_rng(5).uniform(20, 100, 3000)
    phase = np.arange(120) / 120
    level = phase if ambient == "ramp" else 0.5 + 0.5 * np.sin(2 * np.pi * 3 * phase)
    light = 40 + 300 * level[:, None] * rng.uniform(0.3, 1.0, 3000)
    u = (np.arange(120)[:, None] - middles) / 1.5
    electrons = rng.poisson(1000 * np.exp(-0.5 * u * u) + light) + rng.normal(0, 4, u.shape)
    stack = np.clip(np.rint(electrons / 4 + 256), 0, 4095).astype(np.uint16)[:, None]
    peaks = peak_times(stack, SENSOR)
    ok = peaks.status[0] == PeakStatus.OK
    error = (peaks.time_frames[0] - middles)[ok]
    assert ok.mean() > 0.99
    assert np.mean(peaks.status == PeakStatus.DOUBLE) < 1e-3
    assert np.sqrt(np.mean(error**2)) < 1.1 * bound(1.5, 1000, 120, 250.0)


def test_common_width_is_found():
    stack = pulses(range(60), np.linspace(15, 45, 400), 1500.0, 2.2)
    assert typical_width(track_peaks(stack), SENSOR, PulseSettings()) == pytest.approx(2.2, rel=0.02)


def test_a_dropped_frame_costs_noise_but_no_bias():
    times = np.delete(np.arange(60.0), 30)
    middles = np.random.default_rng(3).uniform(28, 32, 2000)
    peaks = peak_times(pulses(times, middles, 2000.0, 1.2), SENSOR, times=times)
    ok = peaks.status[0] == PeakStatus.OK
    error = (peaks.time_frames[0] - middles)[ok]
    assert ok.mean() > 0.95
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(ok.sum())
    assert 0.9 < np.sqrt(np.mean(error**2 / peaks.variance[0][ok])) < 1.15


def test_two_comparable_stripes_are_no_measurement():
    """Ten or thirty frames apart; a ghost of a tenth is ignored."""
    middles = np.full(200, 20.0)
    once = pulses(range(70), middles, 3000.0, 1.0).astype(int) - 256
    for apart in (5, 10, 30):
        ghost = pulses(range(70), middles + apart, 3000.0, 1.0, seed=2).astype(int) - 256
        both = peak_times((once + 0.7 * ghost + 256).astype(np.uint16), SENSOR)
        faint = peak_times((once + 0.1 * ghost + 256).astype(np.uint16), SENSOR)
        assert np.isin(both.status, (PeakStatus.DOUBLE, PeakStatus.DISTORTED)).mean() > 0.98
        assert np.mean(faint.status == PeakStatus.OK) > 0.98


def test_without_a_stripe_every_pixel_is_dark():
    """Noise alone passes in less than one pixel of ten thousand."""
    dark = pulses(range(90), np.zeros(20000), 0.0, 1.0)
    assert np.mean(peak_times(dark, SENSOR).status != PeakStatus.TOO_DARK) < 1e-4


def test_a_hot_pixel_is_dark():
    assert np.all(peak_times(np.full((60, 4, 4), 4000, np.uint16), SENSOR).status == PeakStatus.TOO_DARK)


def test_pulses_at_the_ends_are_cut_off():
    stack = pulses(range(40), np.array([-0.5, 0.2, 38.8, 39.4]), 3000.0, 1.2)
    peaks = peak_times(stack, SENSOR, PulseSettings(width_frames=1.2))
    assert np.all(peaks.status == PeakStatus.CUT_OFF)


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_too_few_frames_are_a_status(frames):
    peaks = peak_times(pulses(range(frames), np.zeros(5), 3000.0, 1.0), SENSOR)
    assert np.all(peaks.status == PeakStatus.CUT_OFF)
    assert np.all(np.isnan(peaks.time_frames))


@pytest.mark.parametrize(
    "frames",
    [
        [],
        [np.zeros((4, 4), np.uint16), np.zeros((4, 5), np.uint16)],
        [np.zeros((4, 4), np.uint8)],
        [np.zeros((4, 4, 3), np.uint16)],
        np.zeros((5, 4, 4), np.float32),
        np.zeros((5, 4, 4), np.int16),
    ],
)
def test_frames_that_are_no_sweep_are_refused(frames):
    with pytest.raises(ImageError):
        peak_times(frames, SENSOR)


def test_times_must_rise():
    with pytest.raises(ImageError, match="rising"):
        peak_times(np.zeros((3, 2, 2), np.uint16), SENSOR, times=[0, 2, 1])


def test_a_frame_recorded_twice_counts_once():
    """Where the times say so; two different frames at one time are refused."""
    stack = pulses(range(50), np.linspace(15, 35, 40), 2000.0, 1.0)
    order = np.sort(np.append(np.arange(50), [10, 24, 25]))
    once, twice = peak_times(stack, SENSOR), peak_times(stack[order], SENSOR, times=order)
    np.testing.assert_array_equal(once.time_frames, twice.time_frames)
    stack[11] += 1
    with pytest.raises(ImageError, match="differ"):
        peak_times(stack, SENSOR, times=[*range(11), 10, *range(12, 50)])


def test_reflectance_step_is_an_eighth_of_the_spatial_error():
    """At a 10:1 step of reflectance the spatial centroid is off; timing each pixel removes 85 % of it.

    Curless and Levoy 1995 state 85 %. Pixels 0.5 mm wide, stripe 0.8 mm, 1.13 mm per frame.
    """
    fine = np.arange(-20, 20, 0.02) + 0.01
    albedo = np.where(fine < 0, 0.1, 1.0)
    stripe = -40 + 1.13 * np.arange(71)
    light = albedo * np.exp(-0.5 * ((fine - stripe[:, None]) / 0.8) ** 2)
    frames = light.reshape(71, -1, 25).mean(axis=2) * 12000
    pixels = fine.reshape(-1, 25).mean(axis=1)
    raw = np.rint(frames / 4 + 256).astype(np.uint16)[:, None, :]
    near = np.abs(pixels) < 3
    timed = -40 + 1.13 * peak_times(raw, SENSOR).time_frames[0] - pixels
    crossing = np.abs(stripe) < 3
    centroid = (frames @ pixels / frames.sum(axis=1))[crossing] - stripe[crossing]
    assert np.all(np.isfinite(timed[near]))
    assert np.sqrt(np.mean(timed[near] ** 2)) < 0.15 * np.sqrt(np.mean(centroid**2))


def test_next_to_no_light_is_steady():
    """In a dark room a grazing stripe leaves few pixels in some frames: noise over nothing is no lamp that moves."""
    profiles = track_peaks(brick(1).sweep.frames)
    assert ambient_change(profiles.sample_dn, 256.0, 0.9).size == 0
