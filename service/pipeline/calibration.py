"""Camera models from a `calibrate` session."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.cameras.board import Board
from processing.cameras.calibration import calibrate_cameras, write_cameras
from processing.formats.raw import read_raw
from processing.products.provenance import write_description
from processing.radiometry.mosaic import grey_mosaic
from rig.sessions import FrameRecord, Session
from service.pipeline.calibrations import CALIBRATION, CAMERAS
from service.pipeline.inputs import Progress, fingerprint, is_current, provenance


def make_calibration(session: Session, progress: Progress) -> Path:
    """Camera models from the ChArUco frames of a `calibrate` session."""
    folder = session.products / CALIBRATION
    records = session.frames()
    if is_current(folder, inputs := fingerprint(records, {})):
        return folder
    images: dict[str, dict[int, NDArray[np.float32]]] = {}
    for record in progress.track(records, "reading boards"):
        pose = int((record.step.mount or {})["pose"])
        images.setdefault(record.camera, {})[pose] = _grey(record)
    board = session.config.board
    cameras = calibrate_cameras(
        images, Board(board.columns, board.rows, board.square_mm / 1e3, board.marker_mm / 1e3, board.dictionary)
    )
    folder.mkdir(parents=True, exist_ok=True)
    write_cameras(cameras, folder / CAMERAS)
    content = {"file": CAMERAS, "rms_px": {name: camera.rms_px for name, camera in cameras.items()}}
    write_description(folder, "calibration", content, provenance(session, inputs))
    return folder


def _grey(record: FrameRecord) -> NDArray[np.float32]:
    raw = read_raw(record.path)
    return np.asarray(grey_mosaic(raw.mosaic.astype(np.float64) - raw.sensor.black_dn, raw.cfa), np.float32)
