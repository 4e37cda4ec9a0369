"""Cameras and axis: synthetic corners over their bound, frames of the simulated rig, and public chessboards.

`reprojection_over_bound`: rms error of the image points that calibrated cameras predict for points on the sample, over
its Cramer-Rao bound sigma sqrt(diag J (J'J)^-1 J'); corners of 0.1 px noise on eight cameras, eight poses, six turns.
`reprojection_over_belief`: the same over the bound that counts what the estimator believes of lenses beforehand.
`deviation_normalised_rms`: errors of all camera parameters over the deviations claimed for them; 1 where these hold.
`pose_error_um`: from rendered frames through detection and adjustment; rms distance on the sample, over cameras and
9 x 9 points of the 60 mm square, between a point and where the calibrated camera sees it: lens, camera and axis.
`axis_error_deg`: from the same frames, between the turntable's true and found axis as seen from the board.
"""

import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np

from processing import geometry
from processing.cameras.board import Board, BoardView, find_charuco, find_chessboard
from processing.cameras.calibration import CameraModel, calibrate_camera, survey
from processing.cameras.network import Shot
from processing.formats.raw import read_raw
from processing.radiometry.mosaic import grey_mosaic
from service.bench import Result
from simulators.optics import Optics
from simulators.pose import Pose
from tests.public_data import DATA
from tests.reference.camera_rig import SAMPLE, TURNS_DEG, CameraRig, bounds_px, camera_rig, normalised_errors

NOISE_PX = 0.1
SEEDS = 11, 12, 13  # of simulated rigs; the detection of corners was made with others
Value = TypeVar("Value")


def run(*, quick: bool) -> Result:
    """All figures of cameras and axis; quick with fewer seeds, and with three cameras of the arc for the frames."""
    names = [f"cam{i}" for i in ((1, 4, 7) if quick else range(8))]
    return joined([synthetic(3 if quick else 20), rendered(names, SEEDS[:1] if quick else SEEDS), bouguet()])


def synthetic(seeds: int) -> Result:
    """Corners drawn with noise, against the bound and against OpenCV, which calibrates each camera by itself."""
    ours, alone, bounds, normalised, seconds, alone_s = [], [], [], [], [], []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        rig = camera_rig(rng)
        views = rig.views(NOISE_PX, rng)
        found, spent_s = timed(lambda rig=rig, views=views: survey(views, rig.sizes))
        seconds.append(spent_s)
        bounds.append(bounds_px(rig, NOISE_PX))
        ours.append([found.cameras[name].project(SAMPLE) - rig.sample_px(name) for name in views])
        normalised.append([normalised_errors(rig.models[name], found.cameras[name]) for name in views])
        errors, spent_s = timed(lambda rig=rig, views=views: [_alone(rig, name, views[name]) for name in views])
        alone.append(errors)
        alone_s.append(spent_s)
    error_px, plain_px, believed_px = rms(ours), *(rms([pair[i] for pair in bounds]) for i in (0, 1))
    same = {"input": f"8 cameras x 14 boards, {NOISE_PX} px noise, {seeds} rigs"}
    return Result({
        "reprojection_over_bound": error_px / plain_px,
        "reprojection_over_belief": error_px / believed_px,
        "deviation_normalised_rms": rms(normalised),
    }, [
        {"method": "survey", "seconds": min(seconds), "error": error_px, **same},
        {"method": "cv2.calibrateCamera, each camera", "seconds": min(alone_s), "error": rms(alone), "peer": True,
         **same},
    ])  # fmt: skip


def _alone(rig: CameraRig, name: str, found: Mapping[Shot, BoardView]) -> np.ndarray:
    """OpenCV's error in predicted points of the sample, whose frame it takes from its own pose of the flat board."""
    flat = list(found).index(Shot(0))
    _, matrix, distortion, turns, shifts = by_opencv(list(found.values()), rig.sizes[name])
    on_board = geometry.transform_points(geometry.invert(rig.network.boards[0]), SAMPLE)
    return cv2.projectPoints(on_board, turns[flat], shifts[flat], matrix, distortion)[0][:, 0] - rig.sample_px(name)


