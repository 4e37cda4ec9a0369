"""MDF texels against the simulated truth: sweeps of the rig through peak times, planes, merging and resampling.

Sweeps of the full-size rig (0.16 mm per pixel), texels of 0.84 mm; the mount is nominal, the motor uneven, the frames
hold noise. Figures are of the brick before all cameras of the arc, from the 26 laser locations of docs/plans.
`displacement_rms_um`: rms over the measured texels. `completeness`: measured share of the texels that the camera sees
and at least one laser location lights. `false_point_share`: of the measured texels, those that no location lights or
that are more than 0.5 mm off. `mdf_within_one_code_step`: of the texels that a location lights, those measured to
within one step of the 8-bit code, all views packed together.
Peers resample the same merged pixels. `limit` rows resample the true values at the pixels, without any noise: what
lies between pixels is not in the frames.
"""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import map_coordinates

from processing import geometry
from processing.cameras.board import Board, find_charuco
from processing.cameras.calibration import CameraModel, survey
from processing.cameras.network import Shot
from processing.laser.mdf import SweepResult, Weighting, measure_sweep, merge_view, view_texels
from processing.products import Mdf
from service.bench import Result
from service.truth import MdfErrors
from simulators.optics import Optics
from tests.benchmarks.calibrations.cameras import photograph, timed
from tests.benchmarks.yardsticks.laser_scans import Location, Recording, Scanner, Truth, around, planned
from tests.reference.camera_rig import TURNS_DEG

SEED, TEXELS = 7, 64
ARC = tuple(f"cam{number}" for number in range(8))  # 20 to 88 degrees up
CAMERAS = ("cam1", "cam4", "cam7")  # 30, 60 and 88 degrees up
STRIP = 0.5  # of the holder's width, where a part of the sample tells as much


@dataclass(frozen=True)
class View:
    """One camera's sweeps as they were measured, one for each location."""

    scanner: Scanner
    recording: Recording
    locations: Sequence[Location]
    results: Sequence[SweepResult]
    seconds: float

    def fewer(self, count: int) -> "View":
        """From that many of the locations, spread evenly."""
        chosen = np.round(np.linspace(0, len(self.locations) - 1, count)).astype(int)
        share = count / len(self.locations)
        return replace(
            self, locations=[self.locations[i] for i in chosen], results=[self.results[i] for i in chosen],
            seconds=share * self.seconds,
        )  # fmt: skip


def run(*, quick: bool) -> Result:
    """All figures; quick on a strip of one view from six locations."""
    with tempfile.TemporaryDirectory() as folder:
        optics = Optics(SEED, "full", Path(folder))
        if quick:
            return _product([_scan(Scanner(optics, "cam4", "brick", STRIP), around(6))], "brick, a strip, cam4")
        brick = [_scan(Scanner(optics, camera, "brick"), planned()) for camera in ARC]
        whole = _product(brick, "brick")
        return Result(whole.figures, [*whole.rows, *_influences(optics, brick), *_samples(optics), *_rigs(folder)])


def _influences(optics: Optics, brick: Sequence[View]) -> list[Mapping[str, object]]:
    """Fewer locations; other exposures and frame rates; cameras that were calibrated."""
    rows = [
        _varied(_product([view.fewer(count) for view in brick], "brick"), "laser locations of the MDF", count)
        for count in (2, 4, 8, 13, 26)
    ]
    for exposure_s in (0.0075, 0.015, 0.03, 0.06):
        view = _scan(Scanner(optics, "cam4", "brick", STRIP), around(8), Recording(exposure_s))
        rows.append(_varied(_product([view], "brick, a strip, cam4"), "exposure of the MDF in ms", 1e3 * exposure_s))
    for rate_hz in (3.75, 7.5, 15.0):
        view = _scan(Scanner(optics, "cam4", "brick", STRIP), around(8), Recording(0.03, rate_hz))
        rows.append(_varied(_product([view], "brick, a strip, cam4"), "frames per second of the MDF", rate_hz))
    known = calibrated(optics)
    views = [_scan(Scanner(optics, camera, "brick", STRIP, known[camera]), around(8)) for camera in CAMERAS]
    return [*rows, _product(views, "brick, a strip, calibrated cameras").rows[0]]


def _varied(product: Result, parameter: str, value: float) -> Mapping[str, object]:
    """The whole MDF's row as a point of a line."""
    whole = product.rows[0]
    return {**whole, "parameter": parameter, "value": value, "unit": "µm", "measured": whole["completeness"]}


def _samples(optics: Optics) -> list[Mapping[str, object]]:
    rows: list[Mapping[str, object]] = []
    for sample in ("peanut", "weave", "grass"):
        views = [_scan(Scanner(optics, camera, sample, STRIP), around(13)) for camera in CAMERAS]
        rows += _product(views, f"{sample}, a strip").rows
    return rows


def _rigs(folder: str) -> list[Mapping[str, object]]:
    """The small rig's cameras have a tenth of the pixels."""
    small = Optics(SEED, "small", Path(folder))
    return list(
        _product([_scan(Scanner(small, camera, "brick"), planned()) for camera in CAMERAS], "brick, small rig").rows
    )


