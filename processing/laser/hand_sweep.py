"""Range from a line laser swept by hand in front of a fixed camera, with two printed rectangles as reference.

One rectangle hangs on a wall, the other lies on the table before it; in every frame the stripe's lines on both give
the laser's plane, and every pixel's peak time tells which plane it lay in (Bouguet and Perona 1998, with a laser).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.errors import CalibrationError, ImageError
from processing.formats.sequence import read_animation
from processing.laser.plane_fit import Plane, fit_plane, plane_angle
from processing.laser.ridge import stripe_ridge
from processing.laser.space_time import PeakStatus, PeakTimes, PulseSettings, peak_times
from processing.laser.stripe import redness, stripe_line
from processing.radiometry.sensor import Sensor
from processing.robust import bulk_deviation

Array = NDArray[np.float64]
RECTANGLE_M = (0.230, 0.130)  # inner border of the printed frames
CALIBRATED_WIDTH_PX = 1280.0
_ENLARGE = 4  # the contour of a frame is found in an enlarged picture
_CODE_DN = 8  # redness is handed to the space-time analysis in eighths of a code
_SENSOR = Sensor(256.0, 4095.0, 1.0 / _CODE_DN, 3.0)  # palette pictures: about three codes of noise
_PULSE = PulseSettings(width_tolerance=0.5, double_fraction=0.6)  # a hand's speed varies
_RIDGE_SIGMA_PX, _RIDGE_THRESHOLD = 1.2, 3.0
_LINE_POINTS = 8


@dataclass(frozen=True)
class HandSweep:
    """What a hand-held sweep measured, camera frame, metres.

    `points_m` (h, w, 3) and `depth_m` (h, w) along the optical axis are NaN where no stripe passed; `picture` (h, w, 3)
    uint8 is the scene without the stripe. `planes` holds the laser's plane per frame, None where a line is missing.
    `wall_rms_m` and `floor_rms_m` are RMS distances of points measured on the rectangles from their planes, and
    `corner_angle_rad` the angle between wall and table: what can be checked without knowing the object.
    """

    points_m: Array
    depth_m: NDArray[np.float32]
    picture: NDArray[np.uint8]
    peaks: PeakTimes
    wall: Plane
    floor: Plane
    planes: tuple[Plane | None, ...]
    wall_rms_m: float
    floor_rms_m: float
    corner_angle_rad: float


@dataclass(frozen=True)
class _Reference:
    plane: Plane
    mask: NDArray[np.bool_]


def laser_sweep(gif: Path, intrinsics: Path) -> HandSweep:
    """Range of every pixel that a hand-swept stripe passed in an animated picture.

    `intrinsics` is OpenCV's XML with K and dist, for pictures CALIBRATED_WIDTH_PX wide.
    Raises ImageError where the animation cannot be read, has under ten frames or shows no two rectangles or no stripe,
    and CalibrationError where the intrinsics cannot be read.
    """
    frames = read_animation(gif)
    if len(frames) < 10:
        raise ImageError(f"{gif}: {len(frames)} frames; a sweep needs ten or more.")
    matrix, distortion = read_intrinsics(intrinsics, frames.shape[2] / CALIBRATED_WIDTH_PX)
    picture = np.median(frames, axis=0).astype(np.uint8)
    wall, floor = _references(picture, matrix, distortion, gif)
    red = redness(frames.reshape(-1, *frames.shape[2:])).reshape(frames.shape[:3])
    red -= np.median(red, axis=0)
    rays = geometry.pixel_rays(_pixels(red.shape[1:]), matrix, distortion, np.eye(4))
    planes = tuple(_frame_plane(image, (wall, floor), (matrix, distortion)) for image in red)
    if sum(plane is not None for plane in planes) < 3:
        raise ImageError(f"{gif}: the stripe crosses both rectangles in fewer than three frames.")
    raw_dn = np.clip(np.rint(red * _CODE_DN + _SENSOR.black_dn), 0, _SENSOR.white_dn).astype(np.uint16)
    peaks = peak_times(raw_dn, _SENSOR, _PULSE)
    points = _cut(rays, peaks, planes)
    return HandSweep(
        points,
        points[..., 2].astype(np.float32),
        picture,
        peaks,
        wall.plane,
        floor.plane,
        planes,
        _rms(wall.plane.distance(points[wall.mask])),
        _rms(floor.plane.distance(points[floor.mask])),
        plane_angle(wall.plane, floor.plane),
    )


def read_intrinsics(path: Path, scale: float) -> tuple[Array, Array]:
    """Camera matrix (3, 3) for pictures reduced by `scale`, and distortion (5,), of OpenCV's XML with K and dist.

    Raises CalibrationError where they are not there.
    """
    try:
        root = ElementTree.parse(path).getroot()
        matrix, distortion = (
            np.array([float(value) for value in root.findtext(f"{name}/data", "").split()]) for name in ("K", "dist")
        )
        matrix = matrix.reshape(3, 3)
    except (OSError, ElementTree.ParseError, ValueError) as error:
        raise CalibrationError(f"{path}: no camera matrix K and distortion dist in it: {error}") from error
    if distortion.size != 5:
        raise CalibrationError(f"{path}: {distortion.size} distortion terms, not 5.")
    matrix[:2] *= scale
    matrix[:2, 2] += 0.5 * scale - 0.5  # pixel centres are at integers
    return matrix, distortion


def _pixels(shape: Sequence[int]) -> Array:
    rows, columns = np.indices(shape)
    return np.stack([columns, rows], axis=-1).astype(np.float64)


def _references(
    picture: NDArray[np.uint8], matrix: Array, distortion: Array, source: Path
) -> tuple[_Reference, _Reference]:
    """Wall and table by the two largest dark frames around white, the upper one on the wall."""
    quads = sorted(_frame_contours(picture), key=len, reverse=True)[:2]
    if len(quads) < 2:
        raise ImageError(
            f"{source}: {len(quads)} printed rectangles found; one on the wall and one on the table needed."
        )
    upper, lower = sorted(quads, key=lambda contour: float(contour[:, 1].mean()))
    shape = picture.shape[:2]
    return _reference(upper, matrix, distortion, shape), _reference(lower, matrix, distortion, shape)


def _frame_contours(picture: NDArray[np.uint8]) -> list[Array]:
    """Inner contours (n, 2) uv_px of dark frames that are quadrilaterals."""
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    large = cv2.resize(grey, None, fx=_ENLARGE, fy=_ENLARGE, interpolation=cv2.INTER_CUBIC)
    dark = (large < 0.5 * float(np.median(grey))).astype(np.uint8)
    contours, tree = cv2.findContours(dark, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    found = []
    for index, contour in enumerate(contours):
        hole = tree[0, index, 3] >= 0
        if hole and cv2.contourArea(contour) > 0.01 * large.size and len(_corners(contour)) == 4:
            found.append((contour[:, 0].astype(np.float64) + 0.5) / _ENLARGE - 0.5)
    return found


def _corners(contour: NDArray[np.generic]) -> Array:
    outline = np.asarray(contour, np.float32).reshape(-1, 1, 2)
    return np.asarray(cv2.approxPolyDP(outline, 0.03 * cv2.arcLength(outline, True), True)[:, 0], np.float64)


def _reference(contour: Array, matrix: Array, distortion: Array, shape: tuple[int, ...]) -> _Reference:
    """The rectangle's plane from lines through its undistorted sides, and the pixels inside it."""
    straight = np.asarray(cv2.undistortPoints(contour[:, None], matrix, distortion, P=matrix)[:, 0], np.float64)
    corners = _corners(straight)
    around = corners - corners.mean(axis=0)
    corners = corners[np.argsort(np.arctan2(around[:, 1], around[:, 0]))]  # from the top left, as the picture turns
    lines = [_side(straight, corners[i], corners[(i + 1) % 4]) for i in range(4)]
    exact = np.stack([np.linalg.solve(*_pair(lines[i - 1], lines[i])) for i in range(4)])
    width, height = RECTANGLE_M
    model = np.array([(0, 0, 0), (width, 0, 0), (width, height, 0), (0, height, 0)])
    _, rotation, translation = cv2.solvePnP(model, exact, matrix, np.zeros(5), flags=cv2.SOLVEPNP_IPPE)
    camera_from_rectangle = geometry.rigid_from_vectors(rotation.ravel(), translation.ravel())
    mask = np.zeros(shape, np.uint8)
    cv2.fillPoly(mask, [np.rint(contour).astype(np.int32)], 1)
    return _Reference(Plane.of_board(camera_from_rectangle), cv2.erode(mask, np.ones((5, 5), np.uint8)).astype(bool))


