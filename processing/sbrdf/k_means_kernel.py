"""Loops of k-means, compiled by numba.

`value` (n, d) is 0 where nothing was measured; `present` (n, d) is 1 or 0, or one row of 1 for all.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32, Float64

Index = NDArray[np.intp]
_DOUBT = np.float32(1e-5)  # of a distance, added to its bounds: more than single precision leaves


@numba.njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def _apart(value: Float32, present: Float32, centre: Float32) -> np.float32:
    """Squared distance over the values that are present."""
    total = np.float32(0)
    for i in range(len(value)):
        total += present[i] * (value[i] - centre[i]) * (value[i] - centre[i])
    return total


@numba.njit(cache=True, nogil=True)
def seed(value: Float32, present: Float32, draws: Float64) -> Index:
    """k-means++: rows drawn by their squared distance from those before.

    Of the candidates of `draws` (k, candidate), in 0 to 1, the one is taken that leaves the least sum of squares.
    """
    count, each = len(value), int(len(present) > 1)
    chosen = np.zeros(len(draws), np.intp)
    nearest, trial, best = np.zeros(count), np.zeros(count), np.zeros(count)
    chosen[0] = min(int(draws[0, 0] * count), count - 1)
    for i in range(count):
        nearest[i] = _apart(value[i], present[i * each], value[chosen[0]])
    for k in range(1, len(draws)):
        sums, least = np.cumsum(nearest), np.inf
        for draw in draws[k]:
            row = min(np.searchsorted(sums, draw * sums[-1], side="right"), count - 1)
            total = 0.0
            for i in range(count):
                trial[i] = min(nearest[i], _apart(value[i], present[i * each], value[row]))
                total += trial[i]
            if total < least:
                least, chosen[k] = total, row
                best[:] = trial
        nearest[:] = best
    return chosen


@numba.njit(cache=True, nogil=True)
def _compare(value: Float32, present: Float32, centres: Float32, index: Index, bounds: tuple[Float32, Float32]) -> None:
    """Nearest centre of each row whose bounds leave a doubt; `bounds` are the most and the least of two distances.

    The first is that of its own centre, the second that of any other.
    """
    each, (upper, lower) = int(len(present) > 1), bounds
    for i in range(len(value)):
        if upper[i] * (1 + _DOUBT) < lower[i] * (1 - _DOUBT):
            continue
        first, second = np.float32(np.inf), np.float32(np.inf)
        for k in range(len(centres)):
            apart = _apart(value[i], present[i * each], centres[k])
            if apart < first:
                first, second, index[i] = apart, first, k
            elif apart < second:
                second = apart
        upper[i], lower[i] = np.sqrt(first), np.sqrt(second)


@numba.njit(cache=True, nogil=True)
def _means(value: Float32, present: Float32, index: Index, upper: Float32, means: Float32) -> float:
    """Mean of each cluster, 0 where nothing is present; the sum of squares that they take off the values'.

    A cluster without rows goes to the row that may be farthest from its own centre.
    """
    each = int(len(present) > 1)
    sums, counts = np.zeros(means.shape), np.zeros(means.shape)
    for i in range(len(value)):
        sums[index[i]] += value[i]
        counts[index[i]] += present[i * each]
    taken = 0.0
    for k in range(len(means)):
        for j in range(means.shape[1]):
            means[k, j] = sums[k, j] / max(counts[k, j], 1.0)
            taken += sums[k, j] * means[k, j]
        if not counts[k].any():
            row = upper.argmax()
            means[k], upper[row] = value[row], 0
    return taken


@numba.njit(cache=True, nogil=True)
def rounds(
    value: Float32, present: Float32, centres: Float32, index: Index, stop: tuple[int, float]
) -> tuple[bool, float]:
    """Lloyd's rounds: `centres` and `index` are changed; whether they converged, and the sum of squares in the last.

    `stop` are the most rounds, and the least part by which a round must lower the sum. Only rows whose nearest centre
    may have changed are compared with all of them, by the bounds of Hamerly 2010.
    """
    whole = np.square(value).sum(dtype=np.float64)
    upper, lower = np.full(len(value), np.float32(np.inf)), np.zeros(len(value), np.float32)
    before, converged, means = np.inf, False, np.empty_like(centres)
    for _ in range(stop[0]):
        _compare(value, present, centres, index, (upper, lower))
        left = whole - _means(value, present, index, upper, means)
        converged = left >= before * (1 - stop[1])
        if converged:
            break
        before = left
        _follow(centres, means, index, (upper, lower))
    return converged, before


@numba.njit(cache=True, nogil=True)
def _follow(centres: Float32, means: Float32, index: Index, bounds: tuple[Float32, Float32]) -> None:
    """Centres go to the means, and the bounds with them."""
    ones, way = np.ones_like(means[0]), np.empty(len(means), np.float32)
    for k in range(len(means)):
        way[k] = np.sqrt(_apart(means[k], ones, centres[k]))
        centres[k] = means[k]
    longest = way.max()
    for i in range(len(index)):
        bounds[0][i] += way[index[i]]
        bounds[1][i] -= longest


@numba.njit(cache=True, nogil=True)
def nearest(value: Float32, present: Float32, centres: Float32, index: Index) -> None:
    """Index of the centre that is nearest to each row."""
    upper, lower = np.full(len(value), np.float32(np.inf)), np.zeros(len(value), np.float32)
    _compare(value, present, centres, index, (upper, lower))
