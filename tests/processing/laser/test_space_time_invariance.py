"""What a measurement of peak times does not depend on: neighbours, threads, gain, sparks, the length of a stream."""

import tracemalloc

import numba
import numpy as np
import pytest

from processing.laser.peak_tracker import PeakTracker, track_peaks
from processing.laser.pulse_tiles import fit_sweep
from processing.laser.space_time import PeakStatus, PulseSettings, peak_times
from processing.radiometry.sensor import Sensor
from tests.processing.laser.test_space_time import SENSOR, pulses


def mixed_sweep():
    """Two thousand pulses, faint, bright and saturated ones."""
    rng = np.random.default_rng(9)
    return pulses(range(60), rng.uniform(-2, 62, 2000), 10 ** rng.uniform(1, 4.6, 2000), 1.3)


def assert_same(one, other):
    np.testing.assert_array_equal(one.status, other.status)
    np.testing.assert_array_equal(one.time_frames, other.time_frames)
    np.testing.assert_array_equal(one.variance, other.variance)


def test_pixels_do_not_know_their_neighbours():
    """Nor their place among the lanes: in any order they are measured alike, bit by bit."""
    stack, order = mixed_sweep(), np.random.default_rng(10).permutation(2000)
    steady = [track_peaks(s).sweep(np.zeros(0, np.float32)) for s in (stack, stack[..., order])]
    camera = SENSOR.black_dn, SENSOR.gain_e_per_dn, SENSOR.dark_variance_e2, SENSOR.saturation_e
    (one, its_status), (other, status) = (fit_sweep(s, camera, (1.3, 0.2, 5.55), (5.0, 0.4)) for s in steady)
    np.testing.assert_array_equal(its_status[order], status)
    np.testing.assert_array_equal(one[:, order], other)


def test_the_number_of_threads_changes_nothing():
    stack, threads = mixed_sweep(), numba.get_num_threads()
    many = peak_times(stack, SENSOR)
    numba.set_num_threads(1)
    try:
        assert_same(many, peak_times(stack, SENSOR))
    finally:
        numba.set_num_threads(threads)


def test_the_same_electrons_at_another_gain_have_the_same_times():
    """Twice the counts at half the gain; read noise makes up for the finer rounding."""
    stack = mixed_sweep()
    fine = Sensor(512.0, 2 * (4095 - 256 - 0.5) + 0.5 + 512, 2.0, float(np.sqrt(16.0 + (4.0**2 - 2.0**2) / 12.0)))
    one, other = peak_times(stack, SENSOR), peak_times(2 * (stack - 256) + 512, fine)
    np.testing.assert_array_equal(one.status, other.status)
    ok = one.status == PeakStatus.OK
    assert ok.mean() > 0.5
    np.testing.assert_allclose(one.time_frames[ok], other.time_frames[ok], atol=1e-4)
    np.testing.assert_allclose(one.variance[ok], other.variance[ok], rtol=1e-3)


@pytest.mark.parametrize("beside", [-10, 10, 25])
@pytest.mark.parametrize("height_e", [300.0, 600.0, 3000.0, 12000.0])
def test_a_lone_bright_sample_moves_no_time(beside, height_e):
    """A spark ten frames off: where it is lower than the pulse's `double_fraction` it costs nothing, else the pixel."""
    middles = np.random.default_rng(1).uniform(30, 32, 1000)
    stack = pulses(range(70), middles, 2000.0, 1.5)
    stack[np.rint(middles).astype(int) + beside, 0, np.arange(1000)] += np.uint16(height_e / SENSOR.gain_e_per_dn)
    peaks = peak_times(stack, SENSOR, PulseSettings(1.5))
    ok = peaks.status[0] == PeakStatus.OK
    assert ok.all() if height_e <= 600 else not ok.any()
    error = (peaks.time_frames[0] - middles)[ok] / np.sqrt(peaks.variance[0][ok])
    assert np.all(np.abs(error) < 5)


def test_a_stream_needs_no_memory_for_its_frames():
    """Of each frame of 8 KiB a sample of 512 bytes remains, in an array of its own."""
    frame, peaks = np.full((64, 64), 256, np.uint16), []
    for count in (200, 2000):
        tracker = PeakTracker(frame.shape)
        tracemalloc.start()
        for _ in range(count):
            tracker.add(frame)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] - peaks[0] < 1800 * (512 + 256)
