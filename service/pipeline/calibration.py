"""Camera models from a `calibrate` session."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.cameras.board import Board
from processing.cameras.calibration import survey_images, write_cameras
from processing.cameras.network import Shot
from processing.formats.raw import read_raw
from processing.products.provenance import write_description
from processing.radiometry.mosaic import grey_mosaic
from rig.sessions import FrameRecord, Session
from service.pipeline.calibrations import CALIBRATION, CAMERAS, Calibrations
from service.pipeline.inputs import Progress, fingerprint, is_current, provenance


def make_calibration(session: Session, calibrations: Calibrations, progress: Progress) -> Path:
    """Camera models from the ChArUco frames of a `calibrate` session."""
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
    arc = [name for name in survey.cameras if session.config.cameras[name].mount == "camera_arc"]
    survey = survey.facing(arc)
    cameras = survey.cameras
    folder.mkdir(parents=True, exist_ok=True)
    write_cameras(cameras, folder / CAMERAS)
    content = {"file": CAMERAS, "rms_px": {name: camera.rms_px for name, camera in cameras.items()}}
    write_description(folder, "calibration", content, provenance(session, inputs))
    return folder


def _grey(record: FrameRecord, calibrations: Calibrations) -> NDArray[np.float32]:
    """The frame without its colours; of a measured sensor without its pixels' own response, hot ones as they are."""
    raw = read_raw(record.path)
    measured = calibrations.sensor(raw.serial, raw.sensor, raw.mosaic.shape, raw.iso)
    signal: NDArray[np.floating] = raw.mosaic.astype(np.float64) - raw.sensor.black_dn
    if measured is not None:
        pixels = measured.correction
        signal = (measured.linear_dn(raw.mosaic) - measured.sensor.black_dn - pixels.offset_dn) / pixels.flat
    return np.asarray(grey_mosaic(signal, raw.cfa), np.float32)
