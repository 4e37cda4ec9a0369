"""Planes and merged displacements of simulated sweeps against truth and bound, over locations, frames and methods.

Sweeps, truth and what the bound holds: `yardsticks/located_sweeps.py`; planes frame by frame:
`yardsticks/frame_planes.py`. Errors are per camera pixel, all pixels counted, in micrometres of displacement.
"""

import time
import warnings
from dataclasses import dataclass, replace

import numpy as np

from processing.cameras.calibration import CameraModel
from processing.laser.displacement import merge_displacements, tetrahedron_weights
from processing.laser.holder import plane_hits, reference_region
from processing.laser.laser_plane import sweep_planes
from processing.laser.mdf import SweepResult, measure_sweep
from processing.laser.range_image import RangeStatus, range_image
from processing.laser.space_time import PeakStatus, PeakTimes
from service.bench import Result
from tests.benchmarks.yardsticks.frame_planes import parallel_planes, stripe_lines, two_height_planes
from tests.benchmarks.yardsticks.located_sweeps import Located, brick, smooth_cap
from tests.reference.stripe_rig import HOLDER, Rig, camera_at, flat

LOCATIONS = (1, 2, 4, 8, 13, 26)
FRAMES = (24, 48, 96, 192)
FULL = (768, 1024)


def run(*, quick: bool) -> Result:
    """A smooth cap and the brick; quick from few locations, without sizes of a real camera."""
    cap = Merging("cap", [_measure(smooth_cap(number)) for number in range(4 if quick else 26)])
    relief = Merging("brick", [_measure(brick(number)) for number in range(3 if quick else 26)])
    sweeps = [*cap.sweeps, *relief.sweeps]
    angles = np.concatenate([angle_errors_deg(*sweep) for sweep in sweeps])
    figures = {
        "plane_angle_error_deg": _rms(angles),
        "plane_angle_error_worst_deg": float(angles.max()),
        "laser_place_calibration": _rms(np.concatenate([place_errors(*sweep) for sweep in sweeps])),
        "displacement_rmse_over_bound": max(part.over_bound(len(part.sweeps)) for part in (cap, relief)),
        "weights_paper_rmse": relief.error_um(len(relief.sweeps), paper=True),
        "weights_variance_rmse": relief.error_um(len(relief.sweeps)),
    }
    rows = [row for part in (cap, relief) for row in part.rows()]
    rows += [row for scale in (1.0, 2.0)[: 1 if quick else 2] for row in plane_rows(scale)]
    rows += [_frames_row(frames) for frames in (FRAMES[1:2] if quick else FRAMES)]
    return Result(figures, [*rows, *([] if quick else speed_rows())])


@dataclass(frozen=True)
class Merging:
    """Sweeps of one view, to be merged from the first few of their locations or from all."""

    name: str
    sweeps: list[tuple[Located, SweepResult]]

    def merged(self, count: int, *, paper: bool = False):
        """Errors, sigmas and bounds (n,) of all pixels that are measured from the first locations, and completeness."""
        results = [result for _, result in self.sweeps[:count]]
        displacement, variance = (
            np.stack([getattr(result.image, name) for result in results]) for name in ("displacement_m", "variance_m2")
        )
        camera = results[0].sweep.camera.centre_m
        sources = np.stack([result.laser.source_m for result in results])
        merged = merge_displacements(displacement, variance, tetrahedron_weights(sources, camera) if paper else None)
        truth = np.stack([located.displacement_m for located, _ in self.sweeps[:count]])
        information = sum(1.0 / located.bound_m2 for located, _ in self.sweeps[:count])
        reached = np.isfinite(truth).any(axis=0) & (results[0].image.status != RangeStatus.NOT_SAMPLE)
        with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # pixels that no laser reaches
            error = merged.displacement_m - np.nanmax(truth, axis=0)
        known = reached & np.isfinite(error)
        sigma, bound = np.sqrt(merged.variance_m2[known]), np.sqrt(1.0 / information[known])
        return error[known], sigma, bound, known.sum() / reached.sum()

    def error_um(self, count: int, *, paper: bool = False) -> float:
        """Root mean square error."""
        return 1e6 * _rms(self.merged(count, paper=paper)[0])

    def over_bound(self, count: int) -> float:
        """Root mean square error over that of the bound."""
        error, _, bound, _ = self.merged(count)
        return _rms(error) / _rms(bound)

    def rows(self) -> list[dict[str, object]]:
        """A row for each number of locations and kind of weights."""
        rows = []
        for count in sorted({min(number, len(self.sweeps)) for number in LOCATIONS}):
            for paper in (False, True):
                begun_s = time.perf_counter()
                error, sigma, bound, complete = self.merged(count, paper=paper)
                rows.append({
                    "method": f"{self.name}, {'tetrahedron weights' if paper else 'inverse variances'}",
                    "parameter": "laser locations", "value": count, "unit": "µm", "peer": paper,
                    "seconds": time.perf_counter() - begun_s,
                    "error": 1e6 * _rms(error), "bound": 1e6 * _rms(bound), "completeness": float(complete),
                    "over_its_sigma": _rms(error / sigma), "over_its_bound": _rms(error / bound),
                })  # fmt: skip
        return rows


