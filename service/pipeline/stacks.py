"""Bracketed exposures of a session, gathered and merged: one radiance image per pose, light and camera."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import cos, radians, sin

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.formats.raw import RawImage, map_raw
from processing.radiometry.hdr import Radiance
from processing.radiometry.stack import Exposures, MergedExposures, merge_stack
from rig.config import RigConfig
from rig.sessions import FrameRecord, Step
from service.pipeline.calibrations import Calibrations

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Stack:
    """All exposures of one camera in one pose under one light."""

    camera: str
    step: Step  # the first exposure's; pose and light are those of all
    frames: tuple[FrameRecord, ...]


@dataclass(frozen=True, slots=True)
class MergedStack:
    """The radiance mosaic of a stack in e-/s, its colour pattern, the identities of its frames, what they showed."""

    radiance: Radiance
    cfa: NDArray[np.uint8]
    unique_ids: tuple[str, ...]
    found: MergedExposures


def stacks(records: Iterable[FrameRecord]) -> list[Stack]:
    """Gather the frames that differ in exposure alone, in the order in which they were taken."""
    gathered: dict[tuple[object, ...], list[FrameRecord]] = {}
    for record in records:
        mounted = tuple(sorted((record.step.mount or {}).items()))
        gathered.setdefault((record.camera, record.step.pose, record.step.lamps, mounted), []).append(record)
    return [Stack(frames[0].camera, frames[0].step, tuple(frames)) for frames in gathered.values()]


def merge(stack: Stack, calibrations: Calibrations) -> MergedStack:
    """Merge the frames of a stack by the exposures that they really had, reading what matters to the result.

    The camera's sensor is as measured, where that was done. Raises ImageError where the frames do not belong together
    or contradict each other, CalibrationError where the sensor's maps do not fit.
    """
    images = [map_raw(record.path) for record in stack.frames]
    _check_alike(stack, images)
    merged = merge_stack(_exposures(stack, images, calibrations))
    unique_ids = tuple(image.unique_id for image in images)
    return MergedStack(merged.radiance, images[0].cfa, unique_ids, merged)


def _exposures(stack: Stack, images: list[RawImage], calibrations: Calibrations) -> Exposures:
    first = images[0]
    stated = Exposures(
        [np.asarray(image.mosaic) for image in images],
        [image.exposure_s for image in images],
        [str(record.path) for record in stack.frames],
        first.sensor,
    )
    measured = calibrations.sensor(first.serial, first.sensor, first.mosaic.shape, first.iso)
    return stated.measured_by(measured)


def light_direction(config: RigConfig, step: Step, calibrations: Calibrations) -> Array:
    """Unit vector (3,) from the sample to the one lamp of a step, in the sample frame; nominal where not measured."""
    name = only_lamp(step)
    lamp = config.lamps.lamp[name]
    turntable_rad = 0.0 if lamp.mount == "arm" else step.axes_rad["turntable"]
    azimuth_rad = step.axes_rad[lamp.mount] - turntable_rad
    measured = calibrations.lamp(name)
    if measured is not None:
        return measured.direction(azimuth_rad)
    elevation_rad = radians(lamp.elevation_deg)
    return np.array([cos(azimuth_rad) * cos(elevation_rad), sin(azimuth_rad) * cos(elevation_rad), sin(elevation_rad)])


def lamp_distance_m(config: RigConfig, step: Step, calibrations: Calibrations) -> float:
    """Distance of the one lamp of a step from the rig's origin; nominal where not measured."""
    measured = calibrations.lamp(only_lamp(step))
    return config.lamps.lamp[only_lamp(step)].distance_mm / 1000 if measured is None else measured.distance_m


def only_lamp(step: Step) -> str:
    """The one lamp that is lit. Raises ImageError where there are several, or none."""
    if len(step.lamps) != 1:
        raise ImageError(f"step {step.id}: {len(step.lamps)} lamps are lit; a material needs one light at a time.")
    return step.lamps[0]


def _check_alike(stack: Stack, images: list[RawImage]) -> None:
    for record, image in zip(stack.frames, images, strict=True):
        if (image.sensor, image.mosaic.shape, image.serial) != (
            images[0].sensor,
            images[0].mosaic.shape,
            images[0].serial,
        ):
            raise ImageError(f"{record.path}: another camera or setting than {stack.frames[0].path.name}.")
