"""Cubic splines on even knots, for kernels: value, slope and the four basis functions that are not 0 at a time."""

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import BSpline

Array = NDArray[np.float64]
ORDER = 4  # coefficients that act on one time


def even_knots(first: float, last: float, pieces: int) -> Array:
    """Knots (pieces + 7,) of splines that are known from `first` to `last`."""
    step = (last - first) / pieces
    return np.asarray(first + step * np.arange(-3, pieces + 4))


def abscissae(knots: Array) -> Array:
    """The times (pieces + 3,) at which coefficients on a straight line make the spline that line."""
    return knots[2:-2]


def spline_on(knots: Array, coefficients: Array) -> BSpline:
    """The spline of these coefficients (pieces + 3,)."""
    return BSpline(knots, coefficients, 3)


def pieces_at(knots: Array, time: Array) -> NDArray[np.intp]:
    """The piece (n,) in which each time lies, the first or the last for times beyond the ends."""
    place = (time - knots[3]) / (knots[4] - knots[3])
    return np.asarray(np.clip(place, 0, len(knots) - 8), np.intp)


@njit(inline="always")
def locate(knots: Array, time: float) -> tuple[int, float]:
    """The first of the four coefficients at a time, and its place in [0, 1] within the piece; ends are held."""
    pieces = len(knots) - 7
    place = (time - knots[3]) / (knots[4] - knots[3])
    place = min(max(place, 0.0), float(pieces))
    piece = min(int(place), pieces - 1)
    return piece, place - piece


@njit(inline="always")
def basis(u: float) -> tuple[float, float, float, float]:
    """The basis functions at a place within a piece."""
    v = 1.0 - u
    return (
        v * v * v / 6.0,
        (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0,
        (4.0 - 6.0 * v * v + 3.0 * v * v * v) / 6.0,
        u * u * u / 6.0,
    )


@njit(inline="always")
def value_and_slope(knots: Array, coefficients: Array, time: float) -> tuple[float, float]:
    """The spline and its derivative at a time."""
    piece, u = locate(knots, time)
    c0, c1, c2, c3 = coefficients[piece], coefficients[piece + 1], coefficients[piece + 2], coefficients[piece + 3]
    b0, b1, b2, b3 = basis(u)
    v = 1.0 - u
    slope = 0.5 * v * v * (c1 - c0) + (0.5 + u * v) * (c2 - c1) + 0.5 * u * u * (c3 - c2)
    return b0 * c0 + b1 * c1 + b2 * c2 + b3 * c3, slope / (knots[4] - knots[3])
