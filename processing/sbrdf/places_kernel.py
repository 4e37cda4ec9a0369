"""Points of the views gathered at the texels that they are moved to, and better places for them."""

import numba
import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32

Ints = NDArray[np.int64]


@numba.njit(cache=True, nogil=True)
def gather_view(seen: Float32, place: Ints, total: Float32, count: Float32) -> None:
    """Add what one view sees, `seen` (light, point, 3), to `total` (t, light, 3) and `count` (t, light) of the texels.

    `place` (point,) is each point's texel, less than 0 for none; a value with a channel that is not finite is left out.
    """
    for light in range(len(seen)):
        for point in range(len(place)):
            t = place[point]
            if t < 0:
                continue
            r, g, b = seen[light, point, 0], seen[light, point, 1], seen[light, point, 2]
            if np.isfinite(r + g + b):
                total[t, light, 0] += r
                total[t, light, 1] += g
                total[t, light, 2] += b
                count[t, light] += 1


@numba.njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _apart(one, other):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    total = np.float32(0)
    for k in range(len(one)):
        difference = one[k] - other[k]
        total += difference * difference
    return total


@numba.njit(cache=True, nogil=True)
def _apart_where_known(one, other):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    total = np.float32(0)
    for k in range(len(one)):
        difference = one[k] - other[k]
        if np.isfinite(difference):
            total += difference * difference
    return total


@numba.njit(cache=True, nogil=True)
def nearest_of(seen: Float32, drawn: Float32, candidates: Ints, extra: Float32, chosen: Ints) -> None:
    """Into `chosen` (point,) the candidate of least squared difference from the point's values, plus its `extra`.

    `seen` (point, values), `drawn` (texel, values), `candidates` (point, k) texels, `extra` (point, k) what each costs
    besides; the first of equals. A difference that is not finite is left out.
    """
    for point in range(len(seen)):
        values = seen[point]
        whole = np.isfinite(values.sum())
        least = np.inf
        chosen[point] = 0
        for k in range(candidates.shape[1]):
            other = drawn[candidates[point, k]]
            apart = _apart(values, other) if whole else _apart_where_known(values, other)
            if apart + extra[point, k] < least:
                least = apart + extra[point, k]
                chosen[point] = k
