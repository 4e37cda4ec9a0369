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
from processing.laser.plane_fit import Plane, fit_plane
from processing.laser.printed_rectangles import Lens, RectangleFit, find_rectangles, fit_rectangles
from processing.laser.ridge import stripe_ridge
from processing.laser.space_time import PeakStatus, PeakTimes, PulseSettings, peak_times
from processing.laser.stripe import redness, stripe_line
from processing.radiometry.sensor import Sensor
from processing.robust import bulk_deviation

Array = NDArray[np.float64]
RECTANGLE_M = (0.230, 0.130)  # inner border of the printed frames
CALIBRATED_WIDTH_PX = 1280.0
_CODE_DN = 8  # redness is handed to the space-time analysis in eighths of a code
_SENSOR = Sensor(256.0, 4095.0, 1.0 / _CODE_DN, 3.0)  # palette pictures: about three codes of noise
_PULSE = PulseSettings(width_tolerance=0.5, double_fraction=0.6)  # a hand's speed varies
_RIDGE_SIGMA_PX, _RIDGE_THRESHOLD = 1.2, 3.0
_LINE_POINTS = 8
_STEP_PX = 4.0  # of the stripe's column from row to row on one surface


@dataclass(frozen=True)
class HandSweep:
    """What a hand-held sweep measured, camera frame, metres.

    `points_m` (h, w, 3) and `depth_m` (h, w) along the optical axis are NaN where no stripe passed: by the pixel's peak
    time, `timed` (h, w), and where that is missing, as at the sweep's ends, by the stripe's ridge in one frame.
    `disagreement_m` is the robust RMS distance between both where both measured. `picture` (h, w, 3) uint8 is the scene
    without the stripe. `planes` holds the laser's plane per frame, None where a line is missing.

    `wall_rms_m` and `floor_rms_m` are RMS distances from the rectangles' planes of points timed on them; ridges there
    make the laser's planes and prove nothing. `fit` holds camera and rectangles as used, with the angle between wall
    and table; `own` what the rectangles alone say of the camera, to check a given one, None where they do not tell.
    """

    points_m: Array
    depth_m: NDArray[np.float32]
    timed: NDArray[np.bool_]
    disagreement_m: float
    picture: NDArray[np.uint8]
    peaks: PeakTimes
    wall: Plane
    floor: Plane
    planes: tuple[Plane | None, ...]
    wall_rms_m: float
    floor_rms_m: float
    fit: RectangleFit
    own: RectangleFit | None


@dataclass(frozen=True)
class _Reference:
    plane: Plane
    mask: NDArray[np.bool_]


def laser_sweep(gif: Path, intrinsics: Path | None) -> HandSweep:
    """Range of every pixel that a hand-swept stripe passed in an animated picture.

    `intrinsics` is OpenCV's XML as `read_intrinsics` takes it; without it the rectangles themselves tell the camera.
    Raises ImageError where the animation cannot be read, has under ten frames or shows no two rectangles or no stripe,
    and CalibrationError where the intrinsics cannot be read.
    """
    frames = read_animation(gif)
    if len(frames) < 10:
        raise ImageError(f"{gif}: {len(frames)} frames; a sweep needs ten or more.")
    given = None if intrinsics is None else read_intrinsics(intrinsics, frames.shape[2])
    picture = np.median(frames, axis=0).astype(np.uint8)
    contours = find_rectangles(picture)
    if len(contours) < 2:
        raise ImageError(
            f"{gif}: {len(contours)} printed rectangles found; one on the wall and one on the table needed."
        )
    fit, own = _fits(contours, picture.shape[:2], given)
    wall, floor = (_reference(p, c, picture.shape[:2]) for p, c in zip(fit.planes, contours, strict=True))
    red = redness(frames.reshape(-1, *frames.shape[2:])).reshape(frames.shape[:3])
    red -= np.median(red, axis=0)
    planes = tuple(_frame_plane(image, (wall, floor), fit.lens) for image in red)
    if sum(plane is not None for plane in planes) < 3:
        raise ImageError(f"{gif}: the stripe crosses both rectangles in fewer than three frames.")
    raw_dn = np.clip(np.rint(red * _CODE_DN + _SENSOR.black_dn), 0, _SENSOR.white_dn).astype(np.uint16)
    peaks = peak_times(raw_dn, _SENSOR, _PULSE)
    in_time = _cut(geometry.pixel_rays(_pixels(red.shape[1:]), *fit.lens, np.eye(4)), peaks, planes)
    in_space = _ridge_points(red, planes, fit.lens)
    timed = np.isfinite(in_time[..., 0])
    points = np.where(timed[..., None], in_time, in_space)
    return HandSweep(
        points, points[..., 2].astype(np.float32), timed, _rms(np.linalg.norm(in_time - in_space, axis=-1)), picture,
        peaks, wall.plane, floor.plane, planes, _rms(wall.plane.distance(in_time[wall.mask])),
        _rms(floor.plane.distance(in_time[floor.mask])), fit, own,
    )  # fmt: skip


