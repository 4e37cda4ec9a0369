"""Samples of many pixels side by side, one pixel per lane: what the fit in lanes starts from.

All rows of a workspace lie in one array at distances known to the compiler: so it sees that they do not overlap.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.laser.block_maxima import AROUND, BLOCK, WINDOW
from processing.laser.pulse import Sweep, first_of_window

LANES = 64
FAST = {"contract", "nsz"}  # multiply and add in one; NaN keeps its meaning
ZERO, ONE = np.float32(0.0), np.float32(1.0)  # a float64 constant would halve the lanes
BACK, FAR, TOP, WHOLE, _SUM = range(0, 5 * LANES, LANES)  # rows of a workspace
ROWS = 5
SHORT = 8  # frames on either side from which a window reaches beyond the blocks beside the brightest

Floats = NDArray[np.float32]


@njit(nogil=True, cache=True)
def are_even(times: NDArray[np.float64]) -> bool:
    """Whether the times count frames: 0, 1, 2, ... from any start."""
    for k in range(times.size):
        if times[k] != times[0] + k:
            return False
    return True


@njit(nogil=True, cache=True)
def gather_times(group: NDArray[np.int32], sweep: Sweep, moments: Floats) -> None:
    """Times of the samples from that of the brightest."""
    brightest, times = sweep[2], sweep[6]
    half = moments.size // LANES // 2
    for lane in range(group.size):
        centre = brightest[group[lane]]
        for j in range(2 * half + 1):
            frame = min(max(centre + j - half, 0), times.size - 1)
            moments[j * LANES + lane] = times[frame] - times[centre]


@njit(nogil=True, cache=True)
def reach_of(half: int) -> int:
    """Samples on either side that are looked at: a narrow pulse's, and what is beside it in blocks next to its own."""
    return max(half, SHORT - 1)


@njit(nogil=True, cache=True, error_model="numpy")
def gather(
    group: NDArray[np.int32], sweep: Sweep, known: tuple[float, float, int], samples: Floats, work: Floats
) -> None:
    """Electrons about the brightest frame; background, brightest sample of these and brightest of others.

    `known`: black_dn, gain_e_per_dn, samples that are fitted on either side. WHOLE tells the pixels all of whose
    samples exist.
    """
    frames, origin, brightest, maxima, total, ambient, times = sweep
    reach, last, flat = samples.size // LANES // 2, times.size - 1, frames.reshape(-1)
    pixel, centre, place = np.empty(LANES, np.int64), np.empty(LANES, np.int64), np.empty(LANES, np.uint64)
    others = 2 if reach < SHORT else 1
    for lane in range(LANES):
        pixel[lane] = group[min(lane, group.size - 1)]
        centre[lane] = brightest[pixel[lane]]
        whole = reach <= centre[lane] <= last - reach
        row = centre[lane] - reach - origin[pixel[lane]] if whole else 0
        place[lane] = row * frames.shape[1] + pixel[lane]
        work[WHOLE + lane] = ONE if whole else ZERO
        work[FAR + lane] = maxima[others, pixel[lane]]
        work[BACK + lane] = total[pixel[lane]]
    for j in range(2 * reach + 1):
        row_of_samples, skip = samples[j * LANES : (j + 1) * LANES], np.uint64(j * frames.shape[1])
        for lane in range(LANES):
            row_of_samples[lane] = flat[place[lane] + skip]
    for distance in range(reach + 1, 1 if reach < SHORT else (AROUND + 1) * BLOCK):
        _look_around(distance, (pixel, centre), sweep, work)
    _to_electrons(samples, known, float(last - 2 * known[2]), work)
    if ambient.size > 0:
        _subtract_ambient(samples, centre, ambient, work)


@njit(nogil=True, cache=True)
def _look_around(distance: int, lanes: tuple[NDArray[np.int64], NDArray[np.int64]], sweep: Sweep, work: Floats) -> None:
    """Take the samples at this distance on either side of the brightest, where the window has them, into FAR."""
    frames, origin, last = sweep[0], sweep[1], sweep[6].size - 1
    pixel, centre = lanes
    for lane in range(LANES):
        start = first_of_window(centre[lane])
        before = max(centre[lane] - distance, start, 0) - origin[pixel[lane]]
        after = min(centre[lane] + distance, start + WINDOW - 1, last) - origin[pixel[lane]]
        highest = max(frames[before, pixel[lane]], frames[after, pixel[lane]])
        work[FAR + lane] = max(work[FAR + lane], np.float32(highest))


@njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def _to_electrons(samples: Floats, known: tuple[float, float, int], others: float, work: Floats) -> None:
    """Background from the frames that are not fitted; brightest samples inside (TOP) and outside (FAR) of the fit."""
    black, gain, frames = np.float32(known[0]), np.float32(known[1]), np.float32(others)
    skip = (samples.size // LANES // 2 - known[2]) * LANES
    for lane in range(LANES):
        work[TOP + lane], work[_SUM + lane] = ZERO, ZERO
    for j in range(0, samples.size, LANES):
        row = samples[j : j + LANES]
        if skip <= j < samples.size - skip:
            for lane in range(LANES):
                count, top = row[lane], work[TOP + lane]
                work[_SUM + lane] += count
                work[TOP + lane] = count if count > top else top
                row[lane] = (count - black) * gain
        else:
            for lane in range(LANES):
                count, top = row[lane], work[FAR + lane]
                work[FAR + lane] = count if count > top else top
    for lane in range(LANES):
        work[BACK + lane] = ((work[BACK + lane] - work[_SUM + lane]) / frames - black) * gain
        work[FAR + lane], work[TOP + lane] = (work[FAR + lane] - black) * gain, (work[TOP + lane] - black) * gain


@njit(nogil=True, cache=True, error_model="numpy")
def _subtract_ambient(samples: Floats, centre: NDArray[np.int64], ambient: Floats, work: Floats) -> None:
    """Take out what the ambient light does around the brightest frame; the background is then that of this frame."""
    half = samples.size // LANES // 2
    for j in range(2 * half + 1):
        for lane in range(LANES):
            frame = min(max(centre[lane] + j - half, 0), ambient.size - 1)
            samples[j * LANES + lane] -= (ambient[frame] - ambient[centre[lane]]) * work[BACK + lane]
    for lane in range(LANES):
        work[BACK + lane] *= ONE + ambient[centre[lane]]
