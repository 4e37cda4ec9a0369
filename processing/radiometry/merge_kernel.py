"""The loop of the HDR merge, compiled by numba; its plain NumPy twin is in tests/reference."""

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

OK, SATURATED, DARK, MISSING, HOT = 0, 1, 2, 3, 4
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
    sensor: tuple[float, float, float, float],
    offset_dn: NDArray[np.float32] | None,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
    """Radiance, variance and status of a stack (k, h, w), each frame read once; see `hdr.merge_exposures`.

    `sensor` = (black_dn, white_dn, gain in e-/DN, dark variance in e-^2).
    """
    black_dn, white_dn, gain, dark_variance = sensor
    frames, height, width = raw_dn.shape
    value = np.empty((height, width), np.float32)
    variance = np.empty((height, width), np.float32)
    status = np.empty((height, width), np.uint8)
    for y in prange(height):
        sample_e = np.empty(frames)
        sample_s = np.empty(frames)
        for x in range(width):
            used, saturated_from = 0, frames
            black = black_dn if offset_dn is None else black_dn + offset_dn[y, x]
            limits = ((white_dn - 0.5 - black) * gain, dark_variance)
            for i in range(frames):
                dn = float(raw_dn[i, y, x])
                if dn >= white_dn:  # also positive infinity
                    saturated_from -= 1
                    sample_s[saturated_from] = exposure_s[i]
                elif math.isfinite(dn):
                    sample_e[used] = (dn - black) * gain
                    sample_s[used] = exposure_s[i]
                    used += 1
            value[y, x], variance[y, x], status[y, x] = _maximum_likelihood(
                sample_e, sample_s, used, saturated_from, limits
            )
    return value, variance, status
