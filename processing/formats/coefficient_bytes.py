"""Coefficients of relightable images as bytes: value = offset + step * byte.

Where the lights stand close together, the functions of the basis are much alike there, and the errors of coefficients
that are rounded one by one add up in the picture. So each is rounded after what the errors of those before it do has
been taken off: nearest-plane rounding (Babai 1986) in the metric of the image's lights.
"""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32, Float64
from processing.products.relightable_image import RelightableImage, metric

TOP = 255
# Shares of the values at either end that may be clipped, if that makes the steps so fine that the error falls.
_TAILS = (0.0, 1e-5, 1e-4, 1e-3)

Bytes = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Steps:
    """`step` and `offset` (k,) of each coefficient, or (k, channel)."""

    step: Float64
    offset: Float64

    def values(self, codes: Bytes) -> Float32:
        """The coefficients that bytes (..., k) stand for."""
        return np.asarray(self.offset + self.step * codes, np.float32)


def value_range(values: Float32) -> tuple[float, float]:
    """Range over 255 steps of which the mean squared error, of rounding and clipping together, is least.

    No pixel counts for more than what a display can be off, black for white: one that a light is extrapolated to
    thousands at must not coarsen all others.
    """
    best = (np.inf, 0.0, 0.0)
    for tail in _TAILS:
        low, high = (float(bound) for bound in np.quantile(values, (tail, 1 - tail)))
        outside = np.minimum(np.maximum(low - values, 0) + np.maximum(values - high, 0), 1)
        error = ((high - low) / TOP) ** 2 / 12 + float(np.mean(outside * outside, dtype=np.float64))
        best = min(best, (error, low, high))
    return best[1], best[2]


def to_bytes(image: RelightableImage, steps: Steps) -> Bytes:
    """Bytes of an image's coefficients, in their own order (k, y, x, channel)."""
    size, *_, channels = image.coefficients.shape
    step, offset = (np.broadcast_to(a.reshape(size, -1), (size, channels)) for a in (steps.step, steps.offset))
    weights = metric(image.basis, image.lights)
    order = _order(weights * np.outer(step.mean(axis=1), step.mean(axis=1)))
    factor = np.linalg.cholesky(weights[np.ix_(order, order)]).T  # |factor @ error|^2 is what the picture is off
    codes = np.empty(image.coefficients.shape, np.uint8)
    shape = (size, -1, channels)
    passed_on = factor / np.diag(factor)[:, None]
    _round(image.coefficients.reshape(shape), passed_on, order, step, offset, codes.reshape(shape))
    return codes


def _order(squares: Float64) -> NDArray[np.intp]:
    """The coefficient that is rounded last, whose error nothing takes off, first; `squares` are of errors of a step.

    Each is the one that weighs least beside those before it, which keeps the last ones from weighing much (sorted
    decomposition, Wuebben et al. 2001).
    """
    left, order = list(range(len(squares))), []
    remaining = squares.copy()
    while left:
        least = min(left, key=lambda k: float(remaining[k, k]))
        left.remove(least)
        order.append(least)
        remaining = remaining - np.outer(remaining[:, least], remaining[least]) / remaining[least, least]
    return np.array(order, np.intp)


@numba.njit(cache=True, parallel=True)
def _round(
    values: Float32, passed_on: Float64, order: NDArray[np.intp], step: Float64, offset: Float64, out: Bytes
) -> None:
    """From the last of `order` to the first; `passed_on` (i, j) is what an error of the j-th adds to the i-th."""
    size, count, channels = values.shape
    for n in numba.prange(count):
        errors = np.empty(size)
        for channel in range(channels):
            for i in range(size - 1, -1, -1):
                k = order[i]
                wanted = float(values[k, n, channel])
                for j in range(i + 1, size):
                    wanted -= passed_on[i, j] * errors[j]
                code = min(max(np.rint((wanted - offset[k, channel]) / step[k, channel]), 0.0), 255.0)
                out[k, n, channel] = np.uint8(code)
                errors[i] = offset[k, channel] + step[k, channel] * code - values[k, n, channel]
