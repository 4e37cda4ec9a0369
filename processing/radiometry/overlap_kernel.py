"""The loop that gathers what several exposures say of the same pixels, compiled by numba; its twin: tests/reference."""

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

BLOCK_PX = 32  # side of the squares in which samples are summed: what moves spoils its square alone


@njit(parallel=True, cache=True)
def overlap_sums(
    raw_dn: NDArray[np.generic],
    exposure_s: NDArray[np.float64],
    sensor: tuple[float, float, float, float],
    ceiling: NDArray[np.float64],
    edges: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Electrons (patch, block, class, k) and pixel counts (patch, block, class) of patches (k, n, h, w).

    Exposures rise; `sensor` = (black_dn, white_dn, gain, dark variance). A pixel's class is j - 1 where its first j
    frames count, j < k, and k - 1 + its level between `edges` where all do. Frame j counts where the rate estimated
    from the first j frames together is under its `ceiling`, both in electrons per second: that estimate is sufficient,
    so that the ratios of its samples, which are to be measured, do not depend on the choice.
    """
    frames, patches, height, width = raw_dn.shape
    columns = (width + BLOCK_PX - 1) // BLOCK_PX
    blocks = columns * ((height + BLOCK_PX - 1) // BLOCK_PX)
    sums = np.zeros((patches, blocks, frames + edges.size, frames))
    counts = np.zeros((patches, blocks, frames + edges.size), np.int64)
    for patch in prange(patches):
        sample_e = np.empty(frames)
        for y in range(height):
            for x in range(width):
                good = _good_samples(raw_dn[:, patch, y, x], sensor, sample_e)
                used, rate = _frames_used(sample_e, good, exposure_s, sensor[3], ceiling)
                if used >= 2:
                    kind = used - 1
                    if used == frames:
                        kind += int(np.searchsorted(edges, rate))
                    block = y // BLOCK_PX * columns + x // BLOCK_PX
                    counts[patch, block, kind] += 1
                    for i in range(used):
                        sums[patch, block, kind, i] += sample_e[i]
    return sums, counts


@njit(inline="always")
def _good_samples(
    raw_dn: NDArray[np.generic], sensor: tuple[float, float, float, float], sample_e: NDArray[np.float64]
) -> int:
    """Electrons of the frames up to the first that is saturated or missing, and their number."""
    for i in range(sample_e.size):
        dn = float(raw_dn[i])
        if dn >= sensor[1] or not math.isfinite(dn):
            return i
        sample_e[i] = (dn - sensor[0]) * sensor[2]
    return sample_e.size


@njit(inline="always")
def _frames_used(
    sample_e: NDArray[np.float64],
    good: int,
    exposure_s: NDArray[np.float64],
    dark_variance: float,
    ceiling: NDArray[np.float64],
) -> tuple[int, float]:
    """The largest number of frames that is safe by their own common estimate, and that estimate."""
    for used in range(good, 1, -1):
        electrons, time_s = 0.0, 0.0
        for i in range(used):
            electrons += sample_e[i]
            time_s += exposure_s[i]
        first = max(electrons / time_s, 0.0)
        score, information = 0.0, 0.0
        for i in range(used):
            weight = exposure_s[i] / (first * exposure_s[i] + dark_variance)
            score += weight * sample_e[i]
            information += weight * exposure_s[i]
        if score < ceiling[used - 1] * information:
            return used, score / information
    return 0, 0.0
