"""What the calibration of a camera leaves open near the sample, as seven small numbers.

Boards near the sample tell well where points near it are imaged, but less well from where. The seven are: shift of the
image (2, px); its scale (relative); the camera's distance and focal length, which grow together (relative); and a turn
of the camera about the rig's origin (3, rad).
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
    return np.array([SHIFT_SIGMA_PX] * 2 + [SCALE_SIGMA, focal] + [TURN_SIGMA_RAD] * 3)


def reflection_image(camera: CameraModel, doubt: Array, ball: tuple[Array, float], sources_m: Array) -> Array:
    """Images (n, 2) of point sources (n, 3) in a mirror ball (centre (3,) or (n, 3), radius) by a doubted camera."""
    turn = _rotation(-doubt[4:])
    centre, radius_m = ball[0] @ turn.T, ball[1]
    eye, more = camera.centre_m, 1 + doubt[3]
    at = reflection_points(centre, radius_m, sources_m @ turn.T, more * eye)
    uv_px = camera.project(_nearer(at, eye, more))
    middle_px = camera.project(np.zeros((1, 3)))
    return np.asarray(middle_px + (1 + doubt[2]) * (uv_px - middle_px) + doubt[:2], np.float64)


def reflection_points(centre_m: Array, radius_m: float, sources_m: Array, eyes_m: Array) -> Array:
    """Points (n, 3) of a ball in which eyes (n, 3) see point sources (n, 3): there the normal halves the angle."""
    normal = _unit(_unit(sources_m - centre_m) + _unit(eyes_m - centre_m))
    for _ in range(_REFLECTIONS):
        at = centre_m + radius_m * normal
        normal = _unit(_unit(sources_m - at) + _unit(eyes_m - at))
    return np.asarray(centre_m + radius_m * normal, np.float64)


def _nearer(points_m: Array, eye_m: Array, more: float) -> Array:
    """Points (n, 3) that the camera images where one of `more` times its distance and focal length images the given.

    In the plane through the origin that faces the camera the two agree; before it the nearer camera sees larger.
    """
    distance = float(np.linalg.norm(eye_m))
    outward = eye_m / distance
    depth = (points_m @ outward)[:, None]
    lateral = points_m - depth * outward
    return np.asarray(depth * outward + lateral * more * (distance - depth) / (more * distance - depth), np.float64)


def _rotation(turn_rad: Array) -> Array:
    """Rotation (3, 3) of a small turn: exact to its second order."""
    x, y, z = turn_rad
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / 2, np.float64)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True), np.float64)
