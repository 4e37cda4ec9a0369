"""Hidden points that look like a point seen from the top after all take its place (Chen et al., 2.3.2)."""

from typing import Protocol

import numba
import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32
from processing.sbrdf.flow_votes import Occlusion
from processing.sbrdf.samples import Samples

WINDOW = 256  # texels of a side within which a hidden point looks for its like, cut to the tile
_SHORTLIST = 8
_TOGETHER = 512  # hidden points whose distances to all texels are in memory at a time


class Reconstruction(Protocol):
    """Values that lobes and shadows of the points seen from the top give, in the domain of `Samples`."""

    def seen_from(self, view: int) -> Float32:
        """Every texel of the top view as this view would see it, (light, y, x, 3)."""


def refine(samples: Samples, reconstruction: Reconstruction, voted: Occlusion) -> Occlusion:
    """The hidden points of each view that match a point seen from the top as well as the others do on average.

    Distance is the mean over lights and channels of |BTF(x, L, V) - reconstruction(x', L, V)|, of what both have; x' is
    the best of all texels of the tile, the threshold the mean distance of the view's other points at their shifts. The
    best by squared distance (matrix products) are ranked again by this one.
    """
    shift, hidden = voted.shift.copy(), voted.hidden.copy()
    for view in np.flatnonzero(hidden.any(axis=(1, 2))):
        seen, drawn = (_points(some.seen_from(int(view))) for some in (samples, reconstruction))
        apart = distances(seen, drawn, shift[view])
        others = apart[~hidden[view] & np.isfinite(apart)]
        if not len(others):
            continue
        places = np.argwhere(hidden[view])
        moved, distance = best_matches(seen, drawn, places)
        better = distance < others.mean(dtype=np.float64)
        rows, columns = places[better].T
        shift[view, rows, columns] = moved[better]
        hidden[view, rows, columns] = False
    return Occlusion(shift, hidden, voted.hidden_ratio)


def _points(values: Float32) -> Float32:
    """(light, y, x, channel) as (y, x, light * channel), contiguous."""
    lights, height, width, channels = values.shape
    return np.ascontiguousarray(np.moveaxis(values, 0, 2)).reshape(height, width, lights * channels)


def best_matches(seen: Float32, drawn: Float32, places: NDArray[np.intp]) -> tuple[Float32, Float32]:
    """Shift (n, 2) in texels right, down of the points of `seen` at `places` (n, 2) to their like in `drawn`.

    And its distance (n,), inf where nothing can be compared. `seen` and `drawn` are (y, x, values).
    """
    height, width, _ = seen.shape
    wanted = drawn.reshape(height * width, -1)
    known, products = _split(wanted)
    shift, distance = np.zeros((len(places), 2), np.float32), np.full(len(places), np.inf, np.float32)
    for start in range(0, len(places), _TOGETHER):
        part = slice(start, start + _TOGETHER)
        points = seen[places[part, 0], places[part, 1]]
        near = _squared(points, known, products)
        far = _outside(places[part], (height, width))
        near[far] = np.inf
        count = min(_SHORTLIST, near.shape[1])
        candidates = np.argpartition(near, count - 1, axis=1)[:, :count]
        candidates.sort(axis=1)
        _rank(points, wanted, candidates, near, places[part], width, shift[part], distance[part])
    _wrap(shift, (height, width))
    return shift, distance


def _split(values: Float32) -> tuple[Float32, Float32]:
    """What is known of (n, values), as 1 and 0, and the values with 0 for what is not."""
    known = np.isfinite(values)
    return known.astype(np.float32), np.where(known, values, np.float32(0))


def _squared(points: Float32, known: Float32, values: Float32) -> Float32:
    """Mean squared difference (n, m) of what both know, inf where that is nothing."""
    known_points, zeroed = _split(points)
    total = -2 * (zeroed @ values.T)
    if known.all() and known_points.all():
        total += (zeroed**2).sum(axis=1)[:, None] + (values**2).sum(axis=1)
        return np.asarray(total, np.float32)
    total += (zeroed**2) @ known.T + known_points @ (values**2).T
    both = known_points @ known.T
    return np.where(both > 0, total / np.maximum(both, 1), np.inf).astype(np.float32)


def _outside(places: NDArray[np.intp], size: tuple[int, int]) -> NDArray[np.bool_]:
    """Which texels (n, y * x) lie outside the window around each place; none on tiles up to the window's size."""
    apart = [
        np.abs((np.arange(side) - place[:, None] + side // 2) % side - side // 2) > WINDOW // 2
        for side, place in zip(size, places.T, strict=True)
    ]
    outside: NDArray[np.bool_] = (apart[0][:, :, None] | apart[1][:, None, :]).reshape(len(places), -1)
    return outside


def _wrap(shift: Float32, size: tuple[int, int]) -> None:
    """The shortest of the shifts that lead to the same texel of a tile that repeats."""
    for axis, side in enumerate(reversed(size)):
        shift[:, axis] -= side * np.rint(shift[:, axis] / side)


@numba.njit(cache=True, nogil=True)
def _rank(points, wanted, candidates, near, places, width, shift, distance):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202, PLR0913
    for i in range(len(points)):
        for candidate in candidates[i]:
            if not near[i, candidate] < np.inf:
                continue
            total, count = 0.0, 0
            for k in range(points.shape[1]):
                apart = abs(points[i, k] - wanted[candidate, k])
                if apart < np.inf:
                    total += apart
                    count += 1
            if count > 0 and total / count < distance[i]:
                distance[i] = total / count
                shift[i, 0] = candidate % width - places[i, 1]
                shift[i, 1] = candidate // width - places[i, 0]


@numba.njit(cache=True, parallel=True)
def distances(seen: Float32, drawn: Float32, shift: Float32) -> Float32:
    """Mean absolute difference (y, x) of `seen` to `drawn`, both (y, x, values), between its texels at x + shift.

    NaN where nothing can be compared; values of which one of the five is missing are left out.
    """
    height, width, count = seen.shape
    out = np.empty((height, width), np.float32)
    for y in numba.prange(height):
        for x in range(width):
            right, down = x + shift[y, x, 0], y + shift[y, x, 1]
            column, row = int(np.floor(right)), int(np.floor(down))
            fx, fy = np.float32(right - column), np.float32(down - row)
            row, column = row % height, column % width
            below, beside = (row + 1) % height, (column + 1) % width
            total, compared = 0.0, 0
            for k in range(count):
                upper = drawn[row, column, k] * (1 - fx) + drawn[row, beside, k] * fx
                lower = drawn[below, column, k] * (1 - fx) + drawn[below, beside, k] * fx
                apart = abs(seen[y, x, k] - (upper * (1 - fy) + lower * fy))
                if apart < np.inf:
                    total += apart
                    compared += 1
            out[y, x] = total / compared if compared else np.nan
    return out
