"""Lamps: directions from a mirror ball and a white plate, with cameras calibrated from boards, against their labels.

`lamp_direction_error_deg`: of the worst lamp at the worst angle of its carrier, between its true direction from the
rig's origin and that of its model, cameras calibrated from rendered boards, highlights and plates from rendered frames.
The azimuth that cameras and lamps have in common is no error: the axis leaves it open, and cameras are told in it too.
`lamp_distance_error`, `lamp_intensity_error`: of the worst lamp over which the plate lies, relative; intensities less
what all have in common, which is the cameras' sensitivity.
"""

import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from processing.cameras.board import Board, find_charuco
from processing.cameras.calibration import CameraModel, survey
from processing.cameras.network import Shot
from processing.lamps.calibration import measure_lamps
from processing.lamps.mirror import locate_lamps
from processing.lamps.model import LampModel, nominal_places
from service.bench import Result
from simulators.optics import Optics
from tests.benchmarks.calibrations.cameras import photograph
from tests.reference.camera_rig import TURNS_DEG
from tests.reference.lamp_rig import BALL, CAMERAS, LampRig, Photographer, angle_deg

QUICK = ("lamp0", "lamp2", "lamp4", "lamp6", "led")


def run(*, quick: bool) -> Result:
    """Three simulated rigs; quick with one, and half of its lamps."""
    seeds, lamps = ((1,), QUICK) if quick else ((1, 2, 3), None)
    errors: dict[str, list[np.ndarray]] = {}
    seconds: dict[str, list[float]] = {}
    extra: list[tuple[float, float]] = []
    for seed in seeds:
        rig = LampRig.of(seed)
        with tempfile.TemporaryDirectory() as folder:
            optics = Optics(seed, "small", Path(folder))
            cameras = calibrated(optics, rig)
            photographer = Photographer(optics, cameras, np.random.default_rng(seed))
            found = measured(rig, photographer, lamps)
        open_rad = common_azimuth_rad(cameras, rig)
        for method, (models, spent_s) in found.items():
            errors.setdefault(method, []).append(directions_off_deg(models, rig, open_rad))
            seconds.setdefault(method, []).append(spent_s)
        extra.append(distance_and_intensity(found["mirror ball and white plate"][0], rig))
    rows = [
        {"method": method, "error": float(np.sqrt(np.mean(np.square(off)))), "worst_deg": float(np.max(off)),
         "median_deg": float(np.median(off)), "rigs": len(seeds)}
        | ({} if method == "labels" else {"seconds": min(seconds[method])})
        for method, off in errors.items()
    ]  # fmt: skip
    worst = np.max(extra, axis=0)
    return Result({
        "lamp_direction_error_deg": float(np.max(errors["mirror ball and white plate"])),
        "lamp_distance_error": float(worst[0]),
        "lamp_intensity_error": float(worst[1]),
    }, rows)  # fmt: skip


def calibrated(optics: Optics, rig: LampRig) -> Mapping[str, CameraModel]:
    """Cameras from rendered boards."""
    layout = optics.layout
    shots = [Shot(pose) for pose in range(8)] + [Shot(0, float(np.radians(angle))) for angle in TURNS_DEG]
    printed = Board(layout.board.columns, layout.board.rows, layout.board.square_m, layout.board.marker_m)
    views = {name: {shot: find_charuco(photograph(optics, name, shot), printed) for shot in shots} for name in CAMERAS}
    return survey(views, {name: camera.size for name, camera in rig.cameras.items()}).facing(list(CAMERAS)).cameras


def measured(
    rig: LampRig, photographer: Photographer, lamps: Sequence[str] | None
) -> dict[str, tuple[dict[str, LampModel], float]]:
    """Models of all lamps by each method, and the seconds of its computation without reading frames."""
    sightings, views = photographer.mirror(rig, names=lamps), photographer.white(rig, names=lamps)
    begun_s = time.perf_counter()
    fit = locate_lamps(sightings, photographer.cameras, rig.nominal, BALL)
    mirror, _ = measure_lamps(rig.nominal, sightings, fit, [], 1.0)
    mirror_s = time.perf_counter() - begun_s
    both, _ = measure_lamps(rig.nominal, sightings, fit, views, 0.9)
    both_s = time.perf_counter() - begun_s
    white, _ = measure_lamps(rig.nominal, [], None, views, 0.9)
    white_s = time.perf_counter() - begun_s - both_s
    places = nominal_places(rig.nominal)
    labels = {
        name: LampModel(name, lamp.mount, lamp.position_m, places.covariance(name))
        for name, lamp in rig.nominal.items()
    }
    found = {
        "mirror ball and white plate": (both, both_s),
        "mirror ball": (mirror, mirror_s),
        "white plate": (white, white_s),
        "labels": (labels, 0.0),  # read, not measured: their row has no time
    }
    kept = lamps or tuple(rig.nominal)
    return {method: ({name: models[name] for name in kept}, spent) for method, (models, spent) in found.items()}


def common_azimuth_rad(cameras: Mapping[str, CameraModel], rig: LampRig) -> float:
    """By how much the calibrated cameras as a whole are turned about the axis against the true ones."""
    turns = []
    for name, camera in cameras.items():
        found, true = camera.centre_m[:2] @ [1, 1j], rig.cameras[name].centre_m[:2] @ [1, 1j]
        turns.append((np.angle(found / true), abs(true) ** 2))
    angles, weights = np.array(turns).T
    return float(angles @ weights / weights.sum())


def directions_off_deg(models: Mapping[str, LampModel], rig: LampRig, open_rad: float) -> np.ndarray:
    """Angle between model and truth of every lamp at every angle of its carrier."""
    off = []
    for name, angle_rad in rig.stands():
        if name not in models:
            continue
        carriers = (0.5, angle_rad) if rig.layout.lamps[name].mount == "arm" else (angle_rad, 0.0)
        true = rig.layout.lamp_position(name, *carriers)
        off.append(angle_deg(models[name].direction(angle_rad - open_rad), true))
    return np.array(off)


def distance_and_intensity(models: Mapping[str, LampModel], rig: LampRig) -> tuple[float, float]:
    """Largest relative errors, of intensities less their mean."""
    distances, lights = [], []
    for name, model in models.items():
        if np.isfinite(model.intensity_e_s).all():
            distances.append(abs(model.distance_m / np.linalg.norm(rig.position(name)) - 1))
            lights.append(np.log(model.intensity_e_s) - rig.log_intensity(name))
    off = np.array(lights) - np.mean(lights, axis=0)
    return max(distances), float(np.abs(off).max())
