"""What the calibration of a camera leaves open near the sample, as seven small numbers.

Boards on and near the reference plane tell well where its points are imaged, but less well from where: focal length and
distance grow together, with a turn that keeps the plane's image. So the camera is taken as an eye and an image of the
plane: a point is imaged where the line from the eye through it meets the plane. The seven are: shift (2, px), scale
(relative) and roll (rad) of the plane's image; the eye's distance (relative) and direction (2, rad: sideways, up).
"""

import numpy as np
from numpy.typing import NDArray

from processing.cameras.calibration import CameraModel

Array = NDArray[np.float64]
NUMBERS = 7
# One sigma, beside the focal length's, which the calibration tells.
SHIFT_SIGMA_PX = 0.05
SCALE_SIGMA = 5e-4
FOCAL_SIGMA = 0.02  # where the calibration does not tell
TURN_SIGMA_RAD = np.radians(0.04)
_REFLECTIONS = 8  # rounds, of which each gains a factor of distance over radius, 15 and more


def sigmas(camera: CameraModel) -> Array:
    """One sigma of each of the seven numbers (7,)."""
    told = np.nan if camera.deviation is None else camera.deviation[0] / camera.lens.matrix[0, 0]
    focal = float(np.clip(told, 1e-4, 0.2)) if np.isfinite(told) else FOCAL_SIGMA
    return np.array([SHIFT_SIGMA_PX, SHIFT_SIGMA_PX, SCALE_SIGMA, TURN_SIGMA_RAD, focal] + [TURN_SIGMA_RAD] * 2)


def reflection_image(camera: CameraModel, doubt: Array, ball: tuple[Array, float], sources_m: Array) -> Array:
    """Images (n, 2) of point sources (n, 3) in a mirror ball (centre (3,), radius) by a doubted camera."""
    eye = doubted_eye(camera, doubt)
    at = reflection_points(*ball, sources_m, eye)
    on_plane = at - (at[:, 2] / (at[:, 2] - eye[2]))[:, None] * (at - eye)
    middle_px, uv_px = camera.project(np.zeros((1, 3))), camera.project(on_plane)
    c, s = np.cos(doubt[3]), np.sin(doubt[3])
    turned = (uv_px - middle_px) @ np.array([[c, s], [-s, c]])
    return np.asarray(middle_px + (1 + doubt[2]) * turned + doubt[:2], np.float64)


def doubted_eye(camera: CameraModel, doubt: Array) -> Array:
    """Where the camera's centre (3,) is by these numbers, rig frame."""
    distance_m = float(np.linalg.norm(camera.centre_m))
    outward = camera.centre_m / distance_m
    sideways = np.array([-outward[1], outward[0], 0.0])
    level = float(np.linalg.norm(sideways))
    sideways = sideways / level if level > 1e-6 else np.array([0.0, 1.0, 0.0])
    direction = outward + doubt[5] * sideways + doubt[6] * np.cross(outward, sideways)
    return np.asarray((1 + doubt[4]) * distance_m * _unit(direction), np.float64)


def reflection_points(centre_m: Array, radius_m: float, sources_m: Array, eyes_m: Array) -> Array:
    """Points (n, 3) of a ball in which eyes (n, 3) see point sources (n, 3): there the normal halves the angle."""
    normal = _unit(_unit(sources_m - centre_m) + _unit(eyes_m - centre_m))
    for _ in range(_REFLECTIONS):
        at = centre_m + radius_m * normal
        normal = _unit(_unit(sources_m - at) + _unit(eyes_m - at))
    return np.asarray(centre_m + radius_m * normal, np.float64)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True), np.float64)
