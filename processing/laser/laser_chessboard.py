"""A laser plane calibrated from photographs of its stripe on a chessboard in several poses.

Camera and poses are found in the photographs, or read from the folders that the Camera Calibration Toolbox for MATLAB
leaves behind: images, Calib_Results.mat (millimetres) and, to compare with, LaserPlane_Results.mat.
"""

from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from processing import geometry
from processing.cameras.board import find_chessboard
from processing.cameras.calibration import survey
from processing.cameras.network import Shot
from processing.errors import CalibrationError, ImageError
from processing.formats.sequence import picture_files, read_picture
from processing.laser.plane_fit import Plane, fit_plane, plane_angle
from processing.laser.ridge import stripe_ridge
from processing.laser.stripe import LaserColour, laser_light, room_light, stripe_line
from processing.robust import biweight, bulk_deviation

Array = NDArray[np.float64]
_SIGMA_PX = 4.0
_THRESHOLD = 4.0  # of the ridge's strength, 8-bit codes
_LEAST_POINTS = 20
_LEAST_BOARDS = 3  # that tell a camera
_CURVATURE_PX = 8.0  # by which lens distortion may bend the stripe away from a line


@dataclass(frozen=True)
class Chessboard:
    """A plain board: its inner corners along both sides, and the side of a square in metres."""

    columns: int
    rows: int
    square_m: float


@dataclass(frozen=True)
class BoardPhotograph:
    """A photograph's file, `camera_from_board` (4, 4), and the board's inner corners (n, 3) in its frame, metres."""

    path: Path
    camera_from_board: Array
    corners_m: Array


@dataclass(frozen=True)
class BoardCalibration:
    """Camera matrix, distortion, width and height of the pictures, rms of the corners (NaN if untold), photographs."""

    matrix: Array
    distortion: Array
    size_px: tuple[int, int]
    corner_rms_px: float
    photographs: tuple[BoardPhotograph, ...]


@dataclass(frozen=True)
class BoardStripe:
    """The stripe on one board: image points (n, 2), 3D points (n, 3) on the board's plane in the camera frame, metres.

    `row_rms_px` is the RMS distance of the image points, on their scan lines, from a robust quadratic along the stripe.
    """

    image: str
    uv_px: Array
    points_m: Array
    board: Plane
    row_rms_px: float


@dataclass(frozen=True)
class LaserChessboard:
    """The laser's plane in the camera frame, how well it is known, and the camera and boards that it comes from.

    `row_rms_px` is the mean of the stripes' own.
    `angle_deviation_rad` and `distance_deviation_m` (at the points' centre) are one sigma by the jackknife over images:
    the boards' poses, not the stripe, limit them. The last two compare with the plane published beside the images: the
    angle between both, and the mean distance of our points from it; NaN where none is.
    """

    plane: Plane
    stripes: tuple[BoardStripe, ...]
    row_rms_px: float
    angle_deviation_rad: float
    distance_deviation_m: float
    published_angle_rad: float
    published_distance_m: float
    calibration: BoardCalibration

    @property
    def points_m(self) -> Array:
        """All stripe points (n, 3), camera frame."""
        return np.concatenate([stripe.points_m for stripe in self.stripes])


def laser_chessboard(
    folder: Path, colour: LaserColour = LaserColour.RED, board: Chessboard | None = None
) -> LaserChessboard:
    """The laser plane of a folder of stripe photographs; the laser is no grey one.

    Of a `board` that is given, camera and poses are found in the photographs, else in the toolbox' calibration. The
    stripe is found to a fraction of a pixel within the board of every image, its rays are cut with the board, and all
    points make one plane. Raises ImageError where a file is missing, no image or no calibration, where the image's size
    is not the calibrated one, and where fewer than two boards show a stripe; CalibrationError where the photographs do
    not determine the camera.
    """
    calibration = _of_toolbox(folder) if board is None else _of_photographs(folder, board, colour)
    found = [_board_stripe(photograph, calibration, colour) for photograph in calibration.photographs]
    stripes = tuple(stripe for stripe in found if stripe is not None)
    if len(stripes) < 2:
        raise ImageError(f"{folder}: a laser stripe on {len(stripes)} of {len(found)} boards; at least 2 are needed.")
    plane = fit_plane(np.concatenate([stripe.points_m for stripe in stripes])).towards(np.array([0.0, 0.0, 1.0]))
    deviation = _jackknife(stripes, plane) if len(stripes) > 2 else (np.nan, np.nan)
    published = _published(folder, stripes, plane)
    row_rms_px = float(np.mean([stripe.row_rms_px for stripe in stripes]))
    return LaserChessboard(plane, stripes, row_rms_px, *deviation, *published, calibration)


