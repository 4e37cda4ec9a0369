"""Seamless filling and cloning: Poisson's equation on the pixels of a mask, in float64."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from processing.errors import ImageError
from processing.products.arrays import Float64

Mask = NDArray[np.bool_]
_STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0))


def fill(picture: Float64, mask: Mask, guide: Float64 | None = None) -> Float64:
    """The picture (h, w[, channels]) with the pixels of `mask` (h, w) made anew.

    There the differences between neighbours are those of the `guide` picture, in the least squares sense, or as small
    as the border allows without one (a membrane); the border and what lies outside of the mask stay as they are. A
    pixel at the picture's edge has fewer neighbours. A constant added to the guide changes nothing.
    Source: Perez et al., Poisson Image Editing, 2003, eq. 7, solved by sparse factorisation.
    Raises ImageError where no pixel is known, those at the border are no numbers, or the shapes disagree.
    """
    values = np.asarray(picture, np.float64)
    if mask.shape != values.shape[:2] or (guide is not None and guide.shape != values.shape):
        raise ImageError(f"a mask of {mask.shape} and a guide must be of the picture's shape {values.shape}")
    if mask.all():
        raise ImageError("the mask covers the whole picture: there is no known pixel to go by")
    if not mask.any():
        return values.copy()
    planes = values.reshape(*mask.shape, -1)
    guiding = np.zeros_like(planes) if guide is None else np.asarray(guide, np.float64).reshape(planes.shape)
    matrix, right = _equations(planes, mask, guiding)
    result = planes.copy()
    result[mask] = splu(matrix).solve(right)
    if not np.isfinite(result[mask]).all():
        raise ImageError("the pixels around the mask are no numbers")
    return result.reshape(values.shape)


def _equations(planes: Float64, mask: Mask, guiding: Float64) -> tuple[csc_array, Float64]:
    """One row for each masked pixel: sum over neighbours of (f_p - f_q) = sum of (g_p - g_q)."""
    number = np.full(mask.shape, -1, np.int64)
    number[mask] = np.arange(np.count_nonzero(mask))
    rows, columns = np.nonzero(mask)
    degree, right = np.zeros(len(rows)), np.zeros((len(rows), planes.shape[-1]))
    ones: list[NDArray[np.int64]] = []
    others: list[NDArray[np.int64]] = []
    for down, across in _STEPS:
        y, x = rows + down, columns + across
        inside = (y >= 0) & (y < mask.shape[0]) & (x >= 0) & (x < mask.shape[1])
        p, y, x = np.nonzero(inside)[0], y[inside], x[inside]
        degree[p] += 1
        right[p] += guiding[rows[p], columns[p]] - guiding[y, x]
        known = ~mask[y, x]
        right[p[known]] += planes[y[known], x[known]]
        ones.append(p[~known])
        others.append(number[y[~known], x[~known]])
    one, other, all_rows = np.concatenate(ones), np.concatenate(others), np.arange(len(rows))
    entries = np.concatenate([degree, np.full(len(one), -1.0)])
    places = np.concatenate([all_rows, one]), np.concatenate([all_rows, other])
    return csc_array(coo_array((entries, places), shape=(len(rows), len(rows)))), right
