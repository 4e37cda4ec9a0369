"""The line along which a new patch differs least from what lies on the surface already."""

from math import atan2, ceil, hypot, pi

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, uniform_filter

from processing.products.arrays import Float64

_ANGLES = 96
_STEEPEST = 2  # cells in or out from one angle to the next
_INNERMOST = 0.4  # of the patch's radius: at least so much of a patch is shown
# What one cell of the line costs where nothing lies yet, as a share of the mean where something does: little enough to
# go round the overlap, enough not to leave room to the next patch without need.
_FREE = 0.05


def least_cut(error: Float64, mask: Float64, reach: float) -> Float64:
    """Radii (96,) in cells of the closed line round the middle of `error` (c, c) that meets the least of it.

    `mask` (c, c) says where something lies already; `reach` is the largest radius. The line is a function of the angle
    about the middle, so each radius follows from the last by dynamic programming. Source: Efros and Freeman 2001, 2.2,
    round a patch instead of along its side.
    """
    covered = uniform_filter(mask, 3, mode="constant")
    smooth = uniform_filter(error * mask, 3, mode="constant") / np.maximum(covered, 1e-12)
    there = covered > 0.2
    free = _FREE * (float(smooth[there].mean()) if there.any() else 0.0) or 1.0
    radii = np.arange(_INNERMOST * reach, reach + 1e-9, (1 - _INNERMOST) * reach / ceil((1 - _INNERMOST) * reach))
    angle = 2.0 * pi * np.arange(_ANGLES) / _ANGLES
    middle = 0.5 * (len(error) - 1)
    # Rows run downward, angles from +x toward +y, which is up.
    places = np.stack([middle - np.outer(np.sin(angle), radii), middle + np.outer(np.cos(angle), radii)])
    covering = map_coordinates(there.astype(np.float64), places, order=1, mode="nearest")
    value = map_coordinates(np.where(there, smooth, 0.0), places, order=1, mode="nearest")
    outward = free * (3.0 * reach - 2.0 * radii)  # falls, although a longer line is counted
    cost = value * radii + (1.0 - covering) * outward
    return np.asarray(radii[_closed_path(cost)])


@numba.njit(cache=True)
def _closed_path(cost: Float64) -> NDArray[np.int64]:
    """Columns (n,) of the cheapest path through all rows of `cost` (n, k) that ends where it began."""
    rows, columns = cost.shape
    best, best_path = np.inf, np.zeros(rows, np.int64)
    total, came = np.zeros((rows, columns)), np.zeros((rows, columns), np.int64)
    for first in range(columns):
        total[0] = np.inf
        total[0, first] = cost[0, first]
        for row in range(1, rows):
            for column in range(columns):
                low, high = max(column - _STEEPEST, 0), min(column + _STEEPEST + 1, columns)
                came[row, column] = low + np.argmin(total[row - 1, low:high])
                total[row, column] = total[row - 1, came[row, column]] + cost[row, column]
        low, high = max(first - _STEEPEST, 0), min(first + _STEEPEST + 1, columns)
        last = low + np.argmin(total[rows - 1, low:high])
        if total[rows - 1, last] < best:
            best = total[rows - 1, last]
            for row in range(rows - 1, -1, -1):
                best_path[row] = last
                last = came[row, last]
    return best_path


@numba.njit(cache=True)
def share_within(x: float, y: float, radii: Float64, feather: float) -> float:
    """1 inside the line, 0 outside, and between them over a band as wide as `feather`."""
    turn = atan2(y, x) / (2.0 * pi) * len(radii)
    turn += len(radii) * (turn < 0.0)
    low = int(turn)
    part = turn - low
    line = (1.0 - part) * radii[low % len(radii)] + part * radii[(low + 1) % len(radii)]
    return float(min(max(0.5 + (line - hypot(x, y)) / feather, 0.0), 1.0))