def _scan(scanner: Scanner, locations: Sequence[Location], recording: Recording | None = None) -> View:
    recording, results, spent_s = recording or Recording(), [], 0.0
    for place in locations:
        sweep = scanner.sweep(place, recording)
        frames = np.stack(list(sweep.frames))
        found, seconds = timed(lambda s=sweep, f=frames: measure_sweep(replace(s, frames=f), scanner.holder))
        results.append(replace(found, sweep=replace(sweep, frames=())))
        spent_s += seconds
    return View(scanner, recording, locations, results, spent_s)


def _product(views: Sequence[View], what: str) -> Result:
    """Figures of the views as one MDF; a row for it, one for each view, and those of other ways to its texels."""
    truths = [view.scanner.truth(view.locations, TEXELS) for view in views]
    merged, merging_s = timed(lambda: [merge_view(v.scanner.name, v.results, Weighting.VARIANCE).merged for v in views])
    sheets, resampling_s = timed(
        lambda: [
            view_texels(m, v.results[0].sweep, v.scanner.holder, TEXELS) for m, v in zip(merged, views, strict=True)
        ]
    )
    mdf, peer, limit = (_as_mdf(found, views) for found in (
        sheets,
        [_bilinear(m.displacement_m, v) for m, v in zip(merged, views, strict=True)],
        [_bilinear(v.scanner.pixel_displacement(), v) for v in views],
    ))  # fmt: skip
    spent_s = sum(view.seconds for view in views) + merging_s + resampling_s
    about = {"input": what, "size": f"{len(views[0].locations)} locations", **asdict(views[0].recording)}
    errors = _errors(mdf, truths)
    rows: list[Mapping[str, object]] = [{"method": "MDF", "seconds": spent_s, **about, **_told(errors)}]
    for number, view in enumerate(views):
        rows.append({"view": view.scanner.name, **about, **_told(_errors(mdf, truths, number))})
    for name, other in (("bilinear", peer), ("limit: bilinear on true pixels", limit)):
        rows.append({"resampling": name, "peer": True, **about, **_told(_errors(other, truths))})
    figures = {
        "displacement_rms_um": 1e6 * errors.error_m.rms,
        "completeness": errors.completeness,
        "false_point_share": errors.false_points,
        "mdf_within_one_code_step": errors.within_one_code_step,
    }
    return Result(figures, rows)


def _as_mdf(sheets: Sequence[tuple[np.ndarray, np.ndarray]], views: Sequence[View]) -> Mdf:
    displacement, variance = (np.stack([sheet[i] for sheet in sheets]) for i in (0, 1))
    centres = np.stack([view.scanner.camera.centre_m for view in views])
    directions = centres / np.linalg.norm(centres, axis=1, keepdims=True)
    return Mdf(displacement, variance, directions, views[0].scanner.holder.texels_m)


def _bilinear(image_m: np.ndarray, view: View) -> tuple[np.ndarray, np.ndarray]:
    """Texels between the four pixels around their image points; the variance is not known."""
    uv_px = view.scanner.camera.project(geometry.texel_grid(TEXELS, view.scanner.holder.texels_m))
    found = map_coordinates(image_m, np.moveaxis(uv_px[..., ::-1], -1, 0), order=1, cval=np.nan).astype(np.float32)
    return found, np.full(found.shape, np.nan, np.float32)


def _errors(mdf: Mdf, truths: Sequence[Truth], only: int | None = None) -> MdfErrors:
    """Of all views or of one, in the parts of the image that are looked at; the code is that of all views."""
    part = slice(None) if only is None else slice(only, only + 1)
    inside, truth_m, lit = (
        np.stack([getattr(t, n) for t in truths])[part] for n in ("inside", "displacement_m", "lit")
    )
    seen = replace(
        mdf, displacement_m=np.where(inside, mdf.displacement_m[part], np.nan), variance_m2=mdf.variance_m2[part]
    )
    return MdfErrors.of(seen, truth_m, lit, mdf.pack8()[1])


def _told(errors: MdfErrors) -> dict[str, float]:
    um = {name: 1e6 * value for name, value in asdict(errors.error_m).items()}
    row = {
        "error": um["rms"], "median_um": um["median"], "p95_um": um["p95"], "largest_um": um["largest"],
        "completeness": errors.completeness, "false_points": errors.false_points,
        "within_one_code_step": errors.within_one_code_step,
    }  # fmt: skip
    return row if np.isnan(errors.normalised.rms) else row | {"normalised_rms": errors.normalised.rms}


def calibrated(optics: Optics) -> Mapping[str, CameraModel]:
    """The cameras as boards before them tell."""
    layout = optics.layout
    shots = [Shot(pose) for pose in range(8)] + [Shot(0, float(np.radians(angle))) for angle in TURNS_DEG]
    printed = Board(layout.board.columns, layout.board.rows, layout.board.square_m, layout.board.marker_m)
    views = {name: {shot: find_charuco(photograph(optics, name, shot), printed) for shot in shots} for name in CAMERAS}
    sizes = {name: (layout.cameras[name].height_px, layout.cameras[name].width_px) for name in CAMERAS}
    return survey(views, sizes).facing(list(CAMERAS)).cameras
