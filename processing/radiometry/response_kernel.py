"""The loop of the response fit, compiled by numba; its plain NumPy twin is in tests/reference."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Grid = tuple[float, float, NDArray[np.intp]]  # start, places per unit, code of each place
Tables = tuple[Array, Grid]  # weight by code, and the grid
CODES = 256
HUBER = 2.5  # standard deviations from which a residual counts linearly: clouds move and leaves shake
BINS, PER_SIGMA = 200, 20  # of the histogram of residuals: ten standard deviations
_DOMINANT = 0.9  # a sample with more of its pixel's weight says nothing about its own noise


@njit(inline="always")
def _code(log_light: float, grid_start: float, grid_per_log: float, code_at: NDArray[np.intp]) -> int:
    place = int((log_light - grid_start) * grid_per_log + 0.5)
    return int(code_at[min(max(place, 0), code_at.size - 1)])


@njit(inline="always")
def _radiance(
    start: float, sample: Array, log_exposure: Array, tables: Tables, w: Array, place: NDArray[np.intp]
) -> tuple[float, float]:
    """Weighted mean of a pixel's samples (light over exposure) and its total weight; 0 where fewer than two count.

    From a first radiance `start`. Fills the weights `w` and the predicted codes `place`.
    """
    weight, grid = tables
    radiance, total = start, 0.0
    for _ in range(2):
        log_radiance = math.log(radiance)
        used = 0
        for i in range(sample.size):
            place[i] = _code(log_radiance + log_exposure[i], grid[0], grid[1], grid[2])
            w[i] = weight[place[i]] if sample[i] > 0.0 else 0.0
            if w[i] > 0.0:
                size = abs(sample[i] / radiance - 1.0) * math.sqrt(w[i])
                w[i] *= min(1.0, HUBER / max(size, 1e-9))
                used += 1
        if used < 2:
            return 0.0, 0.0
        total = w.sum()
        radiance = (w * sample).sum() / total
    return radiance, total


@njit(inline="always")
def _add_pixel(w: Array, e: Array, total: float, place: NDArray[np.intp], matrix: Array, right: Array) -> None:
    for i in range(w.size):
        right[place[i]] -= w[i] * e[i]
        right[CODES + i] += w[i] * e[i]
        for j in range(w.size):
            shared = (w[i] if i == j else 0.0) - w[i] * w[j] / total
            matrix[place[i], place[j]] += shared
            matrix[place[i], CODES + j] -= shared
            matrix[CODES + i, place[j]] -= shared
            matrix[CODES + i, CODES + j] += shared


@njit(cache=True)
def normal_equations(
    codes: NDArray[np.uint8],
    log_exposure: Array,
    light: Array,
    weight: Array,
    grid: Grid,
) -> tuple[Array, Array, Array]:
    """Normal matrix and right-hand side of a change of the response by code and of each frame's log exposure.

    Sizes 256 + k; third, the histogram of residuals by code. `codes` (n, k), `log_exposure` (k,); `light` (256,) and
    `weight` (256,), the inverse relative variance of a code and 0 where it is not used; `grid` turns a log exposure
    into its code. Each pixel's radiance is eliminated: with the weights w of its samples, the matrix gains
    diag(w) - w w' / sum(w). Samples are placed by the code that the radiance predicts, not by their own noisy one, so
    that neither weights nor the range of codes select on noise.
    """
    count = log_exposure.size
    matrix, right = np.zeros((CODES + count, CODES + count)), np.zeros(CODES + count)
    histogram = np.zeros((CODES, BINS))
    exposure = np.exp(log_exposure)
    w, e, place = np.empty(count), np.empty(count), np.empty(count, np.intp)
    sample, own = np.empty(count), np.empty(count)
    for p in range(codes.shape[0]):
        for i in range(count):
            z = codes[p, i]
            own[i] = weight[z]
            sample[i] = light[z] / exposure[i] if 0 < z < CODES - 1 else 0.0
        if own.sum() == 0.0:
            continue
        start = (own * sample).sum() / own.sum()
        radiance, total = _radiance(start, sample, log_exposure, (weight, grid), w, place)
        if total == 0.0:
            continue
        for i in range(count):
            e[i] = sample[i] / radiance - 1.0
        _add_pixel(w, e, total, place, matrix, right)
        for i in range(count):
            if 0.0 < w[i] < _DOMINANT * total:
                size = abs(e[i]) * math.sqrt(weight[place[i]] / (1.0 - w[i] / total))
                histogram[place[i], min(int(size * PER_SIGMA), BINS - 1)] += 1.0
    return matrix, right, histogram
