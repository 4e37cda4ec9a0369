"""Cameras: public chessboards with OpenCV as the peer."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import cv2
import numpy as np

from processing.cameras.board import BoardView, find_chessboard
from processing.cameras.calibration import calibrate_camera
from service.bench import Result
from tests.public_data import DATA

Value = TypeVar("Value")


def run(*, quick: bool) -> Result:
    """All figures of cameras and axis."""
    return joined([bouguet()])


def bouguet() -> Result:
    """`bouguet_rms_px`: rms distance of found and predicted corners in all 20 photographs of Bouguet's example."""
    folder, size = DATA / "calib-bouguet", (480, 640)
    if not folder.is_dir():
        return Result({}, [{"method": "Bouguet's example", "absent": f"the photographs are not in {folder}"}])
    photographs = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted(folder.glob("*.tif"))]
    views, detection_s = timed(lambda: [find_chessboard(photograph, 12, 13, 0.03) for photograph in photographs])
    ours, seconds = timed(lambda: calibrate_camera(views, size))
    (peer_px, *_), peer_s = timed(lambda: by_opencv(views, size))
    same = {"input": "Bouguet's example", "boards": sum(len(view.uv_px) > 0 for view in views)}
    return Result({"bouguet_rms_px": ours.rms_px, "bouguet_boards": float(same["boards"])}, [
        {"method": "find_chessboard", "seconds": detection_s, **same},
        {"method": "calibrate_camera", "seconds": seconds, "error": ours.rms_px, **same},
        {"method": "cv2.calibrateCamera", "seconds": peer_s, "error": peer_px, "peer": True, **same},
    ])  # fmt: skip


def by_opencv(views: Sequence[BoardView], size: tuple[int, int]) -> tuple[object, ...]:
    """OpenCV's own calibration of the same corners: rms, matrix, distortion, poses."""
    points, uv_px = ([getattr(view, name).astype(np.float32) for view in views] for name in ("points_m", "uv_px"))
    return tuple(cv2.calibrateCamera(points, uv_px, size[::-1], None, None))


def timed(work: Callable[[], Value]) -> tuple[Value, float]:
    """What the work gives, and its wall time in seconds."""
    started = time.perf_counter()
    return work(), time.perf_counter() - started


def joined(results: Sequence[Result]) -> Result:
    """Figures and rows of all."""
    figures: Mapping[str, float] = {name: value for result in results for name, value in result.figures.items()}
    return Result(figures, [row for result in results for row in result.rows])
