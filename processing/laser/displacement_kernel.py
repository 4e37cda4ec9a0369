"""The merge of laser locations, pixel by pixel, each read once."""

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

Array = NDArray[np.float64]
OUTLIER = 4.0  # sigmas
BINS = 2048  # of the squared deviations s in variances, even in s / (1 + s)
BLOCKS = 32  # of pixels, which count their deviations apart


@njit(inline="always")
def _gather(values: NDArray[np.floating], variances: NDArray[np.floating], p: int, weights: Array, own: Array) -> int:
    """Write value, variance, weight and location of a pixel's samples, all marked; returns their number."""
    count = 0
    for k in range(values.shape[0]):
        value, variance = float(values[k, p]), float(variances[k, p])
        weight = 1.0 / variance if weights.size == 0 else weights[k]
        if np.isfinite(value) and np.isfinite(variance) and variance > 0.0 and 0.0 < weight < np.inf:
            own[0, count], own[1, count], own[2, count], own[3, count], own[4, count] = value, variance, weight, k, 1.0
            count += 1
    return count


@njit(inline="always")
def _near(own: Array, count: int, centre: float, spread: float) -> int:
    """Mark the samples within four sigmas of a centre of which `spread` is the variance; returns their number."""
    near = 0
    for i in range(count):
        apart = own[0, i] - centre
        own[4, i] = 1.0 if apart * apart <= OUTLIER * OUTLIER * (own[1, i] + spread) else 0.0
        near += int(own[4, i])
    return near


@njit(inline="always")
def _mean(own: Array, count: int) -> tuple[float, float]:
    """Weighted mean of the marked samples and its variance."""
    total, first, second = 0.0, 0.0, 0.0
    for i in range(count):
        weight = own[2, i] * own[4, i]
        total += weight
        first += weight * (own[0, i] - own[0, 0])
        second += weight * weight * own[1, i]
    return own[0, 0] + first / total, second / (total * total)


@njit(inline="always")
def _consensus(own: Array, count: int, rough: float) -> int:
    """The sample that is nearest to most others: least sum of squares in sigmas, cut off where samples disagree."""
    best, least = 0, np.inf
    for i in range(count):
        cost = 0.0
        for j in range(count):
            apart = own[0, i] - own[0, j]
            cost += min(apart * apart / (own[1, j] + rough), OUTLIER * OUTLIER)
        if cost < least or (cost == least and own[0, i] < own[0, best]):  # of two alike the nearer to the camera
            best, least = i, cost
    return best


@njit(inline="always")
def _settle(own: Array, count: int, rough: float) -> tuple[float, float, int]:
    """Weighted mean, its variance and the number of the samples that agree, which are marked.

    Where four in five of those agree within their own noise, the surface is smooth there and the others are wrong;
    elsewhere locations may differ by its roughness, of which `rough` is the variance.
    """
    value, variance = _mean(own, count)
    if _near(own, count, value, variance) < count:
        centre = _consensus(own, count, rough)
        value, variance = own[0, centre], own[1, centre]
        strict = _near(own, count, value, variance)
        loose = _near(own, count, value, variance + rough)
        allowed = rough if 5 * strict < 4 * loose else 0.0
        _near(own, count, value, variance + allowed)
        value, variance = _mean(own, count)
        if _near(own, count, value, variance + allowed) == 0:
            _near(own, count, own[0, centre], own[1, centre] + allowed)
        value, variance = _mean(own, count)
    used = 0
    for i in range(count):
        used += int(own[4, i])
    return value, variance, used


@njit(inline="always")
def _count_deviations(own: Array, count: int, mean: tuple[float, float], histogram: NDArray[np.int64]) -> None:
    """Count every sample's deviation from the mean in its own sigmas."""
    total = 0.0
    for i in range(count):
        total += own[2, i] * own[4, i]
    for i in range(count):
        # The mean holds the sample itself; of a sample that makes the mean all but alone a floor is left.
        variance = own[1, i] * (1.0 - 2.0 * own[2, i] * own[4, i] / total) + mean[1]
        square = (own[0, i] - mean[0]) ** 2
        place = BINS * square / (square + max(variance, 0.05 * own[1, i]))
        histogram[int(own[3, i]), min(int(place), BINS - 1)] += 1


@njit(inline="always")
def _quarrel(own: Array, count: int, mean: float) -> float:
    """Squared distance of the farthest sample that does not agree."""
    worst = 0.0
    for i in range(count):
        if own[4, i] == 0.0:
            worst = max(worst, (own[0, i] - mean) ** 2)
    return worst


@njit(parallel=True, cache=True, error_model="numpy")
def merge_samples(
    samples: tuple[NDArray[np.floating], NDArray[np.floating]],
    weights: Array,
    rough: float,
    merged: NDArray[np.float32],
    counts: NDArray[np.uint16],
    histogram: NDArray[np.int64],
) -> None:
    """Merge values and variances (k, n) of k locations: mean and variance (2, n), numbers used and rejected (2, n).

    `weights` (k,) per location, or none for inverse variances. Locations may differ by a roughness of which `rough` is
    the variance. `histogram` (blocks, k, bins) counts deviations.
    """
    values, variances = samples
    pixels = values.shape[1]
    for block in prange(histogram.shape[0]):
        own = np.empty((5, values.shape[0]))
        for p in range(block * pixels // histogram.shape[0], (block + 1) * pixels // histogram.shape[0]):
            count = _gather(values, variances, p, weights, own)
            merged[0, p] = merged[1, p] = np.nan
            counts[0, p] = counts[1, p] = 0
            if count == 0:
                continue
            mean, variance, used = _settle(own, count, rough)
            counts[0, p], counts[1, p] = used, count - used
            if count > 1:
                _count_deviations(own, count, (mean, variance), histogram[block])
            if count - used >= used:
                variance += _quarrel(own, count, mean)
            merged[0, p], merged[1, p] = mean, variance
