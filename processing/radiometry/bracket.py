"""Bracketed files of one scene to one linear image: camera RAW by the sensor's model, photographs by their response."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.formats.exr import ExrImage, write_exr
from processing.formats.photo import Photograph, read_photo
from processing.formats.raw import RawImage, map_raw
from processing.radiometry.defects import fill_hot_pixels
from processing.radiometry.display import tonemap
from processing.radiometry.exposure import ExposureTimes
from processing.radiometry.hdr import PixelStatus, Radiance
from processing.radiometry.mosaic import demosaic, white_balance
from processing.radiometry.photographs import merge_photographs
from processing.radiometry.response import Response
from processing.radiometry.sensor_calibration import SensorCalibration
from processing.radiometry.stack import DEFAULTS, Exposures, MergedExposures, MergeOptions, merge_stack

RAW_SUFFIXES = frozenset(
    ".3fr .arw .cr2 .cr3 .dng .erf .fff .iiq .kdc .mef .mos .mrw .nef .nrw .orf .pef .raf .raw .rw2 .rwl .srw".split()
)
# sRGB primaries and white, IEC 61966-2-1.
_XYZ_FROM_SRGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


@dataclass(frozen=True)
class MergedImage:
    """One linear image of a bracketed scene.

    `radiance` (h, w, 3): of RAW, white-balanced camera colours in electrons per second, green as measured; of
    photographs, sRGB primaries in relative units with a `response`. `srgb_from_camera` (3, 3) takes the colours to
    sRGB primaries. `exposure_s`, as the files state it, rises, `files` in the same order. `found` says of RAW what
    its frames showed: the times that were used, whether the picture moved, what was read. `measured_sensor` is the
    serial number and the identity of the sensor calibration that was used; radiance is then that of each channel's
    mean pixel.
    """

    radiance: Radiance
    exposure_s: tuple[float, ...]
    files: tuple[Path, ...]
    camera: str
    srgb_from_camera: NDArray[np.float64]
    response: Response | None = None
    assumed_sensor: bool = False
    found: MergedExposures | None = None
    measured_sensor: str = ""


def merge_files(
    paths: Sequence[Path], options: MergeOptions = DEFAULTS, sensor: SensorCalibration | None = None
) -> MergedImage:
    """Merge bracketed files, given in any order, each read once, or less where parts of a RAW file tell nothing.

    RAW files whose frames contradict their exposure times, or show that the camera moved, are an error unless the
    `options` take them. `sensor` is the camera's own as measured, for RAW files alone.
    Raises CalibrationError where that is another camera's, ISO's or size's; ImageError that names the files: none
    given, one named twice, RAW and pictures mixed, different sizes, cameras, ISO or apertures, missing or equal
    exposure times, or a file that cannot be read.
    """
    if not paths:
        raise ImageError("no files to merge; name two or more bracketed exposures.")
    if len(set(paths)) < len(paths):
        raise ImageError("a file is named twice; each exposure counts once.")
    raw = [path.suffix.lower() in RAW_SUFFIXES for path in paths]
    if any(raw) and not all(raw):
        raise ImageError(f"{paths[raw.index(True)]} is RAW and {paths[raw.index(False)]} is not; merge one kind.")
    if sensor is not None and not all(raw):
        raise ImageError(f"{paths[0]} is no RAW file; a measured sensor is of use with the sensor's own counts only.")
    return _merge_raw(paths, options, sensor) if all(raw) else _merge_photographs(paths)


def _merge_raw(paths: Sequence[Path], options: MergeOptions, sensor: SensorCalibration | None) -> MergedImage:
    frames = {path: map_raw(path) for path in paths}
    _check_same("sizes", {path: frame.mosaic.shape for path, frame in frames.items()})
    _check_same("cameras", {path: f"{frame.model} {frame.serial}".strip() for path, frame in frames.items()})
    order = _ordered(frames)
    _check_same("sensor levels", {path: frame.sensor for path, frame in frames.items()})
    first, exposure_s = frames[order[0]], [frames[path].exposure_s for path in order]
    mosaics = [np.asarray(frames[path].mosaic) for path in order]
    if sensor is not None:
        sensor.check_takes(first.serial, first.iso)
        sensor.check_fits(first.mosaic.shape, first.sensor)
    exposures = Exposures(mosaics, exposure_s, [str(path) for path in order], first.sensor)
    found = merge_stack(exposures.measured_by(sensor), options)
    mosaic = fill_hot_pixels(found.radiance)
    image, variance = white_balance(*demosaic(mosaic.value, mosaic.variance, first.cfa), first.white_balance)
    return MergedImage(
        radiance=Radiance(image, variance, _colour_status(image, variance, mosaic.status)),
        exposure_s=tuple(exposure_s),
        files=tuple(order),
        camera=first.model,
        srgb_from_camera=_srgb_from_camera(first.camera_from_xyz),
        assumed_sensor=first.sensor.assumed and sensor is None,
        found=found,
        measured_sensor="" if sensor is None else f"{sensor.serial} {sensor.digest()}",
    )


def _merge_photographs(paths: Sequence[Path]) -> MergedImage:
    frames = {path: read_photo(path) for path in paths}
    if len(paths) < 2:
        raise ImageError(f"{paths[0]}: one photograph has no bracket; two or more exposure times are needed.")
    _check_same("sizes", {path: frame.srgb8.shape for path, frame in frames.items()})
    _check_same("cameras", {path: frame.model for path, frame in frames.items()})
    order = _ordered(frames)
    exposure_s = [frames[path].exposure_s for path in order]
    radiance, response = merge_photographs(np.stack([frames[path].srgb8 for path in order]), exposure_s)
    return MergedImage(radiance, tuple(exposure_s), tuple(order), frames[order[0]].model, np.eye(3), response)


def _check_same(what: str, values: Mapping[Path, object]) -> None:
    first_path, first = next(iter(values.items()))
    for path, value in values.items():
        if str(value) != str(first):  # as text: an unknown number (NaN) equals another
            raise ImageError(f"different {what}: {first_path} has {first}, {path} has {value}. Merge one bracket.")


def _ordered(frames: Mapping[Path, RawImage] | Mapping[Path, Photograph]) -> list[Path]:
    """Paths by rising exposure time, where only the time differs."""
    _check_same("ISO", {path: frame.iso for path, frame in frames.items()})
    _check_same("apertures", {path: frame.f_number for path, frame in frames.items()})
    for path, frame in frames.items():
        if not (np.isfinite(frame.exposure_s) and frame.exposure_s > 0):
            raise ImageError(f"{path}: no exposure time in its EXIF data. Use the camera's own files, unedited.")
    order = sorted(frames, key=lambda path: frames[path].exposure_s)
    for one, other in itertools.pairwise(order):
        if frames[one].exposure_s == frames[other].exposure_s:
            raise ImageError(f"{one} and {other} have the same exposure time, {frames[one].exposure_s:g} s.")
    return order


def _colour_status(
    image: NDArray[np.float32], variance: NDArray[np.float32], mosaic: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    """Status (h, w, 3) after demosaicing: a gap is saturated where a saturated sample lies within its reach."""
    saturated = cv2.dilate((mosaic == PixelStatus.SATURATED).astype(np.uint8), np.ones((3, 3), np.uint8))
    gap = np.where(saturated[..., None] > 0, PixelStatus.SATURATED, PixelStatus.MISSING)
    with np.errstate(invalid="ignore"):
        known = np.where(image < 3 * np.sqrt(variance), PixelStatus.DARK, PixelStatus.OK)
    return np.where(np.isnan(image), gap, known).astype(np.uint8)


def _srgb_from_camera(camera_from_xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrix that keeps white: camera white-balanced grey is sRGB grey. Identity where the camera is unknown."""
    camera_from_srgb = camera_from_xyz @ _XYZ_FROM_SRGB
    sums = camera_from_srgb.sum(axis=1, keepdims=True)
    if not (sums > 0).all() or abs(np.linalg.det(camera_from_srgb)) < 1e-6:
        return np.eye(3)
    return np.asarray(np.linalg.inv(camera_from_srgb / sums), np.float64)


