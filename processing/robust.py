"""Statistics that a minority of wrong values does not move."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
TUKEY = 4.685  # 95 % efficiency for normal errors


def bulk_deviation(errors: NDArray[np.floating]) -> float:
    """Standard deviation of the bulk of errors about 0: 1.4826 times the median absolute value, as of a normal one."""
    return 1.4826 * float(np.median(np.abs(errors)))


def biweight(errors: Array, sigma: Array | float) -> Array:
    """Tukey's weights (...): 1 for an error of 0, falling to 0 at 4.685 sigma and beyond; sigma is positive."""
    return np.asarray(np.clip(1.0 - (errors / (TUKEY * sigma)) ** 2, 0.0, None) ** 2, np.float64)


def weighted_median_place(values: Array, weights: Array, axis: int = 0) -> NDArray[np.intp]:
    """Index of the lower weighted median along `axis`, which is kept with length 1, for `np.take_along_axis`.

    The least value that at least half of the weight does not exceed; weights are not negative, values finite. Where no
    value has a weight the index means nothing.
    """
    order = np.argsort(values, axis=axis, kind="stable")
    summed = np.cumsum(np.take_along_axis(weights, order, axis=axis), axis=axis)
    reached = summed >= 0.5 * np.take(summed, [-1], axis=axis)
    return np.take_along_axis(order, np.argmax(reached, axis=axis, keepdims=True), axis=axis)


def principal_axes(points: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Centre (d,) of weighted points (n, d), squared scatter (d,) along their principal axes, and these as columns.

    The scatter rises: the first axis is the normal of the line or plane of least weighted squared distance.
    """
    centre = weights @ points / weights.sum()
    around = points - centre
    scatter, axes = np.linalg.eigh((around * weights[:, None]).T @ around)
    return np.asarray(centre, np.float64), np.asarray(scatter, np.float64), np.asarray(axes, np.float64)
