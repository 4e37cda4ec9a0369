"""The loop of rectification, compiled by numba; its plain NumPy twin is in tests/reference."""

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray


@njit(inline="always")
def _tent_weights(
    window: NDArray[np.float64],
    quad: tuple[float, float, float, float, float, float, float, float],
    left: int,
    top: int,
    reach: int,
) -> None:
    """Add to `window` (rows from `top`, columns from `left`) the share of each pixel in the quadrilateral.

    `quad` = u v of its corners in the texel's row order. The points that sample it are at most a pixel apart, each
    weighs its neighbours by a tent of half width `reach`, and the whole plane would get a weight of one.
    """
    u00, v00, u01, v01, u10, v10, u11, v11 = quad
    across = max(1, math.ceil(max(math.hypot(u01 - u00, v01 - v00), math.hypot(u11 - u10, v11 - v10))))
    down = max(1, math.ceil(max(math.hypot(u10 - u00, v10 - v00), math.hypot(u11 - u01, v11 - v01))))
    share = 1.0 / (across * down * reach * reach)
    for i in range(down):
        b = (i + 0.5) / down
        for j in range(across):
            a = (j + 0.5) / across
            u = (1 - b) * ((1 - a) * u00 + a * u01) + b * ((1 - a) * u10 + a * u11)
            v = (1 - b) * ((1 - a) * v00 + a * v01) + b * ((1 - a) * v10 + a * v11)
            for y in range(max(math.ceil(v - reach), top), min(math.floor(v + reach), top + window.shape[0] - 1) + 1):
                row = share * (1.0 - abs(y - v) / reach)
                for x in range(
                    max(math.ceil(u - reach), left), min(math.floor(u + reach), left + window.shape[1] - 1) + 1
                ):
                    window[y - top, x - left] += row * (1.0 - abs(x - u) / reach)


@njit(inline="always")
def _weighted_mean(
    value: NDArray[np.float32], variance: NDArray[np.float32], window: NDArray[np.float64], left: int, top: int
) -> tuple[float, float, float]:
    """Mean of the finite pixels under the window, its variance, and the weight that they had."""
    total, mean, spread = 0.0, 0.0, 0.0
    for y in range(window.shape[0]):
        for x in range(window.shape[1]):
            weight = window[y, x]
            pixel = float(value[top + y, left + x])
            if weight > 0.0 and math.isfinite(pixel):
                total += weight
                mean += weight * pixel
                spread += weight * weight * float(variance[top + y, left + x])
    if total == 0.0:
        return np.nan, np.nan, 0.0
    return mean / total, spread / (total * total), total


@njit(parallel=True, cache=True)
def resample(
    value: NDArray[np.float32],
    variance: NDArray[np.float32],
    corners_px: NDArray[np.float64],
    channel_share: NDArray[np.float64],
    reach: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Means (n, m, c) of images (c, h, w) over the texels with corners (n + 1, m + 1, 2); see `rectification.rectify`.

    NaN where the finite pixels had less than half of the channel's share of the weight.
    """
    channels, height, width = value.shape
    rows, columns = corners_px.shape[0] - 1, corners_px.shape[1] - 1
    mean = np.full((rows, columns, channels), np.nan, np.float32)
    spread = np.full((rows, columns, channels), np.nan, np.float32)
    for r in prange(rows):
        for s in range(columns):
            block = corners_px[r : r + 2, s : s + 2]
            u, v = block[:, :, 0], block[:, :, 1]
            if not np.isfinite(u.sum() + v.sum()):
                continue
            left, right = max(0, math.floor(u.min()) - reach), min(width - 1, math.ceil(u.max()) + reach)
            top, bottom = max(0, math.floor(v.min()) - reach), min(height - 1, math.ceil(v.max()) + reach)
            if left > right or top > bottom:
                continue
            window = np.zeros((bottom - top + 1, right - left + 1))
            quad = (u[0, 0], v[0, 0], u[0, 1], v[0, 1], u[1, 0], v[1, 0], u[1, 1], v[1, 1])
            _tent_weights(window, quad, left, top, reach)
            for c in range(channels):
                m, q, total = _weighted_mean(value[c], variance[c], window, left, top)
                if total >= 0.5 * channel_share[c]:
                    mean[r, s, c], spread[r, s, c] = m, q
    return mean, spread
