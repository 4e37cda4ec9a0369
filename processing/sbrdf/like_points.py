"""The points of a tile that look most like given ones under all lights."""

from itertools import pairwise

import numba
import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32

Index = NDArray[np.intp]

WINDOW = 256  # texels of a side within which a point looks for its like, cut to the tile (Chen et al., 2.3.2)
_STRIPS = 8  # of a tile, each of which proposes one texel
_TOGETHER = 256  # points whose distances to all texels are in memory at a time


def best_matches(seen: Float32, drawn: Float32, places: Index) -> tuple[Float32, Float32]:
    """Shift (n, 2) in texels right, down of the points of `seen` at `places` (n, 2) to their like in `drawn`.

    And its distance (n,), the mean absolute difference of what both know; inf where that is nothing. `seen` and `drawn`
    are (y, x, values). Of each eighth of the tile the nearest by squared distance (matrix products) is ranked again.
    """
    height, width, _ = seen.shape
    wanted = drawn.reshape(height * width, -1)
    known, zeroed = _split(wanted)
    like, distance = np.zeros(len(places), np.intp), np.full(len(places), np.inf, np.float32)
    for start in range(0, len(places), _TOGETHER):
        part = slice(start, start + _TOGETHER)
        sought = seen[places[part, 0], places[part, 1]]
        near = _squared(sought, known, zeroed)
        if max(height, width) > WINDOW:
            near[_outside(places[part], (height, width))] = np.inf
        _rank(sought, wanted, _shortlist(near), like[part], distance[part])
    way = np.column_stack([like % width - places[:, 1], like // width - places[:, 0]]).astype(np.float32)
    way -= np.array([width, height]) * np.rint(way / [width, height])  # the tile repeats: the short way
    return np.where(distance[:, None] < np.inf, way, 0).astype(np.float32), distance


def _split(values: Float32) -> tuple[Float32, Float32]:
    """What is known of (n, values), as 1 and 0, and the values with 0 for what is not."""
    known = np.isfinite(values)
    return known.astype(np.float32), np.where(known, values, np.float32(0))


def _squared(sought: Float32, known: Float32, values: Float32) -> Float32:
    """Mean squared difference (n, m) of what both know, inf where that is nothing."""
    known_too, zeroed = _split(sought)
    total = -2 * (zeroed @ values.T)
    if known.all() and known_too.all():
        total += (values**2).sum(axis=1)
        return np.asarray(total, np.float32)
    total += (zeroed**2) @ known.T + known_too @ (values**2).T
    both = known_too @ known.T
    return np.where(both > 0, total / np.maximum(both, 1), np.inf).astype(np.float32)


def _outside(places: Index, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Which texels (n, y * x) lie outside the window around each place."""
    rows, columns = (
        np.abs((np.arange(side) - place[:, None] + side // 2) % side - side // 2) > WINDOW // 2
        for side, place in zip(size, places.T, strict=True)
    )
    outside: NDArray[np.bool_] = (rows[:, :, None] | columns[:, None, :]).reshape(len(places), -1)
    return outside


def _shortlist(near: Float32) -> Index:
    """The column (n, strip) that is nearest in each strip of columns; -1 where all are infinitely far."""
    starts = np.unique(np.linspace(0, near.shape[1], min(_STRIPS, near.shape[1]) + 1).astype(np.intp))
    nearest = np.column_stack([
        start + near[:, start:stop].argmin(axis=1) for start, stop in pairwise(starts)
    ])  # fmt: skip
    return np.where(np.take_along_axis(near, nearest, axis=1) < np.inf, nearest, -1)


@numba.njit(cache=True, nogil=True)
def _rank(sought: Float32, wanted: Float32, candidates: Index, like: Index, distance: Float32) -> None:
    """Of the candidates of each point the nearest by mean absolute difference, and that."""
    for i in range(len(sought)):
        for candidate in candidates[i]:
            total, count = 0.0, 0
            for k in range(sought.shape[1] if candidate >= 0 else 0):
                apart = abs(sought[i, k] - wanted[candidate, k])
                if apart < np.inf:
                    total += apart
                    count += 1
            if count > 0 and total / count < distance[i]:
                distance[i] = total / count
                like[i] = candidate
