"""Pixels' rays cut by the laser plane at their peak times, in one pass over the image."""

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from processing.laser.even_spline import ORDER, basis, locate, value_and_slope
from processing.laser.fan import angle_slopes
from processing.laser.holder_kernel import to_sample

Array = NDArray[np.float64]
MEASURED, NOT_SAMPLE, NO_PEAK, NO_PLANE, OUTSIDE_BOX = range(5)
GRAZING = 0.05  # cosine between view ray and plane normal under which the cut means nothing
VAGUE = 12.0  # the box's depth squared over the variance of any place in it: what says no more says nothing
MARGIN_M = 0.0003  # by which a point may leave the sample's box, beside three sigma


class SweepModel(NamedTuple):
    """A sweep's planes: the fan's frame (4, 3), the spline of its angle, what both leave open, and the known times.

    `excess_rad2` (pieces,) is the unexplained variance of the angle in every piece of the spline.
    """

    frame: Array
    knots: Array
    coefficients: Array
    covariance: Array
    excess_rad2: Array
    first: float
    last: float


class SampleBox(NamedTuple):
    """The box that holds the sample: sample_from_rig (4, 4), half the opening's side, depth."""

    sample_from_rig: Array
    half_m: float
    depth_m: float


@njit(inline="always")
def _model_variance(
    model: SweepModel, slopes: tuple[float, float, float, float, float], time: float, row: Array
) -> float:
    """Variance of the angle between the plane at a time and a point: the model's parameters', and the unexplained."""
    piece, u = locate(model.knots, time)
    row[0], row[1], row[2], row[3] = slopes[0], slopes[1], slopes[2], slopes[3]
    b0, b1, b2, b3 = basis(u)
    row[4], row[5], row[6], row[7] = -b0, -b1, -b2, -b3
    total = float(model.excess_rad2[piece])
    for i in range(4 + ORDER):
        k = i if i < 4 else i + piece
        part = 0.5 * model.covariance[k, k] * row[i]
        for j in range(i):
            part += model.covariance[k, j if j < 4 else j + piece] * row[j]
        total += 2.0 * part * row[i]
    return total


@njit(inline="always")
def _outside(box: SampleBox, x: float, y: float, z: float, sigma: float) -> bool:
    """Whether a point, rig frame, lies where no sample can be."""
    turn, margin = box.sample_from_rig, MARGIN_M + 3.0 * sigma
    across, along = to_sample(turn, x, y, z)
    deep = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z + turn[2, 3]
    inside = abs(across) <= box.half_m + margin and abs(along) <= box.half_m + margin
    return not (inside and deep <= margin and deep >= -box.depth_m - margin)


@njit(inline="always")
def _cut(
    model: SweepModel, centre: Array, ray: tuple[float, float, float], peak: tuple[float, float], row: Array
) -> tuple[float, float]:
    """Distance along a unit ray from z = 0 to the plane at a peak's time, and its variance; NaN where there is none."""
    time, time_variance = peak
    angle, speed = value_and_slope(model.knots, model.coefficients, time)
    source, level, up = model.frame[0], model.frame[1], model.frame[3]
    sine, cosine = np.sin(angle), np.cos(angle)
    nx, ny, nz = sine * level[0] - cosine * up[0], sine * level[1] - cosine * up[1], -cosine * up[2]
    slant = nx * ray[0] + ny * ray[1] + nz * ray[2]
    if not abs(slant) > GRAZING:
        return np.nan, np.nan
    away = nx * (source[0] - centre[0]) + ny * (source[1] - centre[1]) + nz * (source[2] - centre[2])
    length = away / slant
    point = centre[0] + length * ray[0], centre[1] + length * ray[1], centre[2] + length * ray[2]
    slopes = angle_slopes(model.frame, point[0], point[1], point[2])
    variance = speed * speed * time_variance + _model_variance(model, slopes, time, row)
    return length + centre[2] / ray[2], variance * slopes[4] / (slant * slant)


@njit(parallel=True, cache=True, error_model="numpy")
def cut_rays(
    view: tuple[Array, Array],
    peaks: tuple[NDArray[np.float32], NDArray[np.float32]],
    model: SweepModel,
    box: SampleBox,
    status: NDArray[np.uint8],
    found: NDArray[np.float32],
) -> None:
    """Write status (h, w), displacement and its variance (2, h, w) of every pixel that has a time; see `range_image`.

    `view`: the pixels' rays (h, w, 3) and the camera's centre; `peaks`: times and their variances (h, w), NaN where
    there is none.
    """
    rays, centre = view
    times, time_variances = peaks
    height, width = status.shape
    for r in prange(height):
        row = np.empty(4 + ORDER)
        for c in range(width):
            found[0, r, c] = found[1, r, c] = np.nan
            ray = rays[r, c, 0], rays[r, c, 1], rays[r, c, 2]
            top = -centre[2] / ray[2]
            x, y = to_sample(box.sample_from_rig, centre[0] + top * ray[0], centre[1] + top * ray[1], 0.0)
            if not (top > 0.0 and max(abs(x), abs(y)) < box.half_m):
                status[r, c] = NOT_SAMPLE
                continue
            time = float(times[r, c])
            if time != time:
                status[r, c] = NO_PEAK
                continue
            status[r, c] = NO_PLANE
            if time >= model.first and time <= model.last:
                depth, spread = _cut(model, centre, ray, (time, float(time_variances[r, c])), row)
                if VAGUE * spread <= box.depth_m**2:  # so no NaN either
                    way = top + depth
                    place = centre[0] + way * ray[0], centre[1] + way * ray[1], centre[2] + way * ray[2]
                    if _outside(box, place[0], place[1], place[2], np.sqrt(spread)):
                        status[r, c] = OUTSIDE_BOX
                        continue
                    status[r, c] = MEASURED
                    found[0, r, c], found[1, r, c] = depth, spread
