"""What one pixel shows under every light, in the form that its normal is sought in; compiled."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Values = NDArray[np.floating]
FEWEST = 4  # samples: three would be met exactly, and nothing would tell a highlight from a slope
DARK = 0.03  # of the fourth brightest sample: what is darker is in a shadow, whose light came round about
NOISES = 3.0  # standard deviations by which noise may explain what is seen
ROUNDING = 1e-6  # of the brightest sample: what float32 leaves of a value


class Samples(NamedTuple):
    """One pixel's samples: grey value (m,), variance (m,), light vectors (m, 3), and which lights they are (m,).

    What is darker than `dark` is in a shadow.
    """

    grey: Array
    variance: Array
    vector: Array
    light: NDArray[np.intp]
    dark: float


@njit(cache=True)
def light_vector(light: Array, point: Array) -> tuple[float, float, float]:
    """From a point to a light (direction, distance) as long as its irradiance is against that at the origin."""
    if np.isinf(light[3]):
        return light[0], light[1], light[2]
    x, y, z = light[0] * light[3] - point[0], light[1] * light[3] - point[1], light[2] * light[3] - point[2]
    length2 = x * x + y * y + z * z
    scale = light[3] * light[3] / (length2 * np.sqrt(length2))
    return x * scale, y * scale, z * scale


@njit(cache=True)
def channel_shares(value: Values) -> tuple[Array, float]:
    """Mean colour of a pixel's samples (light, 3), of mean 1, and the largest value."""
    shares, largest = np.zeros(3), 0.0
    for i in range(len(value)):
        total = value[i, 0] + value[i, 1] + value[i, 2]
        for channel in range(3):
            if np.isfinite(total):
                shares[channel] += max(value[i, channel], 0.0)
            if np.isfinite(value[i, channel]):
                largest = max(largest, float(value[i, channel]))
    total = shares.sum()
    return (shares * (3.0 / total) if total > 0 else np.ones(3)), largest


@njit(cache=True)
def gather(value: Values, variance: Values, lights: Array, point: Array) -> Samples:
    """The measured samples of a pixel (light, 3), channels weighed together by their colour and their noise."""
    count = len(value)
    grey, spread, vector, light = np.empty(count), np.empty(count), np.empty((count, 3)), np.empty(count, np.intp)
    shares, largest = channel_shares(value)
    floor = (ROUNDING * largest) ** 2
    kept = 0
    for i in range(count):
        weight, total = 0.0, 0.0
        for channel in range(3):
            noise = variance[i, channel] + floor
            if np.isfinite(value[i, channel]) and np.isfinite(noise) and noise > 0:
                weight += shares[channel] ** 2 / noise
                total += shares[channel] * value[i, channel] / noise
        if weight > 0:
            grey[kept], spread[kept], light[kept] = total / weight, 1.0 / weight, i
            vector[kept, 0], vector[kept, 1], vector[kept, 2] = light_vector(lights[i], point)
            kept += 1
    dark = DARK * float(np.sort(grey[:kept])[kept - FEWEST]) if kept >= FEWEST else np.inf
    return Samples(grey[:kept], spread[:kept], vector[:kept], light[:kept], dark)


@njit(cache=True)
def lit(samples: Samples) -> NDArray[np.intp]:
    """Indices of the samples that are no shadow; none where there are not enough samples."""
    return np.flatnonzero(samples.grey > samples.dark + NOISES * np.sqrt(samples.variance))