def read_intrinsics(path: Path, width_px: int) -> Lens:
    """Camera matrix (3, 3) for pictures of this width, and distortion (5,), of OpenCV's XML with K and dist.

    They are for pictures as wide as its image_width says, or else CALIBRATED_WIDTH_PX, of which these are the whole.
    Raises CalibrationError where they are not there.
    """
    try:
        root = ElementTree.parse(path).getroot()
        matrix, distortion = (
            np.array([float(value) for value in root.findtext(f"{name}/data", "").split()]) for name in ("K", "dist")
        )
        matrix = matrix.reshape(3, 3)
        scale = width_px / float(root.findtext("image_width", str(CALIBRATED_WIDTH_PX)))
    except (OSError, ElementTree.ParseError, ValueError, ZeroDivisionError) as error:
        raise CalibrationError(f"{path}: no camera matrix K and distortion dist in it: {error}") from error
    if distortion.size != 5:
        raise CalibrationError(f"{path}: {distortion.size} distortion terms, not 5.")
    matrix[:2] *= scale
    matrix[:2, 2] += 0.5 * scale - 0.5  # pixel centres are at integers
    return matrix, distortion


def _pixels(shape: Sequence[int]) -> Array:
    rows, columns = np.indices(shape)
    return np.stack([columns, rows], axis=-1).astype(np.float64)


def _fits(
    contours: Sequence[Array], shape: tuple[int, ...], lens: Lens | None
) -> tuple[RectangleFit, RectangleFit | None]:
    """The fit that counts: of the given camera or else of the rectangles' own; and the latter, where there is one."""
    if lens is None:
        own = fit_rectangles(contours, RECTANGLE_M, shape)
        return own, own
    given = fit_rectangles(contours, RECTANGLE_M, shape, lens)
    try:
        return given, fit_rectangles(contours, RECTANGLE_M, shape)
    except ImageError:  # seen too straight to tell the camera
        return given, None


def _reference(plane: Plane, contour: Array, shape: tuple[int, ...]) -> _Reference:
    """A rectangle's plane and the pixels inside it."""
    mask = np.zeros(shape, np.uint8)
    cv2.fillPoly(mask, [np.rint(contour).astype(np.int32)], 1)
    return _Reference(plane, cv2.erode(mask, np.ones((5, 5), np.uint8)).astype(bool))


def _frame_plane(image: Array, references: tuple[_Reference, _Reference], lens: Lens) -> Plane | None:
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


def _ridge_points(red: Array, planes: tuple[Plane | None, ...], lens: Lens) -> Array:
    """Points (h, w, 3) where the rays through each frame's ridge meet its plane, in the ridge points' own pixels."""
    points = np.full((*red.shape[1:], 3), np.nan)
    for image, plane in zip(red, planes, strict=True):
        if plane is None:
            continue
        ridge = stripe_ridge(image, _RIDGE_SIGMA_PX, _RIDGE_THRESHOLD)
        # A point of the stripe has another one near it in the next or the last row.
        step = (np.diff(ridge.lines) <= 2) & (np.abs(np.diff(ridge.uv_px[:, 0])) < _STEP_PX)
        kept = np.append(step, False) | np.insert(step, 0, False)
        kept &= ridge.rival < 0.5 * ridge.strength
        column, row = np.rint(ridge.uv_px[kept]).astype(int).T.clip(0, np.array(red.shape[:0:-1])[:, None] - 1)
        points[row, column] = plane.cut(geometry.pixel_rays(ridge.uv_px[kept], *lens, np.eye(4)))
    return points


def _rms(distance_m: Array) -> float:
    """Robust RMS of the finite distances; NaN where there is none."""
    finite = distance_m[np.isfinite(distance_m)]
    return bulk_deviation(finite) if finite.size else float("nan")
