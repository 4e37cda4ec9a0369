"""Geometry of a line laser whose fan plane turns about a fixed axis through the laser.

Parameters (4,): elevation (rad) and distance (m) of the laser seen from the rig's origin, its azimuth (rad), and the
roll (rad) of the axis out of the horizontal. The axis is square to the azimuth; the fan's angle is the depression of
the plane, seen from the laser toward the origin.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Fan = NDArray[np.float64]


def fan_frame(fan: Fan) -> Array:
    """Rows (4, 3): the laser's position; unit vectors level toward the laser, level across, and up, square to the axis.

    The last is `up` turned about the first by the roll; the axis is their cross product.
    """
    elevation, distance_m, azimuth, roll = fan
    level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    side = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.array([0.0, 0.0, np.cos(roll)]) - np.sin(roll) * side
    source = distance_m * (np.cos(elevation) * level + np.array([0.0, 0.0, np.sin(elevation)]))
    return np.stack([source, level, side, up])


def fan_source(fan: Fan) -> tuple[Array, Array, Array]:
    """The laser's position and two unit vectors square to the fan's axis: level toward the laser, and up. (3,) each."""
    source, level, _, up = fan_frame(fan)
    return source, level, up


def fan_angle(fan: Fan, points_m: Array) -> Array:
    """Depression angle (...) in radians of the plane that holds each rig-frame point (..., 3)."""
    source, level, up = fan_source(fan)
    towards = source - points_m
    return np.asarray(np.arctan2(towards @ up, towards @ level))


@njit(inline="always")
def angle_slopes(frame: Array, px: float, py: float, pz: float) -> tuple[float, float, float, float, float]:
    """Derivatives of a point's angle by the four parameters, and the point's squared distance from the axis.

    The angle is atan2(y, x) with x, y the components along level and up of the way from the point to the laser.
    """
    source, level, side, up = frame[0], frame[1], frame[2], frame[3]
    tx, ty, tz = source[0] - px, source[1] - py, source[2] - pz
    x = tx * level[0] + ty * level[1]
    y = tx * up[0] + ty * up[1] + tz * up[2]
    across = tx * side[0] + ty * side[1]
    reach, height = source[0] * level[0] + source[1] * level[1], source[2]
    distance = np.sqrt(reach * reach + height * height)
    cosine, sine = up[2], -(up[0] * side[0] + up[1] * side[1])  # of the roll
    square = x * x + y * y
    return (
        (x * reach * cosine + y * height) / square,
        (x * height * cosine - y * reach) / (distance * square),
        (x * sine * (x - reach) - y * across) / square,
        -x * (sine * tz + cosine * across) / square,
        square,
    )