def write_merged(merged: MergedImage, path: Path) -> tuple[Path, Path]:
    """Write the linear image as `path` (.exr: R G B, layers variance and status) and a tone-mapped PNG beside it.

    Returns both paths. Raises ImageError where the name does not end in .exr or a file cannot be written.
    """
    if path.suffix.lower() != ".exr":
        raise ImageError(f"{path}: the linear image is OpenEXR; name it ....exr.")
    radiance = merged.radiance
    layers = {"variance": radiance.variance, "status": radiance.status.astype(np.float32)}
    write_exr(path, ExrImage(radiance.value, layers, _metadata(merged)))
    picture = path.with_suffix(".png")
    _write_png(picture, display_picture(merged))
    return path, picture


def display_picture(merged: MergedImage) -> NDArray[np.uint8]:
    """Tone-mapped sRGB picture (h, w, 3); what was saturated in every exposure is white."""
    saturated = (merged.radiance.status == PixelStatus.SATURATED).any(axis=-1)
    image = np.where(saturated[..., None], np.inf, merged.radiance.value @ merged.srgb_from_camera.T)
    return tonemap(image)


def _write_png(path: Path, srgb8: NDArray[np.uint8]) -> None:
    _, encoded = cv2.imencode(".png", np.ascontiguousarray(srgb8[..., ::-1]))
    try:
        path.write_bytes(encoded.tobytes())
    except OSError as error:
        raise ImageError(f"{path}: cannot be written: {error.strerror}.") from error


def _measured_times(times: ExposureTimes) -> str:
    """Each frame's exposure time as its overlap with the others says, with its deviation; a dash where it does not."""
    return " ".join(
        f"{time:.6g}+-{time * sigma:.2g}" if np.isfinite(sigma) else "-"
        for time, sigma in zip(times.measured_s, times.sigma, strict=True)
    )


def _metadata(merged: MergedImage) -> dict[str, str]:
    """What each number of the file means, in the file."""
    relative = merged.response is not None
    unit = "relative: code 128 in one second is 1" if relative else "electrons per second, green as measured"
    return {
        "comments": "linear radiance; layer variance is its variance, status 0 ok 1 saturated 2 dark 3 missing",
        "radianceUnit": unit + (" (assumed gain: the camera states no noise profile)" if merged.assumed_sensor else ""),
        "camera": merged.camera,
        "measuredSensor": merged.measured_sensor,
        "exposureTimes": " ".join(f"{time:.6g}" for time in merged.exposure_s),
        "measuredTimes": "" if merged.found is None else _measured_times(merged.found.times),
        "sources": " ".join(path.name for path in merged.files),
        "srgbFromCamera": " ".join(f"{value:.6f}" for value in np.ravel(merged.srgb_from_camera)),
        "response": "" if merged.response is None else " ".join(f"{g:.4f}" for g in merged.response.log_exposure),
    }
