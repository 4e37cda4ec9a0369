"""Bracketed files of one scene to one linear image: camera RAW by the sensor's model, photographs by their response."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.formats.exr import ExrImage, write_exr
from processing.formats.photo import Photograph, read_photo
from processing.formats.raw import RawImage, map_raw
from processing.radiometry.alignment import shift_error
from processing.radiometry.defects import fill_hot_pixels
from processing.radiometry.display import tonemap
from processing.radiometry.exposure import ExposureTimes
from processing.radiometry.grey_patch import GreyPatch, measure_grey_patch
from processing.radiometry.hdr import PixelStatus, Radiance
from processing.radiometry.mosaic import demosaic, white_balance
from processing.radiometry.photograph_shift import photograph_shift
from processing.radiometry.photographs import merge_photographs
from processing.radiometry.response import Response
from processing.radiometry.response_file import write_response
from processing.radiometry.sensor_calibration import SensorCalibration
from processing.radiometry.stack import DEFAULTS, Exposures, MergedExposures, MergeOptions, merge_stack

RAW_SUFFIXES = frozenset(
    ".3fr .arw .cr2 .cr3 .dng .erf .fff .iiq .kdc .mef .mos .mrw .nef .nrw .orf .pef .raf .raw .rw2 .rwl .srw".split()
)
# sRGB primaries and white, IEC 61966-2-1.
_XYZ_FROM_SRGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


@dataclass(frozen=True, slots=True)
class PhotographExposures:
    """Exposures time x ISO / 100 / f-number squared of photographs: as `stated`, and as the pictures themselves say.

    `absolute` where ISO and aperture are known, so that radiance compares across brackets of one camera.
    """

    stated: tuple[float, ...]
    measured: tuple[float, ...]
    absolute: bool


@dataclass(frozen=True)
class MergedImage:
    """One linear image of a bracketed scene.

    `radiance` (h, w, 3): of RAW, white-balanced camera colours in electrons per second, green as measured; of
    photographs, sRGB primaries in relative units with a `response`. `srgb_from_camera` (3, 3) takes the colours to
    sRGB primaries. `exposure_s`, as the files state it, rises, `files` in the same order; of photographs, the product
    of time, ISO and aperture rises. `found` says of RAW what its frames showed: the times that were used, whether the
    picture moved, what was read; `photographs` says the exposures. `measured_sensor` is the serial number and the
    identity of the sensor calibration that was used; radiance is then that of each channel's mean pixel. `balance` is
    the grey patch that was used.
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
    photographs: PhotographExposures | None = None
    balance: GreyPatch | None = None


