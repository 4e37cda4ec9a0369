"""First guesses of a lens from views of a plane board, before anything is adjusted."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from processing.cameras.board import BoardView
from processing.cameras.lens import Fisheye, Pinhole
from processing.cameras.placement import board_poses, errors_px, likely_corners
from processing.errors import CalibrationError

Array = NDArray[np.float64]
_FIELDS_RAD = np.radians(np.geomspace(8, 260, 24))  # tried for the image's shorter side
_TRIED_VIEWS = 10  # enough for a start


def pinhole_start(views: Sequence[BoardView], size: tuple[int, int]) -> Pinhole:
    """Focal length by Zhang's method: square pixels, principal point in the middle, no distortion.

    Raises CalibrationError where the views do not determine it.
    """
    flags = cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST
    flags |= cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    likely = [likely_corners(view.points_m, view.uv_px) for view in views]
    points = [view.points_m[kept].astype(np.float32) for view, kept in zip(views, likely, strict=True)]
    uv_px = [view.uv_px[kept].astype(np.float32) for view, kept in zip(views, likely, strict=True)]
    square = _matrix(1.0, size)
    try:
        _, matrix, *_ = cv2.calibrateCamera(points, uv_px, size[::-1], square, np.zeros(5), flags=flags)
    except cv2.error as error:
        raise CalibrationError(f"the views do not determine the camera: {error.err}. Tilt the board more.") from error
    return Pinhole(np.asarray(matrix, np.float64), np.zeros(5))


def fisheye_start(views: Sequence[BoardView], size: tuple[int, int]) -> Fisheye:
    """The equidistant lens (r = f theta) that explains most of the views, of all fields of view from 8 to 260 deg.

    Each field alone gives every board its pose in closed form, also beside and behind the camera; so no guess is
    needed. Raises CalibrationError where no field does.
    """
    lenses = [Fisheye(_matrix(min(size) / field_rad, size), np.zeros(4)) for field_rad in _FIELDS_RAD]
    some = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, _TRIED_VIEWS).astype(int))]
    errors = [np.median([_view_error_px(lens, view) for view in some]) for lens in lenses]
    best = int(np.argmin(errors))
    if not np.isfinite(errors[best]):
        raise CalibrationError("no fish-eye lens explains the views; are the corners in the right order?")
    return lenses[best]


def _view_error_px(lens: Fisheye, view: BoardView) -> float:
    poses = board_poses(lens, view)
    return float(errors_px(lens, poses[:, None], [view]).min()) if len(poses) else np.inf


def _matrix(focal_px: float, size: tuple[int, int]) -> Array:
    return np.array([[focal_px, 0, (size[1] - 1) / 2], [0, focal_px, (size[0] - 1) / 2], [0, 0, 1.0]])
