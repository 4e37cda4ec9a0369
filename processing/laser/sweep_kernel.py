"""Residuals and normal equations of a sweep's planes: four parameters of the fan, then the spline's coefficients."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.laser.even_spline import ORDER, basis, locate, value_and_slope
from processing.laser.fan import angle_slopes

Array = NDArray[np.float64]


@njit(cache=True)
def residuals(points: Array, time: Array, frame: Array, spline: tuple[Array, Array], out: Array) -> None:
    """Write (2, n): every point's angle less the plane's at its time, and the plane's angular speed then."""
    source, level, up = frame[0], frame[1], frame[3]
    for i in range(len(time)):
        tx, ty, tz = source[0] - points[i, 0], source[1] - points[i, 1], source[2] - points[i, 2]
        angle = np.arctan2(tx * up[0] + ty * up[1] + tz * up[2], tx * level[0] + ty * level[1])
        expected, out[1, i] = value_and_slope(spline[0], spline[1], time[i])
        out[0, i] = angle - expected


@njit(cache=True, error_model="numpy")
def normal_equations(
    points: Array, time: Array, errors: tuple[Array, Array], frame: Array, knots: Array, out: tuple[Array, Array]
) -> None:
    """Add to (n, n) and (n,) the weighted squares of the residuals' derivatives, and these times the residuals.

    `errors`: the residuals and their weights. Of the coefficients only the four that act on a point's time take part.
    """
    normal, pull = out
    residual, weight = errors
    row, place = np.empty(4 + ORDER), np.arange(4 + ORDER)
    for i in range(len(time)):
        if weight[i] <= 0.0:
            continue
        piece, u = locate(knots, time[i])
        row[0], row[1], row[2], row[3], _ = angle_slopes(frame, points[i, 0], points[i, 1], points[i, 2])
        b0, b1, b2, b3 = basis(u)
        row[4], row[5], row[6], row[7] = -b0, -b1, -b2, -b3
        for k in range(ORDER):
            place[4 + k] = 4 + piece + k
        for a in range(4 + ORDER):
            scaled = weight[i] * row[a]
            pull[place[a]] += scaled * residual[i]
            for b in range(4 + ORDER):
                normal[place[a], place[b]] += scaled * row[b]


@njit(cache=True, error_model="numpy")
def invert(matrix: Array) -> None:
    """Invert a symmetric positive definite matrix (n, n) in place, by Gauss and Jordan; not finite where it has none.

    A hundred unknowns take a millisecond; a library that wakes threads for them waits longer than that on a busy
    machine.
    """
    for k in range(len(matrix)):
        pivot = 1.0 / matrix[k, k]
        matrix[k, k] = 1.0
        for j in range(len(matrix)):
            matrix[k, j] *= pivot
        for i in range(len(matrix)):
            if i != k:
                factor = matrix[i, k]
                matrix[i, k] = 0.0
                for j in range(len(matrix)):
                    matrix[i, j] -= factor * matrix[k, j]
