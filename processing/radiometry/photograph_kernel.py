"""The loop that merges photographs, compiled by numba; its plain NumPy twin is in tests/reference."""

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from processing.radiometry.merge_kernel import DARK, OK, SATURATED

Array = NDArray[np.float64]
Grid = tuple[float, float, int]  # start, places per unit, size
ITERATIONS = 20
TOLERANCE = 1e-6  # squared step in units of the variance: a thousandth of a standard deviation
# Columns of a channel's table by log exposure.
WEIGHT, CLIPPED_SCORE, CLIPPED_INFORMATION, BLACK_SCORE, BLACK_INFORMATION, RESPONSE_SIGMA = range(6)
_MEASURED, _BLACK, _CLIPPED = range(3)  # what a sample is
NEAR_WHITE = 236  # JPEG moves a white pixel beside an edge off the end of the codes, by up to a dozen and more
CERTAIN = 2.0  # standard deviations by which a shorter exposure must say that there is more light than white


@njit(inline="always")
def _place(log_exposure: float, grid: Grid) -> int:
    start, per_log, size = grid
    return min(max(int((log_exposure - start) * per_log + 0.5), 0), size - 1)


@njit(inline="always")
def _step(
    radiance: float, samples: tuple[Array, NDArray[np.int64]], times: tuple[Array, Array], table: Array, grid: Grid
) -> tuple[float, float, float]:
    """Fisher-scoring step and information at `radiance`, and the response's standard deviation of its logarithm."""
    light, kind = samples
    exposure, log_exposure = times
    score, information, certain, sigma = 0.0, 0.0, 0.0, 0.0
    log_radiance = math.log(radiance)
    for i in range(exposure.size):
        t = exposure[i]
        row = table[_place(log_radiance + log_exposure[i], grid)]
        if kind[i] == _MEASURED:
            gained = t * t * row[WEIGHT]
            score += t * row[WEIGHT] * (light[i] - radiance * t)
            information += gained
            certain += gained
            sigma += gained * row[RESPONSE_SIGMA]
        elif kind[i] == _CLIPPED:
            score += t * row[CLIPPED_SCORE]
            information += t * t * row[CLIPPED_INFORMATION]
        else:
            score += t * row[BLACK_SCORE]
            information += t * t * row[BLACK_INFORMATION]
    return score / information, information, sigma / max(certain, 1e-300)


@njit(inline="always")
def _maximum_likelihood(
    radiance: float, samples: tuple[Array, NDArray[np.int64]], times: tuple[Array, Array], table: Array, grid: Grid
) -> tuple[float, float, int]:
    information, sigma = 1.0, 0.0
    for _ in range(ITERATIONS):
        step, information, sigma = _step(radiance, samples, times, table, grid)
        step = max(step, -0.5 * radiance)  # radiance stays positive
        radiance += step
        if step * step * information < TOLERANCE:
            break
    variance = 1.0 / information + (sigma * radiance) ** 2
    return radiance, variance, DARK if radiance * radiance < 9.0 * variance else OK


@njit(inline="always")
def _own_mean(
    codes: NDArray[np.uint8], sample: Array, kind: NDArray[np.int64], exposure: Array, weight: Array
) -> float:
    """Mean of the measured samples weighed by their own codes, to begin with; 0 where none is measured."""
    total, mean = 0.0, 0.0
    for i in range(exposure.size):
        if kind[i] == _MEASURED:
            gained = weight[codes[i]] * exposure[i]
            total += gained * exposure[i]
            mean += gained * sample[i]
    return mean / total if total > 0.0 else 0.0


@njit(inline="always")
def _unmeasured(sample: Array, kind: NDArray[np.int64], exposure: Array, foot: float) -> tuple[float, float, int]:
    """DARK by the longest exposure that is black, light `foot` of the first code as deviation; else SATURATED."""
    black, black_s = 0.0, 0.0
    for i in range(exposure.size):
        if kind[i] == _BLACK and exposure[i] > black_s:
            black, black_s = sample[i], exposure[i]
    if black_s == 0.0:
        return np.nan, np.nan, SATURATED
    return black / black_s, (foot / black_s) ** 2, DARK


@njit(inline="always")
def _classify(
    codes: NDArray[np.uint8], kind: NDArray[np.int64], exposure: Array, order: NDArray[np.int64], tables: Array
) -> None:
    """What each sample is: `tables` (3, 256) are light, inverse variance, and at [2] the end codes.

    A code near white is clipped where the next shorter exposure that is not near white says that there is more light
    than white: else what JPEG moved there would pass for a measurement of far less light.
    """
    light, weight, ends = tables
    told = 0.0
    for i in order:
        z = codes[i]
        near = z >= NEAR_WHITE
        kind[i] = _CLIPPED if z > ends[1] else _BLACK if z < ends[0] else _MEASURED
        if near and told * exposure[i] > light[255]:
            kind[i] = _CLIPPED
        least = (light[z] - CERTAIN / math.sqrt(weight[z])) / exposure[i]
        told = max(told, least) if near else least


@njit(parallel=True, cache=True)
def merge_photographs(
    codes: NDArray[np.uint8],
    log_exposure: Array,
    light: Array,
    table: Array,
    grid: Grid,
    ends: NDArray[np.int64],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
    """Radiance, variance and status of photographs (k, h, w, channels), each read once; see `photographs`.

    `light` (channels, 256), `table` (channels, grid, 6) by log exposure, `ends` (channels, 2): the first and last code
    that are measured.
    """
    frames, height, width, channels = codes.shape
    value = np.empty((height, width, channels), np.float32)
    variance = np.empty((height, width, channels), np.float32)
    status = np.empty((height, width, channels), np.uint8)
    exposure = np.exp(log_exposure)
    order = np.argsort(exposure)
    known = np.zeros((channels, 3, 256))
    for c in range(channels):
        known[c, 2, :2] = ends[c]
        for z in range(256):
            known[c, 0, z] = light[c, z]
            known[c, 1, z] = table[c, _place(math.log(light[c, z]), grid), WEIGHT]
    for y in prange(height):
        sample, kind = np.empty(frames), np.empty(frames, np.int64)
        for x in range(width):
            for c in range(channels):
                for i in range(frames):
                    sample[i] = light[c, codes[i, y, x, c]]
                _classify(codes[:, y, x, c], kind, exposure, order, known[c])
                start = _own_mean(codes[:, y, x, c], sample, kind, exposure, known[c, 1])
                if start > 0.0:
                    found = _maximum_likelihood(start, (sample, kind), (exposure, log_exposure), table[c], grid)
                else:
                    found = _unmeasured(sample, kind, exposure, light[c, ends[c, 0]])
                value[y, x, c], variance[y, x, c], status[y, x, c] = found
    return value, variance, status
