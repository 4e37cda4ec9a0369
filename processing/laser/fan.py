"""Geometry of a line laser whose fan plane turns about a fixed axis through the laser.

Parameters (4,): elevation (rad) and distance (m) of the laser seen from the rig's origin, its azimuth (rad), and the
roll (rad) of the axis out of the horizontal. The axis is square to the azimuth; the fan's angle is the depression of
the plane, seen from the laser toward the origin.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Fan = NDArray[np.float64]
_STEP = 1e-5  # of the central differences: radians, metres


def fan_source(fan: Fan) -> tuple[Array, Array, Array]:
    """The laser's position and two unit vectors square to the fan's axis: level toward the laser, and up. (3,) each."""
    elevation, distance_m, azimuth, roll = fan
    level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    side = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.array([0.0, 0.0, np.cos(roll)]) - np.sin(roll) * side
    source = distance_m * (np.cos(elevation) * level + np.array([0.0, 0.0, np.sin(elevation)]))
    return source, level, up


def fan_angle(fan: Fan, points_m: Array) -> Array:
    """Depression angle (...) in radians of the plane that holds each rig-frame point (..., 3)."""
    source, level, up = fan_source(fan)
    towards = source - points_m
    return np.asarray(np.arctan2(towards @ up, towards @ level))


def fan_gradient(fan: Fan, points_m: Array) -> Array:
    """Derivatives (n, 4) of the angle of points (n, 3) by the parameters, by central differences."""
    rises = [fan_angle(fan + step, points_m) - fan_angle(fan - step, points_m) for step in _STEP * np.eye(4)]
    return np.stack(rises, axis=-1) / (2.0 * _STEP)


def fan_distance(fan: Fan, points_m: Array) -> Array:
    """Distance (...) in metres of points (..., 3) from the fan's axis."""
    source, level, up = fan_source(fan)
    towards = source - points_m
    return np.asarray(np.hypot(towards @ up, towards @ level))
