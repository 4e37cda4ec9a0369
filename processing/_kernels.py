"""Loops over pixels, compiled by numba. Each has a plain NumPy twin in tests/reference."""

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

OK, SATURATED, DARK, MISSING = 0, 1, 2, 3
ITERATIONS = 20
TOLERANCE = 1e-6  # squared step in units of the variance: a thousandth of a standard deviation


@njit(inline="always")
def _censored(excess_e: float, variance: float) -> tuple[float, float]:
    """Score and information about the mean of 'at least the saturation level', `excess_e` above the mean.

    With a = excess / sigma and the hazard l = phi(a) / Q(a): d log Q / d mean = l (1 / sigma + a / 2 variance), the
    second part because the variance grows with the mean; information l (l - a) / variance (Tobin 1958).
    """
    sigma = math.sqrt(variance)
    a = excess_e / sigma
    if a < -8.0:
        return 0.0, 0.0
    if a > 8.0:
        hazard = a + 1.0 / a
    else:
        hazard = 0.7978845608028654 * math.exp(-0.5 * a * a) / math.erfc(0.7071067811865476 * a)
    return hazard * (1.0 / sigma + 0.5 * a / variance), hazard * (hazard - a) / variance


@njit(inline="always")
def _step(
    radiance: float,
    sample_e: NDArray[np.float64],
    sample_s: NDArray[np.float64],
    used: int,
    saturated_from: int,
    sensor: tuple[float, float],
) -> tuple[float, float]:
    """Fisher-scoring step and information at `radiance`; `sensor` = (saturation_e, dark variance)."""
    saturation_e, dark_variance = sensor
    score, information = 0.0, 0.0
    for i in range(used):
        mean = radiance * sample_s[i]
        weight = sample_s[i] / (max(mean, 0.0) + dark_variance)
        score += weight * (sample_e[i] - mean)
        information += weight * sample_s[i]
    for i in range(saturated_from, sample_s.size):
        mean = radiance * sample_s[i]
        pull, sharpness = _censored(saturation_e - mean, max(mean, 0.0) + dark_variance)
        score += sample_s[i] * pull
        information += sample_s[i] * sample_s[i] * sharpness
    return score / information, information


@njit(inline="always")
def _maximum_likelihood(
    sample_e: NDArray[np.float64],
    sample_s: NDArray[np.float64],
    used: int,
    saturated_from: int,
    sensor: tuple[float, float],
) -> tuple[float, float, int]:
    """Radiance, variance and status of one pixel: `used` unsaturated samples in front, saturated ones behind."""
    if used == 0:
        return np.nan, np.nan, MISSING if saturated_from == sample_s.size else SATURATED
    radiance = sample_e[:used].sum() / sample_s[:used].sum()
    information = 1.0
    for _ in range(ITERATIONS):
        step, information = _step(radiance, sample_e, sample_s, used, saturated_from, sensor)
        radiance += step
        if step * step * information < TOLERANCE:
            break
    return radiance, 1.0 / information, DARK if radiance < 3.0 / math.sqrt(information) else OK


@njit(parallel=True, cache=True)
def merge_exposures(
    raw_dn: NDArray[np.generic],
    exposure_s: NDArray[np.float64],
    black_dn: float,
    white_dn: float,
    gain: float,
    dark_variance: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
    """Radiance, variance and status of a stack (k, h, w), each frame read once; see `hdr.merge_exposures`."""
    frames, height, width = raw_dn.shape
    value = np.empty((height, width), np.float32)
    variance = np.empty((height, width), np.float32)
    status = np.empty((height, width), np.uint8)
    sensor = ((white_dn - 0.5 - black_dn) * gain, dark_variance)
    for y in prange(height):
        sample_e = np.empty(frames)
        sample_s = np.empty(frames)
        for x in range(width):
            used, saturated_from = 0, frames
            for i in range(frames):
                dn = float(raw_dn[i, y, x])
                if dn >= white_dn:  # also positive infinity
                    saturated_from -= 1
                    sample_s[saturated_from] = exposure_s[i]
                elif math.isfinite(dn):
                    sample_e[used] = (dn - black_dn) * gain
                    sample_s[used] = exposure_s[i]
                    used += 1
            value[y, x], variance[y, x], status[y, x] = _maximum_likelihood(
                sample_e, sample_s, used, saturated_from, sensor
            )
    return value, variance, status


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