def _of_toolbox(folder: Path) -> BoardCalibration:
    """The calibration that the toolbox left in a folder."""
    path = folder / "Calib_Results.mat"
    content = _read_mat(path, ("KK", "kc", "nx", "ny", "active_images"))
    photographs = []
    for number in (index + 1 for index, used in enumerate(content["active_images"].ravel()) if used):
        name = f"image{number:03d}.png"
        missing = [key for key in (f"omc_{number}", f"Tc_{number}", f"X_{number}") if key not in content]
        if missing:
            raise ImageError(f"{path}: no {missing[0]}, the board's pose in {name}.")
        pose = geometry.rigid_from_vectors(content[f"omc_{number}"].ravel(), content[f"Tc_{number}"].ravel() * 1e-3)
        photographs.append(BoardPhotograph(folder / name, pose, content[f"X_{number}"].T * 1e-3))
    matrix, distortion = content["KK"].astype(np.float64), content["kc"].ravel().astype(np.float64)
    size_px = int(content["nx"].item()), int(content["ny"].item())
    return BoardCalibration(matrix, distortion, size_px, np.nan, tuple(photographs))


def _of_photographs(folder: Path, board: Chessboard, colour: LaserColour) -> BoardCalibration:
    """Camera and poses from the board's corners in all pictures of a folder that show the whole board."""
    files = picture_files(folder)
    views = {path: find_chessboard(room_light(read_picture(path), colour), *astuple(board)) for path in files}
    whole = [path for path in files if len(views[path].uv_px)]
    if len(whole) < _LEAST_BOARDS:
        raise ImageError(
            f"{folder}: a whole chessboard of {board.columns} x {board.rows} inner corners in {len(whole)} of "
            f"{len(files)} pictures; at least {_LEAST_BOARDS} are needed."
        )
    height, width = read_picture(files[0]).shape[:2]
    shots = {Shot(pose): views[path] for pose, path in enumerate(whole)}
    try:
        found = survey({"camera": shots}, {"camera": (height, width)})
    except CalibrationError as error:
        raise CalibrationError(f"{folder}: {error}") from error
    camera = found.cameras["camera"]
    camera_from_rig = geometry.invert(camera.rig_from_camera)
    photographs = tuple(
        BoardPhotograph(path, camera_from_rig @ found.boards[pose], views[path].points_m)
        for pose, path in enumerate(whole)
        if pose in found.boards
    )
    return BoardCalibration(camera.lens.matrix, camera.lens.distortion, (width, height), camera.rms_px, photographs)


def _board_stripe(
    photograph: BoardPhotograph, calibration: BoardCalibration, colour: LaserColour
) -> BoardStripe | None:
    light = laser_light(_read_image(photograph.path, calibration.size_px), colour)
    points, upright = _ridge_points(light, _board_mask(photograph, calibration, light.shape))
    if len(points) < _LEAST_POINTS:
        return None
    points = points[stripe_line(points, _CURVATURE_PX).inliers]
    residual, good = bend_residual(points)
    uv_px = points[good] if upright else points[good][:, ::-1]
    board = Plane.of_board(photograph.camera_from_board)
    in_camera = board.cut(geometry.pixel_rays(uv_px, calibration.matrix, calibration.distortion, np.eye(4)))
    rms_px = float(np.sqrt(np.mean(residual[good] ** 2)))
    return BoardStripe(photograph.path.name, uv_px, in_camera, board, rms_px)


def _ridge_points(light: Array, mask: NDArray[np.bool_]) -> tuple[Array, bool]:
    """The stripe's points (n, 2), and whether it runs along the image's columns; if not they are (row, column)."""
    upright = stripe_ridge(light, _SIGMA_PX, _THRESHOLD, mask).uv_px
    lying = stripe_ridge(light.T, _SIGMA_PX, _THRESHOLD, mask.T).uv_px
    return (upright, True) if len(upright) >= len(lying) else (lying, False)


