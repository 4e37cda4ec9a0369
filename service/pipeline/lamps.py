"""Lamp models from the mirror ball and the white plate of a `lamps` session."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.cameras.calibration import CameraModel
from processing.lamps.calibration import measure_lamps
from processing.lamps.camera_doubt import reflection_points
from processing.lamps.highlight import find_highlights
from processing.lamps.mirror import SEAT_SIGMA_M, Ball, MirrorFit, Sighting, locate_lamps
from processing.lamps.model import LampModel, NominalLamp, nominal_position, write_lamps
from processing.lamps.white import PlateCells, PlateView, WhiteFit
from processing.products.provenance import write_description
from rig.config import RigConfig
from rig.sessions import LampsPlan, Session
from service.pipeline.calibrations import LAMP_MODELS, LAMPS, Calibrations
from service.pipeline.inputs import Progress, fingerprint, is_current, provenance
from service.pipeline.lamps_picture import draw_lamps
from service.pipeline.stacks import MergedStack, Stack, merge, only_lamp, stacks

Array = NDArray[np.float64]
PICTURE = "lamps.png"
_SEARCH_SIGMAS = 3.0  # of the ball's seat, about where the highlight of a nominal lamp would be
_FRAME_EDGE_M = 0.004  # of the white upper frame that is left out around it


def make_lamps(session: Session, calibrations: Calibrations, progress: Progress) -> Path:
    """Models of the plan's lamps, with a picture.

    Raises CalibrationError where a camera is not calibrated, or no lamp is seen in the ball or on the plate.
    """
    assert isinstance(session.plan, LampsPlan)
    folder = session.products / LAMPS
    inputs = fingerprint(session.frames(), {"calibrations": calibrations.digest()})
    if is_current(folder, inputs):
        return folder
    looked = _look(session, calibrations, progress)
    nominal = nominal_lamps(session.config, session.plan.lamps)
    mirror = None if looked.ball is None else locate_lamps(looked.sightings, looked.cameras, nominal, looked.ball)
    reflectance = session.plan.white.reflectance if session.plan.white else 1.0
    models, white = measure_lamps(nominal, looked.sightings, mirror, looked.views, reflectance)
    folder.mkdir(parents=True, exist_ok=True)
    write_lamps(models, folder / LAMP_MODELS)
    draw_lamps(folder / PICTURE, models, nominal, looked.sightings, mirror)
    write_description(folder, LAMPS, _content(models, mirror, white), provenance(session, inputs))
    return folder


def nominal_lamps(config: RigConfig, names: Sequence[str]) -> dict[str, NominalLamp]:
    """What rig.toml says of these lamps."""
    found = {}
    for name in names:
        lamp = config.lamps.lamp[name]
        found[name] = NominalLamp(lamp.mount, nominal_position(radians(lamp.elevation_deg), lamp.distance_mm / 1e3))
    return found


@dataclass(frozen=True)
class _Looked:
    """What the frames of a session show, once each was read."""

    cameras: dict[str, CameraModel]
    ball: Ball | None
    sightings: list[Sighting]
    views: list[PlateView]


def _look(session: Session, calibrations: Calibrations, progress: Progress) -> _Looked:
    plan, config = session.plan, session.config
    assert isinstance(plan, LampsPlan)
    ball = None
    if plan.mirror is not None:
        radius_m = plan.mirror.radius_mm / 1e3
        ball = Ball(np.array([0.0, 0.0, radius_m]), radius_m)
    looked = _Looked({}, ball, [], [])
    nominal, cells = nominal_lamps(config, plan.lamps), dict[str, PlateCells]()
    side_m = config.holder.inner_mm / 1e3 - _FRAME_EDGE_M
    for stack in progress.track(stacks(session.frames()), "looking at lamps"):
        camera = looked.cameras.setdefault(stack.camera, calibrations.camera(stack.camera))
        merged, lamp = merge(stack, calibrations), only_lamp(stack.step)
        if ball is not None and plan.mirror is not None and (stack.step.mount or {})["sample"] == plan.mirror.sample:
            looked.sightings.append(_sighting(stack, merged, camera, (nominal[lamp], ball)))
            continue
        if stack.camera not in cells:
            cells[stack.camera] = PlateCells.of(camera, merged.cfa, side_m)
        angle_rad = stack.step.axes_rad[nominal[lamp].mount]
        looked.views.append(cells[stack.camera].view(merged.radiance, lamp, stack.camera, angle_rad))
    return looked


def _sighting(stack: Stack, merged: MergedStack, camera: CameraModel, expected: tuple[NominalLamp, Ball]) -> Sighting:
    """The spots about where the ball on its seat would show the nominal lamp."""
    lamp, ball = expected
    angle_rad = stack.step.axes_rad[lamp.mount]
    source = geometry.rotate(geometry.rotation_z(angle_rad), lamp.position_m)
    at = reflection_points(ball.seat_m, ball.radius_m, source[None], camera.centre_m[None])
    about = camera.project(np.concatenate([at, at + SEAT_SIGMA_M * np.eye(3)]))
    reach_px = _SEARCH_SIGMAS * float(np.linalg.norm(about[1:] - about[0], axis=1).max())
    spots = find_highlights(merged.radiance, merged.cfa, about[0], reach_px)
    return Sighting(only_lamp(stack.step), stack.camera, angle_rad, spots)


def _content(models: dict[str, LampModel], mirror: MirrorFit | None, white: WhiteFit | None) -> dict[str, object]:
    content: dict[str, object] = {
        "file": LAMP_MODELS,
        "picture": PICTURE,
        "status": {name: model.status.name for name, model in models.items()},
        "direction_deviation_deg": {
            name: float(np.degrees(model.direction_deviation_rad)) for name, model in models.items()
        },
    }
    if mirror is not None:
        used = mirror.weight > 0
        content["highlight_rms_px"] = float(np.sqrt(np.mean(mirror.residual_px[used] ** 2)))
        content["highlights"] = {"used": int(used.sum()), "of": len(used), "excess": mirror.excess}
        content["ball_centre_m"] = mirror.centre_m.tolist()
    if white is not None:
        content["falloff"] = {"exponent": white.falloff, "deviation": white.falloff_deviation}
        content["white_rms"] = white.residual
    return content