def merge_files(
    paths: Sequence[Path],
    options: MergeOptions = DEFAULTS,
    sensor: SensorCalibration | None = None,
    response: Response | None = None,
) -> MergedImage:
    """Merge bracketed files, given in any order, each read once, or less where parts of a RAW file tell nothing.

    RAW files whose frames contradict their exposure times, and files of either kind that show that the camera moved,
    are an error unless the `options` take them. `sensor` is the camera's own as measured, for RAW files alone;
    photographs give their camera's `response`, or use the given one.
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
    if response is not None and any(raw):
        raise ImageError(f"{paths[0]} is RAW, linear as it is: it needs no response.")
    return _merge_raw(paths, options, sensor) if all(raw) else _merge_photographs(paths, response, options)


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


def _merge_photographs(paths: Sequence[Path], response: Response | None, options: MergeOptions) -> MergedImage:
    frames = {path: read_photo(path) for path in paths}
    if len(paths) < 2 and response is None:
        raise ImageError(f"{paths[0]}: one photograph has no bracket; give two or more exposures, or a saved response.")
    _check_same("sizes", {path: frame.srgb8.shape for path, frame in frames.items()})
    _check_same("cameras", {path: frame.model for path, frame in frames.items()})
    camera = frames[paths[0]].model
    if response is not None and response.camera != camera:
        raise ImageError(f"response of {response.camera or 'an unnamed camera'}, {paths[0]} by {camera or 'another'}.")
    stated = photograph_exposures(frames)
    order = sorted(paths, key=lambda path: stated[path])
    stack = np.stack([frames[path].srgb8 for path in order])
    merged = merge_photographs(stack, [stated[path] for path in order], response, [str(path) for path in order])
    for pair in itertools.pairwise(range(len(order))):
        shift = photograph_shift(stack[list(pair)], merged.response, pair)
        if shift.refused and not options.moved:
            raise shift_error(shift, [str(path) for path in order])
    exposure_s = tuple(frames[path].exposure_s for path in order)
    absolute = all(np.isfinite(frames[paths[0]].iso) and frames[path].f_number > 0 for path in paths)
    exposures = PhotographExposures(tuple(stated[path] for path in order), tuple(merged.exposure.tolist()), absolute)
    recovered = replace(merged.response, camera=camera)
    return MergedImage(merged.radiance, exposure_s, tuple(order), camera, np.eye(3), recovered, photographs=exposures)


def photograph_exposures(frames: Mapping[Path, Photograph]) -> dict[Path, float]:
    """Time x ISO / 100 / f-number squared of each photograph; what no file states counts as 1.

    Raises ImageError where a file states no time, or some state ISO or aperture and others do not.
    """
    _check_times(frames)
    for what, values in (
        ("ISO", {path: frame.iso for path, frame in frames.items()}),
        ("aperture", {path: frame.f_number for path, frame in frames.items()}),
    ):
        silent = [path for path, value in values.items() if not value > 0]
        if silent and len(silent) < len(values):
            raise ImageError(f"{silent[0]} states no {what} and others do. Use the camera's own files, unedited.")
    return {
        path: frame.exposure_s
        * (frame.iso / 100 if frame.iso > 0 else 1.0)
        / (frame.f_number**2 if frame.f_number > 0 else 1.0)
        for path, frame in frames.items()
    }


def _check_same(what: str, values: Mapping[Path, object]) -> None:
    first_path, first = next(iter(values.items()))
    for path, value in values.items():
        if str(value) != str(first):  # as text: an unknown number (NaN) equals another
            raise ImageError(f"different {what}: {first_path} has {first}, {path} has {value}. Merge one bracket.")


def _check_times(frames: Mapping[Path, RawImage] | Mapping[Path, Photograph]) -> None:
    for path, frame in frames.items():
        if not (np.isfinite(frame.exposure_s) and frame.exposure_s > 0):
            raise ImageError(f"{path}: no exposure time in its EXIF data. Use the camera's own files, unedited.")


def _ordered(frames: Mapping[Path, RawImage]) -> list[Path]:
    """Paths by rising exposure time, where only the time differs."""
    _check_same("ISO", {path: frame.iso for path, frame in frames.items()})
    _check_same("apertures", {path: frame.f_number for path, frame in frames.items()})
    _check_times(frames)
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


def balanced(merged: MergedImage, box_px: tuple[int, int, int, int]) -> MergedImage:
    """The image with the patch `left, top, width, height` made grey; green stays. Raises ImageError for a bad patch."""
    radiance = merged.radiance
    patch = measure_grey_patch(radiance, box_px)
    value, variance = white_balance(radiance.value, radiance.variance, patch.multipliers)
    return replace(merged, radiance=Radiance(value, variance, radiance.status), balance=patch)


def write_merged(merged: MergedImage, path: Path) -> tuple[Path, Path]:
    """Write the linear image as `path` (.exr: R G B, layers variance and status) and a tone-mapped PNG beside it.

    Of photographs, also their camera's response (.json). Returns the paths of image and picture.
    Raises ImageError where the name does not end in .exr or a file cannot be written.
    """
    if path.suffix.lower() != ".exr":
        raise ImageError(f"{path}: the linear image is OpenEXR; name it ....exr.")
    radiance = merged.radiance
    layers = {"variance": radiance.variance, "status": radiance.status.astype(np.float32)}
    write_exr(path, ExrImage(radiance.value, layers, _metadata(merged)))
    picture = path.with_suffix(".png")
    _write_png(picture, display_picture(merged))
    if merged.response is not None:
        write_response(path.with_suffix(".json"), merged.response)
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
    return {
        "comments": "linear radiance; layer variance is its variance, status 0 ok 1 saturated 2 dark 3 missing",
        "radianceUnit": _unit(merged),
        "camera": merged.camera,
        "measuredSensor": merged.measured_sensor,
        "exposureTimes": " ".join(f"{time:.6g}" for time in merged.exposure_s),
        "measuredTimes": "" if merged.found is None else _measured_times(merged.found.times),
        "sources": " ".join(path.name for path in merged.files),
        "srgbFromCamera": " ".join(f"{value:.6f}" for value in np.ravel(merged.srgb_from_camera)),
        **({} if merged.photographs is None else _exposures(merged.photographs)),
        **({} if merged.balance is None else _balance(merged.balance)),
    }


def _unit(merged: MergedImage) -> str:
    if merged.photographs is None:
        assumed = " (assumed gain: the camera states no noise profile)" if merged.assumed_sensor else ""
        return f"electrons per second, green as measured{assumed}"
    at = "at f/1 and ISO 100" if merged.photographs.absolute else "at this bracket's aperture and ISO"
    return f"relative to the camera: code 128 in one second {at} is 1"


def _exposures(exposures: PhotographExposures) -> dict[str, str]:
    return {
        "exposures": " ".join(f"{one:.6g}" for one in exposures.stated),
        "measuredExposures": " ".join(f"{one:.6g}" for one in exposures.measured),
    }


def _balance(patch: GreyPatch) -> dict[str, str]:
    return {
        "greyPatch": ",".join(str(edge) for edge in patch.box_px),
        "greyMultipliers": " ".join(
            f"{one:.6g}+-{sigma:.2g}" for one, sigma in zip(patch.multipliers, patch.sigma, strict=True)
        ),
    }