def _measure(located: Located) -> tuple[Located, SweepResult]:
    """With its sweep's frames let go."""
    result = measure_sweep(located.sweep, located.holder)
    bare = replace(located.sweep, frames=())
    return replace(located, sweep=bare), replace(result, sweep=bare)


def true_planes(located: Located, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (t, 3) and offsets (t,) of the planes at these times."""
    elevation, distance_m, azimuth, _ = located.fan
    level, up = np.array([np.cos(azimuth), np.sin(azimuth), 0.0]), np.array([0.0, 0.0, 1.0])
    angle = located.angle(times)[:, None]
    normal = np.sin(angle) * level - np.cos(angle) * up
    return normal, normal @ (distance_m * (np.cos(elevation) * level + np.sin(elevation) * up))


def _middle_times(result: SweepResult) -> np.ndarray:
    """Between the frames too, and all but the ends, where no sample lies."""
    return np.linspace(result.laser.first + 1.0, result.laser.last - 1.0, 200)


def angle_errors_deg(located: Located, result: SweepResult) -> np.ndarray:
    """Angles between the true planes and the found ones over the sweep."""
    times = _middle_times(result)
    true, found = true_planes(located, times)[0], result.laser.planes(times)[0]
    return np.degrees(np.arcsin(np.linalg.norm(np.cross(true, found), axis=1)))


def place_errors(located: Located, result: SweepResult) -> np.ndarray:
    """Elevation, distance, azimuth and roll (4,) of the laser less the true ones, in their sigmas."""
    return (result.laser.fan - located.fan) / result.laser.deviation


def plane_rows(scale: float) -> list[dict[str, object]]:
    """Displacements with the same peak times and each method's planes; a frame's plane and the next are blended.

    On the pixels that the stripe crosses between every eighth frame in the middle of the sweep and the next one. The
    laser stands at the side, so that the stripe is upright in the picture and rows cross it, as the peers like best.
    """
    located = smooth_cap(3, scale)
    sweep, holder = located.sweep, located.holder
    result, frames = measure_sweep(sweep, holder), np.arange(20, 76, 8)
    time_frames, frame = result.peaks.time_frames, np.floor(result.peaks.time_frames)
    chosen = np.isin(frame, frames) & np.isfinite(result.image.displacement_m - located.displacement_m)
    times, place = time_frames[chosen].astype(np.float64), np.searchsorted(frames, frame[chosen])

    def by_frame(planes):
        normal, offset = planes(stripe_lines(sweep, holder, result.laser.source_m, np.r_[frames, frames + 1]))
        later = times - frames[place]
        return tuple(
            (part[place].T * (1.0 - later) + part[place + len(frames)].T * later).T for part in (normal, offset)
        )

    rows = []
    for name, find in (
        ("one model of the sweep", lambda: sweep_planes(
            result.peaks, sweep.camera, sweep.rig_from_sample, holder, sweep.mount).planes(times)),
        ("a plane per frame from two heights", lambda: by_frame(two_height_planes)),
        ("a line per frame, one angle (paper)", lambda: by_frame(parallel_planes)),
    ):  # fmt: skip
        begun_s = time.perf_counter()
        planes = find()
        seconds = time.perf_counter() - begun_s
        error = _cut(sweep.camera, planes, chosen) - located.displacement_m[chosen]
        known, bound = np.isfinite(error), np.sqrt(located.bound_m2[chosen])
        rows.append({"method": name, "size": f"{sweep.camera.size[1]}x{sweep.camera.size[0]}", "unit": "µm",
                     "seconds": seconds, "peer": name != "one model of the sweep", "measured": float(known.mean()),
                     "error": 1e6 * _rms(error[known]), "bound": 1e6 * _rms(bound),
                     "over_its_bound": _rms(error[known] / bound[known])})  # fmt: skip
    return rows


def _cut(camera: CameraModel, planes: tuple[np.ndarray, np.ndarray], chosen: np.ndarray) -> np.ndarray:
    """Displacements (n,) of the chosen pixels, each with its own plane."""
    rays, start = camera.pixel_rays()[chosen], plane_hits(camera, 0.0)[chosen]
    normal, offset = planes
    return (offset - np.einsum("ni,ni->n", normal, start)) / np.einsum("ni,ni->n", normal, rays)


def _frames_row(frames: int) -> dict[str, object]:
    """One location's error against the number of frames of its sweep."""
    begun_s = time.perf_counter()
    cap = Merging("cap", [_measure(smooth_cap(0, frames=frames))])
    error, sigma, bound, complete = cap.merged(1)
    return {"method": "ours", "parameter": "frames per sweep", "value": frames, "unit": "µm",
            "seconds": time.perf_counter() - begun_s, "error": 1e6 * _rms(error), "bound": 1e6 * _rms(bound),
            "over_its_sigma": _rms(error / sigma), "completeness": float(complete)}  # fmt: skip


def speed_rows() -> list[dict[str, object]]:
    """Seconds at a real camera's size: what a sweep needs beside its peak times, and the merge of all locations."""
    size, camera = f"{FULL[1]}x{FULL[0]}", replace(camera_at(60, 6.4), size=FULL)
    rig = Rig(camera, flat(0.002))
    rng = np.random.default_rng(7)
    peaks, view = noisy_peaks(rig, rng), (rig.camera, rig.rig_from_sample, HOLDER)
    laser = sweep_planes(peaks, *view, rig.mount)
    values = (0.002 + 1e-5 * rng.standard_normal((26, *FULL), np.float32)).astype(np.float32)
    values[rng.random(values.shape, np.float32) < 0.3] = np.nan
    variances = np.full_like(values, 1e-10)
    work = {
        "planes of a sweep": lambda: sweep_planes(peaks, *view, rig.mount),
        "rays cut by planes": lambda: range_image(peaks, *view, laser),
        "merge of 26 locations": lambda: merge_displacements(values, variances),
    }
    return [
        {"method": name, "size": size, "seconds": min(_seconds(part) for _ in range(4))} for name, part in work.items()
    ]


def noisy_peaks(rig: Rig, rng: np.random.Generator) -> PeakTimes:
    """Noisy times at which the plane crosses a sample that is flat, 2 mm deep, and its holder."""
    part = reference_region(rig.camera, rig.rig_from_sample, HOLDER, rig.source).height
    height = np.array([-0.002, 0.0, -HOLDER.step_m])[part]
    rays, centre = rig.camera.pixel_rays(), rig.camera.centre_m
    angle = rig.polar(centre + rays * ((height - centre[2]) / rays[..., 2])[..., None])[0]
    moments = np.arange(rig.frames)
    time_frames = np.interp(angle, rig.fan(moments), moments, left=np.nan, right=np.nan)
    time_frames = (time_frames + rng.normal(0, 0.01, angle.shape)).astype(np.float32)
    status = np.where(np.isfinite(time_frames), PeakStatus.OK, PeakStatus.TOO_DARK).astype(np.uint8)
    variance, amplitude, width = (np.full(angle.shape, value, np.float32) for value in (1e-4, 5e3, 1.0))
    return PeakTimes(time_frames, variance, amplitude, status, width)


def _seconds(work) -> float:
    begun_s = time.perf_counter()
    work()
    return time.perf_counter() - begun_s


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))
