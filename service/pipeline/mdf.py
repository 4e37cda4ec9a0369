"""The mesostructure distance function from the laser sweeps of an `mdf` session."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import degrees, isfinite, radians
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from processing import geometry
from processing.errors import ImageError
from processing.laser.holder import Holder
from processing.laser.laser_plane import LaserMount, SweepStatus
from processing.laser.mdf import Sweep, ViewResult, mdf_from_sweeps
from processing.radiometry.sensor import Sensor
from processing.radiometry.sensor_calibration import SensorCalibration
from rig.config import RigConfig
from rig.sessions import FrameRecord, MdfPlan, Session
from service.mdf_pictures import draw_view
from service.pipeline.calibrations import Calibrations
from service.pipeline.inputs import Progress, fingerprint, is_current, provenance

CONTRADICTS = 2.0  # sigmas by which the bulk of a sweep deviates from the others: its plane or its variance is wrong
_TROUBLES = {
    SweepStatus.NO_STRIPE: "no laser stripe moves over the white frame: the sweep is left out",
    SweepStatus.ONE_HEIGHT: "the stripe is seen at one height of the white frame only: the laser is taken to be where "
    "it should be mounted",
}


def make_mdf(session: Session, calibrations: Calibrations, progress: Progress) -> Path:
    """The mesostructure distance function of every view that the laser sweeps saw, and a picture of each.

    Raises ImageError where a stored sweep cannot be read.
    """
    assert isinstance(session.plan, MdfPlan)
    folder = session.products / "mdf"
    # Views by camera and turntable; a view's locations one after the other, in the order of the steps.
    records = sorted(session.frames(), key=lambda record: (record.camera, record.step.axes_rad["turntable"]))
    plane_m = session.plan.depth_mm / 1e3
    measured_on = {"texels": session.plan.texels} | ({"depth_m": plane_m} if plane_m else {})
    inputs = fingerprint(records, {**measured_on, "calibrations": calibrations.digest()})
    if is_current(folder, inputs):
        return folder
    sweeps = (_sweep(record, session.config, calibrations) for record in progress.track(records, "laser sweeps"))
    mdf, views = mdf_from_sweeps(sweeps, _holder(session.config), session.plan.texels, plane_m=plane_m)
    told = [_told(view, [r for r in records if _view(r) == view.view]) for view in views]
    for text in (text for one in told for text in _troubles(one)):
        progress.note(text)
    folder.mkdir(parents=True, exist_ok=True)
    for number, (view, one) in enumerate(zip(views, told, strict=True)):
        draw_view(folder / one["picture"], mdf, number, view.merged, one)
    replace(mdf, provenance=provenance(session, inputs)).save(folder, {"views": told})
    return folder


def _view(record: FrameRecord) -> str:
    return f"{record.camera} at {degrees(record.step.axes_rad['turntable']):+.2f} deg"


def _sweep(record: FrameRecord, config: RigConfig, calibrations: Calibrations) -> Sweep:
    stored, about = _opened(record.path)
    assert config.laser is not None
    elevation_deg = float((record.step.mount or {})["laser_elevation_deg"])
    stated = _stated(about)
    measured = calibrations.sensor(str(about["serial"]), stated, stored.shape[1:])
    return Sweep(
        view=_view(record),
        frames=_frames(stored, record.path, measured),
        sensor=stated if measured is None else measured.measurement.sensor,
        camera=calibrations.camera(record.camera),
        rig_from_sample=geometry.rotation_z(record.step.axes_rad["turntable"]),
        mount=LaserMount(record.step.axes_rad["light_arc"], radians(elevation_deg), config.laser.distance_mm / 1e3),
        times=_times(about),
        unusable=None if measured is None else measured.correction.hot,
    )


def _opened(path: Path) -> tuple[zarr.Array[Any], dict[str, Any]]:
    try:
        stored = zarr.open_array(store=path, mode="r")
        return stored, dict(stored.attrs)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise _unreadable(path, error) from error


def _frames(stored: zarr.Array[Any], path: Path, measured: SensorCalibration | None) -> Iterator[NDArray[np.uint16]]:
    """The frames (h, w), read as they are asked for; of a measured sensor in counts that grow evenly with the light."""
    depth = max(stored.chunks[0], 1)
    for start in range(0, stored.shape[0], depth):
        try:
            frames = np.asarray(stored[start : start + depth])
        except (OSError, ValueError, KeyError, RuntimeError) as error:
            raise _unreadable(path, error) from error
        if measured is not None:
            frames = np.rint(measured.linear_dn(frames)).astype(np.uint16)
        yield from frames


def _unreadable(path: Path, error: Exception) -> ImageError:
    return ImageError(
        f"{path}: this laser sweep cannot be read ({error}). `rig verify` names all frames that are damaged."
    )


def _stated(about: dict[str, Any]) -> Sensor:
    """The noise model that the camera's files state."""
    slope, offset = np.reshape(np.asarray(about["noise_profile"], np.float64), (-1, 2)).mean(axis=0)
    return Sensor.from_noise_profile(float(about["black_dn"]), float(about["white_dn"]), slope, offset)


def _times(about: dict[str, Any]) -> NDArray[np.float64] | None:
    """When each frame was taken, in frame intervals; None for sweeps that were stored without."""
    if "times_s" not in about:
        return None
    times_s = np.asarray(about["times_s"], np.float64)
    interval_s = float(np.median(np.diff(times_s))) if times_s.size > 1 else 1.0
    return np.asarray((times_s - times_s[0]) / interval_s)


def _holder(config: RigConfig) -> Holder:
    h = config.holder
    lengths_mm = (h.sample_mm, h.inner_mm, h.outer_mm, h.step_mm, h.sample_depth_mm, h.margin_mm)
    return Holder(*(length / 1e3 for length in lengths_mm))


def _told(view: ViewResult, records: Sequence[FrameRecord]) -> dict[str, Any]:
    """What a person asks of a view: which sweeps it rests on, and how well these agree."""
    sweeps = [
        {
            "step": record.step.id,
            "laser_azimuth_deg": round(degrees(record.step.axes_rad["light_arc"]), 3),
            "laser_elevation_deg": float((record.step.mount or {})["laser_elevation_deg"]),
            "status": laser.status.name,
            "completeness": completeness,
            "consistency": float(consistency) if isfinite(consistency) else None,
        }
        for record, laser, completeness, consistency in zip(
            records, view.lasers, view.completeness, view.merged.consistency, strict=True
        )
    ]
    turned_deg = degrees(records[0].step.axes_rad["turntable"])
    return {"view": view.view, "picture": f"{records[0].camera}{turned_deg:+.2f}.png", "sweeps": sweeps}


def _troubles(told: dict[str, Any]) -> Iterator[str]:
    """One sentence for each sweep of a view that its result does not rest on, or should not."""
    for sweep in told["sweeps"]:
        which = f"{told['view']}, laser {sweep['laser_azimuth_deg']:+g} deg round, {sweep['laser_elevation_deg']:g} up"
        trouble = _TROUBLES.get(SweepStatus[sweep["status"]])
        if trouble is not None:
            yield f"{which}: {trouble}."
        elif (sweep["consistency"] or 0.0) > CONTRADICTS:
            yield f"{which}: deviates from the other sweeps by {sweep['consistency']:.1f} of its own sigmas."
