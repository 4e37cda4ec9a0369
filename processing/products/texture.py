"""Bilinear texture lookup: the arithmetic that every shader repeats."""

import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float64


def bilinear_taps(
    uv: Float64, height: int, width: int, *, wrap: bool
) -> tuple[NDArray[np.intp], NDArray[np.intp], Float64]:
    """Rows, columns and weights (n, 4) of the four texels around each texture coordinate (n, 2).

    Texel (row, column) has its centre at u = (column + 0.5) / width, v = (row + 0.5) / height, v downward.
    Outside [0, 1] the texture repeats where `wrap` is set, else its border texels go on.
    """
    x = np.asarray(uv[:, 0], np.float64) * width - 0.5
    y = np.asarray(uv[:, 1], np.float64) * height - 0.5
    left, top = np.floor(x), np.floor(y)
    fx, fy = x - left, y - top
    columns = np.stack([left, left + 1, left, left + 1], axis=1).astype(np.intp)
    rows = np.stack([top, top, top + 1, top + 1], axis=1).astype(np.intp)
    weights = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], axis=1)
    if wrap:
        return rows % height, columns % width, weights
    return np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1), weights