def _board_mask(
    photograph: BoardPhotograph, calibration: BoardCalibration, shape: tuple[int, ...]
) -> NDArray[np.bool_]:
    """Pixels of the board's inner corners and half a square around them."""
    corners_m, board_from_camera = photograph.corners_m, geometry.invert(photograph.camera_from_board)
    low, high = corners_m.min(axis=0), corners_m.max(axis=0)
    side = float(np.min(np.linalg.norm(np.diff(corners_m[:2], axis=0), axis=1))) / 2
    left, top, right, bottom = low[0] - side, low[1] - side, high[0] + side, high[1] + side
    outline = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
    flat = np.column_stack([outline, np.zeros(4)])
    uv_px = geometry.project(flat, calibration.matrix, calibration.distortion, board_from_camera)
    mask = np.zeros(shape, np.uint8)
    cv2.fillPoly(mask, [np.rint(uv_px).astype(np.int32)], 1)
    return mask.astype(bool)


def bend_residual(uv_px: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Distance (n,) of points (across, along) a stripe from a robust quadratic, and which of them follow it."""
    row = (uv_px[:, 1] - uv_px[:, 1].mean()) / max(float(np.ptp(uv_px[:, 1])), 1.0)
    design = np.stack([np.ones_like(row), row, row**2], axis=1)
    weight = np.ones(len(row))
    for _ in range(15):
        root = np.sqrt(weight)[:, None]
        residual = uv_px[:, 0] - design @ np.linalg.lstsq(design * root, uv_px[:, 0] * root[:, 0], rcond=None)[0]
        weight = biweight(residual, max(bulk_deviation(residual), 1e-6))
    return np.asarray(residual), weight > 0.0


def _jackknife(stripes: tuple[BoardStripe, ...], plane: Plane) -> tuple[float, float]:
    """One sigma of the plane's angle (rad) and of its distance at the points' centre (m), leaving each image out."""
    centre = np.concatenate([s.points_m for s in stripes]).mean(axis=0)
    others = [
        fit_plane(np.concatenate([s.points_m for s in stripes if s is not left])).towards(plane.normal)
        for left in stripes
    ]
    count = len(stripes)
    tilt = np.array([plane_angle(other, plane) for other in others])
    shift = np.array([float(other.distance(centre)) for other in others])
    factor = (count - 1) / count
    return float(np.sqrt(factor * np.sum(tilt**2))), float(np.sqrt(factor * np.sum((shift - shift.mean()) ** 2)))


def _published(folder: Path, stripes: tuple[BoardStripe, ...], plane: Plane) -> tuple[float, float]:
    path = folder / "LaserPlane_Results.mat"
    if not path.exists():
        return np.nan, np.nan
    values = _read_mat(path, ("laserPlane",))["laserPlane"].astype(np.float64).ravel()
    length = float(np.linalg.norm(values[:3]))
    other = Plane(values[:3] / length, -1e-3 * values[3] / length, np.nan, 0)
    points = np.concatenate([stripe.points_m for stripe in stripes])
    return plane_angle(plane, other), float(np.mean(other.distance(points)))


def _read_image(path: Path, size_px: tuple[int, int]) -> Array:
    """A photograph in 8-bit codes."""
    picture = read_picture(path)
    height, width = picture.shape[:2]
    if (width, height) != size_px:
        raise ImageError(f"{path}: {width} x {height} pixels, but {size_px[0]} x {size_px[1]} are calibrated.")
    return picture.astype(np.float64) / (1 if picture.dtype == np.uint8 else 257)


def _read_mat(path: Path, names: tuple[str, ...]) -> dict[str, Any]:
    try:
        content: dict[str, Any] = loadmat(str(path))
    except (OSError, ValueError, TypeError, NotImplementedError, MatReadError) as error:
        raise ImageError(f"{path}: not a readable MATLAB file: {error}") from error
    missing = [name for name in names if name not in content]
    if missing:
        raise ImageError(f"{path}: no {', '.join(missing)} in it.")
    return content
