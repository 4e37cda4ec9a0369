"""The mesostructure distance function from the laser sweeps of an `mdf` session."""

from math import degrees, radians
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from processing import geometry
from processing.laser.holder import Holder
from processing.laser.laser_plane import LaserMount
from processing.laser.mdf import Sweep, mdf_from_sweeps
from processing.products import Mdf
from processing.radiometry.sensor import Sensor
from rig.config import RigConfig
from rig.sessions import FrameRecord, MdfPlan, Session
from service.pipeline.calibrations import Calibrations
from service.pipeline.inputs import Progress, fingerprint, is_current, provenance


def make_mdf(session: Session, calibrations: Calibrations, progress: Progress) -> Path:
    """The mesostructure distance function of every view that the laser sweeps saw."""
    assert isinstance(session.plan, MdfPlan)
    folder = session.products / "mdf"
    records = session.frames()
    inputs = fingerprint(records, {"texels": session.plan.texels, "calibrations": calibrations.digest()})
    if is_current(folder, inputs):
        return folder
    holder = _holder(session.config)
    sweeps = (_sweep(record, session.config, calibrations) for record in progress.track(records, "laser sweeps"))
    mdf, _ = mdf_from_sweeps(sweeps, holder, session.plan.texels)
    Mdf(mdf.displacement_m, mdf.variance_m2, mdf.view_directions, mdf.side_m, provenance(session, inputs)).save(folder)
    return folder


def _sweep(record: FrameRecord, config: RigConfig, calibrations: Calibrations) -> Sweep:
    stored = zarr.open_array(store=record.path, mode="r")
    about: dict[str, Any] = dict(stored.attrs)
    slope, offset = np.reshape(np.asarray(about["noise_profile"], np.float64), (-1, 2)).mean(axis=0)
    turntable_rad, arc_rad = record.step.axes_rad["turntable"], record.step.axes_rad["light_arc"]
    assert config.laser is not None
    elevation_deg = float((record.step.mount or {})["laser_elevation_deg"])
    stated = Sensor.from_noise_profile(float(about["black_dn"]), float(about["white_dn"]), slope, offset)
    measured = calibrations.sensor(str(about["serial"]), stated, stored.shape[1:])
    return Sweep(
        view=f"{record.camera} at {degrees(turntable_rad):+.2f} deg",
        frames=np.asarray(stored[:]),
        sensor=stated if measured is None else measured.counted_sensor,
        camera=calibrations.camera(record.camera),
        rig_from_sample=geometry.rotation_z(turntable_rad),
        mount=LaserMount(arc_rad, radians(elevation_deg), config.laser.distance_mm / 1e3),
    )


def _holder(config: RigConfig) -> Holder:
    h = config.holder
    lengths_mm = (h.sample_mm, h.inner_mm, h.outer_mm, h.step_mm, h.sample_depth_mm, h.margin_mm)
    return Holder(*(length / 1e3 for length in lengths_mm))
