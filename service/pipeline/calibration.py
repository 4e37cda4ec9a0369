"""Camera models from a `calibrate` session."""

from math import degrees
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.cameras.board import Board
from processing.cameras.calibration import Survey, survey_images, write_cameras
from processing.cameras.network import Shot
from processing.cameras.turntable import Axis
from processing.formats.raw import read_raw
from processing.products.provenance import write_description
from processing.radiometry.mosaic import grey_mosaic
from rig.sessions import FrameRecord, Session
from service.pipeline.calibrations import CALIBRATION, CAMERAS, Calibrations
from service.pipeline.inputs import Progress, fingerprint, is_current, provenance
from service.survey_pictures import draw_network, draw_residuals

RESIDUALS, NETWORK = "residuals.png", "network.png"


def make_calibration(session: Session, calibrations: Calibrations, progress: Progress) -> Path:
    """Camera models and the turntable's axis from the ChArUco frames of a `calibrate` session, and pictures of both.

    A camera that read too few boards is left out and told. The rig frame is that of the axis; azimuth 0 is where the
    cameras of the arc stand, in the mean.
    """
    folder = session.products / CALIBRATION
    records = session.frames()
    if is_current(folder, inputs := fingerprint(records, {"calibrations": calibrations.digest()})):
        return folder
    images: dict[str, dict[Shot, NDArray[np.float32]]] = {}
    for record in progress.track(records, "reading boards"):
        shot = Shot(int((record.step.mount or {})["pose"]), record.step.axes_rad.get("turntable", 0.0))
        images.setdefault(record.camera, {})[shot] = _grey(record, calibrations)
    board = session.config.board
    printed = Board(board.columns, board.rows, board.square_mm / 1e3, board.marker_mm / 1e3, board.dictionary)
    survey = survey_images(images, printed)
    for name, lack in survey.left_out.items():
        progress.note(f"{name} is not calibrated: {lack}")
    arc = [name for name in survey.cameras if session.config.cameras[name].mount == "camera_arc"]
    survey = survey.facing(arc)
    folder.mkdir(parents=True, exist_ok=True)
    write_cameras(survey.cameras, folder / CAMERAS)
    draw_residuals(survey, folder / RESIDUALS)
    draw_network(survey, printed, folder / NETWORK)
    write_description(folder, "calibration", {"file": CAMERAS, **_figures(survey)}, provenance(session, inputs))
    return folder


def _figures(survey: Survey) -> dict[str, Any]:
    """What a person asks of a calibration: residuals and corners per camera, and how the axis stands to the board."""
    return {
        "rms_px": {name: camera.rms_px for name, camera in survey.cameras.items()},
        "corners": {name: len(residuals.uv_px) for name, residuals in survey.residuals.items()},
        "corners_left_out": {name: int((~r.accepted).sum()) for name, r in survey.residuals.items()},
        "left_out": dict(survey.left_out),
        "axis": None if survey.axis is None else _axis_figures(survey.axis),
    }


def _axis_figures(axis: Axis) -> dict[str, Any]:
    return {
        "direction_in_board": axis.direction.tolist(),
        "tilt_deg": degrees(axis.tilt_rad),
        "tilt_deviation_deg": np.degrees(axis.tilt_deviation_rad).tolist(),
        "point_in_board_mm": (1e3 * axis.point_m).tolist(),
        "place_deviation_mm": (1e3 * axis.place_deviation_m).tolist(),
    }


def _grey(record: FrameRecord, calibrations: Calibrations) -> NDArray[np.float32]:
    """The frame without its colours; of a measured sensor without its pixels' own response, hot ones as they are."""
    raw = read_raw(record.path)
    measured = calibrations.sensor(raw.serial, raw.sensor, raw.mosaic.shape, raw.iso)
    signal: NDArray[np.floating] = raw.mosaic.astype(np.float64) - raw.sensor.black_dn
    if measured is not None:
        pixels = measured.correction
        signal = (measured.linear_dn(raw.mosaic) - measured.sensor.black_dn - pixels.offset_dn) / pixels.flat
    return np.asarray(grey_mosaic(signal, raw.cfa), np.float32)
