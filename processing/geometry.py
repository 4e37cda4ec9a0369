"""Rigid transforms, pinhole projection with distortion, rays, planes and the texel grid of the sample.

A transform is 4x4 float64 on column vectors, named so that neighbours cancel: `rig_from_board = rig_from_camera @
camera_from_board`. Points are rows. The camera frame is OpenCV's: x right, y down, z forward; image points are
(column, row) with pixel centres at integers.
"""

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
_UNDISTORT = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-12)


def rigid(rotation: ArrayLike, translation_m: ArrayLike) -> Array:
    """Transform (4, 4) of a rotation matrix (3, 3) and a translation (3,)."""
    transform = np.eye(4)
    transform[:3, :3] = rotation
    transform[:3, 3] = translation_m
    return transform


def rigid_from_vectors(rotation_rad: ArrayLike, translation_m: ArrayLike) -> Array:
    """Transform (4, 4) of a rotation vector (axis times angle, Rodrigues) and a translation (3,)."""
    return rigid(cv2.Rodrigues(np.asarray(rotation_rad, np.float64).reshape(3, 1))[0], translation_m)


def rotation_z(angle_rad: float) -> Array:
    """Turn about +Z from +X toward +Y: `rig_from_sample` of a turntable at this angle."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return rigid([[c, -s, 0], [s, c, 0], [0, 0, 1]], np.zeros(3))


def invert(transform: Array) -> Array:
    """Inverse of a rigid transform, exact in its rotation."""
    rotation = transform[:3, :3].T
    return rigid(rotation, -rotation @ transform[:3, 3])


def transform_points(transform: Array, points_m: NDArray[np.floating]) -> Array:
    """Points (..., 3) in the other frame."""
    return points_m @ transform[:3, :3].T + transform[:3, 3]


def rotate(transform: Array, directions: NDArray[np.floating]) -> Array:
    """Directions (..., 3) in the other frame."""
    moved: Array = directions @ transform[:3, :3].T
    return moved


def look_at(position_m: ArrayLike, target_m: ArrayLike, up: ArrayLike = (0, 0, 1)) -> Array:
    """`rig_from_camera` of a camera at a position that looks at a target, `up` pointing up in its image.

    Where the line of sight is along `up`, +X (the camera arc's azimuth) points down in the image instead.
    """
    position = np.asarray(position_m, np.float64)
    forward = _unit(np.asarray(target_m, np.float64) - position)
    right = np.cross(forward, np.asarray(up, np.float64))
    if np.linalg.norm(right) < 1e-9:
        right = np.cross(forward, (-1.0, 0.0, 0.0))
    right = _unit(right)
    return rigid(np.stack([right, np.cross(forward, right), forward], axis=1), position)


def _unit(vectors: Array) -> Array:
    normalised: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return normalised


def project(points_m: NDArray[np.floating], matrix: Array, distortion: Array, rig_from_camera: Array) -> Array:
    """Image points (..., 2) in uv_px of rig-frame points (..., 3); NaN behind the camera and too far out for a number.

    Distortion k1 k2 p1 p2 k3 as in OpenCV's calib3d.
    """
    local = transform_points(invert(rig_from_camera), points_m)
    depth = np.where(local[..., 2] > 0, local[..., 2], np.nan)
    with np.errstate(over="ignore", invalid="ignore"):  # all but in the camera's own plane
        bent = _distorted(local[..., 0] / depth, local[..., 1] / depth, np.ravel(distortion))
        uv_px = bent * matrix[[0, 1], [0, 1]] + matrix[:2, 2]
    return np.where(np.isfinite(uv_px).all(axis=-1, keepdims=True), uv_px, np.nan)


def _distorted(x: Array, y: Array, distortion: Array) -> Array:
    """Places (..., 2) on the plane at unit distance after radial and tangential distortion (Brown 1966)."""
    k1, k2, p1, p2, k3 = distortion
    xx, xy, yy = x * x, x * y, y * y
    r2 = xx + yy
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    across, down = x * radial + 2 * p1 * xy + p2 * (r2 + 2 * xx), y * radial + p1 * (r2 + 2 * yy) + 2 * p2 * xy
    return np.stack([across, down], axis=-1)


def pixel_rays(uv_px: NDArray[np.floating], matrix: Array, distortion: Array, rig_from_camera: Array) -> Array:
    """Unit directions (..., 3) in the rig frame, away from the camera, of undistorted image points (..., 2).

    All rays start at the camera's centre, `rig_from_camera[:3, 3]`.
    """
    flat = np.ascontiguousarray(uv_px, np.float64).reshape(-1, 1, 2)
    if flat.size == 0:
        return np.empty((*np.shape(uv_px)[:-1], 3))
    xy = cv2.undistortPoints(flat, matrix, distortion, criteria=_UNDISTORT)[:, 0]
    local = _unit(np.concatenate([xy, np.ones((len(xy), 1))], axis=1))
    return rotate(rig_from_camera, local).reshape(*np.shape(uv_px)[:-1], 3)


def intersect_plane(origin_m: ArrayLike, directions: Array, normal: ArrayLike, offset_m: float) -> Array:
    """Points (..., 3) where rays meet the plane normal . p = offset; NaN where they run along or away from it."""
    origin, n = np.asarray(origin_m, np.float64), np.asarray(normal, np.float64)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        distance_m = (offset_m - origin @ n) / (directions @ n)
    distance_m = np.where(np.isfinite(distance_m) & (distance_m > 0), distance_m, np.nan)
    return np.asarray(origin + distance_m[..., None] * directions)


def texel_corners(texels: int, side_m: float, z_m: float = 0.0) -> Array:
    """Corners (n + 1, n + 1, 3) of the texels at a height of the sample frame; row 0 lies at +Y."""
    edge = (np.arange(texels + 1) / texels - 0.5) * side_m
    return np.stack([*np.meshgrid(edge, -edge), np.full((texels + 1, texels + 1), z_m)], axis=-1)


def texel_grid(texels: int, side_m: float, z_m: float = 0.0) -> Array:
    """Centres (n, n, 3) of n x n texels over the sample square at a height of the sample frame; row 0 lies at +Y."""
    centre = ((np.arange(texels) + 0.5) / texels - 0.5) * side_m
    return np.stack([*np.meshgrid(centre, -centre), np.full((texels, texels), z_m)], axis=-1)
