"""The time of a pulse without a model of its shape: its centroid, or a parabola through its three highest samples.

Both are for comparison and for sensors whose noise is unknown; the matched Gaussian is nearer to the bound.
"""

import math
from enum import IntEnum

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from processing.laser.block_maxima import AROUND, BLOCK
from processing.laser.pulse import DISTORTED, OK, SATURATED, Camera, Sweep
from processing.laser.pulse_lanes import TIME, VARIANCE

_REACH = 3.0  # widths on either side that enter a centroid
_PHASES = 64  # positions between frames over which a parabola's systematic error is averaged


class Estimator(IntEnum):
    """How the time is read from a pulse; what counts as a pulse is the same for all."""

    GAUSSIAN = 0  # maximum likelihood, at the Cramer-Rao bound
    CENTROID = 1  # centre of mass above the background, three widths on either side: 1 to 1.7 times the bound; for
    # pulses up to four frames wide
    PARABOLA = 2  # through the brightest sample and its neighbours: 1.3 to 12 times the bound; its sigma is up to 2.8
    # times too small where noise decides which sample is the brightest: in dim pulses (300 e-) and wide ones (3 frames)


@njit(parallel=True, cache=True)
def retime(
    sweep: Sweep,
    camera: Camera,
    width: float,
    centroid: bool,
    results: NDArray[np.float32],
    status: NDArray[np.uint8],
) -> None:
    """Replace TIME and VARIANCE of the pixels that are OK by those of the centroid, or else of the parabola.

    Pixels in which a sample that is needed is saturated become SATURATED, those without a peak there DISTORTED,
    as are all for the centroid of pulses wider than four frames: of a stream no samples beyond twelve frames are kept.
    """
    reach = math.ceil(_REACH * width) if centroid else 1
    kept = reach <= AROUND * BLOCK
    systematic = 0.0 if centroid else parabola_error(width) ** 2
    for pixel in prange(status.size):
        if status[pixel] == OK:
            time, variance = _estimate(pixel, sweep, camera, reach, centroid) if kept else (np.nan, np.inf)
            sound = variance > 0.0 and variance < np.inf
            results[TIME, pixel] = time if sound else np.nan
            results[VARIANCE, pixel] = variance + systematic if sound else np.nan
            if not sound:
                status[pixel] = SATURATED if variance < 0.0 else DISTORTED


@njit(nogil=True, cache=True)
def parabola_error(width: float) -> float:
    """Root mean square of a parabola's systematic error on a Gaussian of this width, over positions between frames."""
    total = 0.0
    for phase in range(_PHASES):
        shift = (phase + 0.5) / _PHASES - 0.5
        before, here, after = (
            math.exp(-0.5 * ((-1.0 - shift) / width) ** 2),
            math.exp(-0.5 * (shift / width) ** 2),
            math.exp(-0.5 * ((1.0 - shift) / width) ** 2),
        )
        total += (0.5 * (before - after) / (before - 2.0 * here + after) - shift) ** 2
    return math.sqrt(total / _PHASES)


@njit(nogil=True, cache=True, error_model="numpy")
def _estimate(pixel: int, sweep: Sweep, camera: Camera, reach: int, centroid: bool) -> tuple[float, float]:
    """Time and variance; the variance is -1 where a sample is saturated, infinite or NaN where there is no peak."""
    frames, origin, brightest, _, total, ambient, times = sweep
    peak = brightest[pixel]
    first, last = max(peak - reach, 0), min(peak + reach, times.size - 1)
    light, moments = np.empty(last - first + 1), times[first : last + 1]
    for k in range(light.size):
        light[k] = (frames[first + k - origin[pixel], pixel] - camera[0]) * camera[1]
    if light.max() >= camera[3] or light.size < 3:
        return np.nan, -1.0
    noise = np.maximum(light, 0.0) + camera[2]
    others = max(times.size - light.size, 1)
    summed = light.sum() / camera[1] + camera[0] * light.size
    background = ((total[pixel] - summed) / others - camera[0]) * camera[1]
    light -= background
    if ambient.size > 0:
        light -= background * ambient[first : last + 1]
    if centroid:
        return _centroid(light, moments, noise, (max(background, 0.0) + camera[2]) / others)
    return _parabola(light, moments, noise)


@njit(nogil=True, cache=True, error_model="numpy")
def _centroid(
    light: NDArray[np.float64], moments: NDArray[np.float64], noise: NDArray[np.float64], background: float
) -> tuple[float, float]:
    area = light.sum()
    time = (light * moments).sum() / area
    lever = moments - time
    return time, ((lever * lever * noise).sum() + background * lever.sum() ** 2) / (area * area)


@njit(nogil=True, cache=True, error_model="numpy")
def _parabola(
    light: NDArray[np.float64], moments: NDArray[np.float64], noise: NDArray[np.float64]
) -> tuple[float, float]:
    """Vertex of the parabola through three samples, by divided differences: their times may be uneven."""
    a, b = moments[0] - moments[1], moments[2] - moments[1]
    before, after = light[0] - light[1], light[2] - light[1]
    slope, bend = before * b * b - after * a * a, after * a - before * b
    shift = 0.5 * slope / -bend
    by_before = 0.5 * (b * b * -bend - slope * b) / (bend * bend)
    by_after = 0.5 * (-a * a * -bend + slope * a) / (bend * bend)
    by_here = -by_before - by_after
    variance = by_before**2 * noise[0] + by_here**2 * noise[1] + by_after**2 * noise[2]
    return moments[1] + shift, variance