def rendered(names: Sequence[str], seeds: Sequence[int]) -> Result:
    """Boards photographed by simulated rigs, whose truth is known; rms over the rigs."""
    found = [frames(names, seed) for seed in seeds]
    figures = {name: rms([[result.figures[name]] for result in found]) for name in found[0].figures}
    return Result(figures, [row for result in found for row in result.rows])


def frames(names: Sequence[str], seed: int) -> Result:
    """One rig."""
    with tempfile.TemporaryDirectory() as folder:
        optics = Optics(seed, "small", Path(folder))
        shots = [Shot(pose) for pose in range(8)] + [Shot(0, float(np.radians(angle))) for angle in TURNS_DEG]
        images = {name: {shot: photograph(optics, name, shot) for shot in shots} for name in names}
    layout = optics.layout
    printed = Board(layout.board.columns, layout.board.rows, layout.board.square_m, layout.board.marker_m)
    sizes = {name: (layout.cameras[name].height_px, layout.cameras[name].width_px) for name in names}
    views, detection_s = timed(
        lambda: {
            name: {shot: find_charuco(image, printed) for shot, image in taken.items()}
            for name, taken in images.items()
        }
    )
    found, seconds = timed(lambda: survey(views, sizes).facing(names))
    off_um = [texel_errors_m(found.cameras[name], layout.cameras[name]) * 1e6 for name in names]
    along = found.axis.direction @ layout.rig_from_board(0)[2, :3]
    same = {"input": f"{len(names)} cameras x {len(shots)} rendered boards, rig {seed}"}
    return Result({"pose_error_um": float(np.sqrt(2) * rms(off_um)),
                   "axis_error_deg": float(np.degrees(np.arccos(min(along, 1.0))))}, [
        {"method": "find_charuco", "seconds": detection_s, **same},
        {"method": "survey", "seconds": seconds, **same, "pose_error_um": [float(np.sqrt(2) * rms(e)) for e in off_um],
         "axis_sigma_deg": np.degrees(found.axis.tilt_deviation_rad).tolist()},
    ])  # fmt: skip


def photograph(optics: Optics, name: str, shot: Shot) -> np.ndarray:
    """One frame of the simulated rig, without its mosaic."""
    pose = Pose("charuco", shot.pose, shot.turntable_rad, np.radians(60), 0, (("lamp6", 1.0),), 0.6, False, None)
    key = ("board", shot.pose, round(1e6 * shot.turntable_rad))
    raw = read_raw(optics.photograph(name, pose, 0.05, serial=name, frame_key=key, time_s=0.0))
    return np.asarray(grey_mosaic(raw.mosaic.astype(np.float64) - raw.sensor.black_dn, raw.cfa), np.float32)


def texel_errors_m(camera: CameraModel, device: object) -> np.ndarray:
    """How far from the sample's points (n, 2) the calibrated camera sees them on the plane z = 0."""
    lens = type(camera.lens)(device.matrix, np.array([*device.distortion, 0, 0, 0]))
    uv_px = CameraModel(lens, device.rig_from_camera, camera.size).project(SAMPLE)
    met = geometry.intersect_plane(camera.centre_m, camera.rays(uv_px), (0, 0, 1), 0.0)
    return (met - SAMPLE)[:, :2]


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


def rms(values: object) -> float:
    """Root mean square of everything in nested lists of arrays, NaN left out."""
    return float(np.sqrt(np.nanmean(np.square(np.concatenate([np.ravel(value) for value in _flat(values)])))))


def _flat(values: object) -> list[np.ndarray]:
    return [part for value in values for part in _flat(value)] if isinstance(values, list) else [values]


def timed(work: Callable[[], Value]) -> tuple[Value, float]:
    """What the work gives, and its wall time in seconds."""
    started = time.perf_counter()
    return work(), time.perf_counter() - started


def joined(results: Sequence[Result]) -> Result:
    """Figures and rows of all."""
    figures: Mapping[str, float] = {name: value for result in results for name, value in result.figures.items()}
    return Result(figures, [row for result in results for row in result.rows])
