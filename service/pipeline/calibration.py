"""Camera models from a `calibrate` session, and their way to the sessions that need them."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.cameras.board import Board
from processing.cameras.calibration import CameraModel, calibrate_cameras, read_cameras, write_cameras
from processing.errors import CalibrationError
from processing.formats.raw import read_raw
from processing.products.provenance import write_description
from processing.radiometry.mosaic import grey_mosaic
from rig.sessions import FrameRecord, Session
from service.pipeline.inputs import Progress, fingerprint, is_current, provenance

CAMERAS = "cameras.json"


def load_calibration(session_folder: Path | None) -> dict[str, CameraModel]:
    """Camera models of a processed `calibrate` session. Raises CalibrationError that says how to get one."""
    if session_folder is None:
        raise CalibrationError("this session needs calibrated cameras: name a calibrate session with --calibration.")
    path = session_folder / "products" / "calibration" / CAMERAS
    if not path.is_file():
        raise CalibrationError(f"{session_folder}: not calibrated yet; run `rig process {session_folder}` first.")
    return read_cameras(path)


def make_calibration(session: Session, progress: Progress) -> Path:
    """Camera models from the ChArUco frames of a `calibrate` session."""
    folder = session.products / "calibration"
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


def camera_of(cameras: Mapping[str, CameraModel], name: str) -> CameraModel:
    """The model of one camera. Raises CalibrationError where it was not calibrated."""
    if name not in cameras:
        raise CalibrationError(f"{name} is not calibrated; the calibration has: {', '.join(cameras)}.")
    return cameras[name]


def digest(cameras: Mapping[str, CameraModel]) -> str:
    """Identity of a calibration: the digest of all of its numbers."""
    text = json.dumps({name: camera.to_json() for name, camera in cameras.items()}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _grey(record: FrameRecord) -> NDArray[np.float32]:
    raw = read_raw(record.path)
    return np.asarray(grey_mosaic(raw.mosaic.astype(np.float64) - raw.sensor.black_dn, raw.cfa), np.float32)