def _side(points: Array, start: Array, end: Array) -> tuple[Array, float]:
    """Line through the contour's points along one side, away from its corners."""
    along = (end - start) / np.linalg.norm(end - start)
    place = (points - start) @ along / np.linalg.norm(end - start)
    across = np.abs((points - start) @ np.array([-along[1], along[0]]))
    line = stripe_line(points[(place > 0.1) & (place < 0.9) & (across < 5.0)])
    return line.normal, line.offset_px


def _pair(first: tuple[Array, float], second: tuple[Array, float]) -> tuple[Array, Array]:
    return np.stack([first[0], second[0]]), np.array([first[1], second[1]])


def _frame_plane(image: Array, references: tuple[_Reference, _Reference], lens: tuple[Array, Array]) -> Plane | None:
    """The laser's plane in one frame from its lines on wall and table."""
    points = []
    for reference in references:
        ridge = stripe_ridge(image, _RIDGE_SIGMA_PX, _RIDGE_THRESHOLD, reference.mask)
        if len(ridge.uv_px) < _LINE_POINTS:
            return None
        line = stripe_line(ridge.uv_px, 1.5)
        if np.count_nonzero(line.inliers) < _LINE_POINTS:
            return None
        rays = geometry.pixel_rays(ridge.uv_px[line.inliers], *lens, np.eye(4))
        points.append(reference.plane.cut(rays))
    return fit_plane(np.concatenate(points)).towards(np.array([1.0, 0.0, 0.0]))


def _cut(rays: Array, peaks: PeakTimes, planes: tuple[Plane | None, ...]) -> Array:
    """Points (h, w, 3) where rays meet the planes at their peak times, interpolated between frames."""
    known = [(index, plane) for index, plane in enumerate(planes) if plane is not None]
    frames = np.array([index for index, _ in known], np.float64)
    values = np.array([[*plane.normal, plane.offset_m] for _, plane in known])
    measured = peaks.status == PeakStatus.OK
    measured &= (np.nan_to_num(peaks.time_frames) >= frames[0]) & (np.nan_to_num(peaks.time_frames) <= frames[-1])
    time = peaks.time_frames[measured].astype(np.float64)
    normal = np.stack([np.interp(time, frames, values[:, axis]) for axis in range(3)], axis=-1)
    offset = np.interp(time, frames, values[:, 3])
    points = np.full(rays.shape, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        length = offset / np.einsum("ij,ij->i", normal, rays[measured])
    points[measured] = np.where(length > 0, length, np.nan)[:, None] * rays[measured]
    return points


def _rms(distance_m: Array) -> float:
    """Robust RMS of the finite distances; NaN where there is none."""
    finite = distance_m[np.isfinite(distance_m)]
    return bulk_deviation(finite) if finite.size else float("nan")
