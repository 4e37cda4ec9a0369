"""Errors of the demo's products against what the simulators know: for reports, never for processing."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import degrees
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.cameras.calibration import CameraModel
from processing.cameras.lens import Pinhole
from processing.materials.measurements import sphere_measurements
from processing.materials.srf import fit_phong
from processing.products import Btf, FactoredBtf, Mdf, ReflectanceMaps, Srf, sphere_normals, tangent_frames
from processing.products.provenance import read_description
from processing.products.sphere import gradient_grid
from processing.radiometry.hdr import PixelStatus
from rig.config import RigConfig
from rig.sessions import MdfPlan, Session, SrfPlan, Step
from service.pipeline.btf import btf_layout, texels_of
from service.pipeline.calibrations import CALIBRATION, Calibrations
from service.pipeline.stacks import MergedStack, only_lamp, stacks
from service.simulation import Simulation

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Distribution:
    """How errors are spread: root mean square, median and 95th percentile of their size, and the largest."""

    rms: float
    median: float
    p95: float
    largest: float

    @classmethod
    def of(cls, errors: NDArray[np.floating]) -> "Distribution":
        """Over the finite errors; NaN where there is none."""
        size = np.abs(errors[np.isfinite(errors)]).astype(np.float64)
        if size.size == 0:
            return cls(*[float("nan")] * 4)
        return cls(float(np.sqrt((size**2).mean())), *map(float, np.percentile(size, (50, 95, 100))))


@dataclass(frozen=True, slots=True)
class CalibrationErrors:
    """Calibrated cameras and axis against the true ones."""

    axis_rad: float  # between true and found axis, seen from the board; NaN where none was found
    sample_m: Distribution  # on the reference plane: where a camera sees a point of the sample, less where it is


def calibration_errors(session: Session, calibrations: Calibrations, simulation: Simulation) -> CalibrationErrors:
    """Of every camera over the sample's opening, and of the axis."""
    content, _ = read_description(session.products / CALIBRATION, "calibration")
    level = {"sample": "charuco", "pose": 0, "turntable_deg": 0.0}
    board = np.asarray(simulation.request("truth", what="board", at=level)["board"]["rig_from_board"])
    found = content["axis"]
    axis_rad = np.nan if found is None else np.linalg.norm(np.cross(found["direction_in_board"], board[2, :3]))
    true = simulation.request("truth", what="cameras")["cameras"]
    sample = geometry.texel_grid(9, session.config.holder.sample_mm / 1e3)
    errors = []
    for name, camera in calibrations.cameras.items():
        lens = Pinhole(np.asarray(true[name]["matrix"]), np.asarray([*true[name]["distortion"], 0, 0, 0]))
        uv_px = CameraModel(lens, np.asarray(true[name]["rig_from_camera"]), camera.size).project(sample)
        met = geometry.intersect_plane(camera.centre_m, camera.rays(uv_px), (0, 0, 1), 0.0)
        errors.append(np.linalg.norm(met - sample, axis=-1))
    return CalibrationErrors(float(axis_rad), Distribution.of(np.stack(errors)))


@dataclass(frozen=True, slots=True)
class HdrErrors:
    """Merged radiance against the noise-free mosaics: over all measured pixels, and in units of its own sigma."""

    relative_rmse: float  # root of the summed squared error over the summed squared truth
    per_pixel: Distribution  # relative, where the signal is over ten sigmas
    normalised: Distribution  # error over sigma; RMS 1 where the variance tells the truth


def hdr_errors(stacks_merged: Sequence[MergedStack], truth: Path) -> HdrErrors:
    """Every merged stack against the truth of its first frame's pose and light."""
    mosaics = {line["id"]: line["radiance"] for line in _frame_lines(truth)}
    values, trues, sigmas = [], [], []
    for merged in stacks_merged:
        measured = np.isin(merged.radiance.status, (PixelStatus.OK, PixelStatus.DARK))
        values.append(merged.radiance.value[measured])
        trues.append(np.load(truth / mosaics[merged.unique_ids[0]])[measured])
        sigmas.append(np.sqrt(merged.radiance.variance[measured]))
    value, true, sigma = (np.concatenate(parts).astype(np.float64) for parts in (values, trues, sigmas))
    error = value - true
    clear = true > 10 * sigma
    relative = Distribution.of(error[clear] / true[clear])
    return HdrErrors(float(np.sqrt((error**2).sum() / (true**2).sum())), relative, Distribution.of(error / sigma))


@dataclass(frozen=True, eq=False)
class SrfErrors:
    """An SRF's reconstruction of the sphere under the measured lights, against the noise-free reflectance maps.

    `mse_phong` and `lobe` are of the single lobe that was fitted to the maps without residuals.
    """

    mse_srf: float  # of linear values normalised to the largest true one
    mse_phong: float
    maps: Distribution  # of the measured maps themselves, relative to the largest true value
    truth: NDArray[np.float32]
    reconstruction: NDArray[np.float32]
    lobe: NDArray[np.float32]

    @property
    def mse_over_phong(self) -> float:
        """What the residual leaves of the lobe's error."""
        return self.mse_srf / self.mse_phong


def srf_errors(session: Session, maps: ReflectanceMaps, srf: Srf, simulation: Simulation) -> SrfErrors:
    """Compare an SRF, the best single lobe, and the measured maps with the true maps of the same lights."""
    assert isinstance(session.plan, SrfPlan)
    size = maps.reflectance_cos.shape[1]
    lights = [_light(session.config, stack.step) for stack in stacks(session.frames())]
    camera, sample = session.plan.camera, session.plan.sample
    facing = {"card_elevation_deg": session.config.cameras[camera].elevation_deg}
    reply = simulation.request("truth", what="srf", lights=lights, camera=camera, size=size, sample=sample, at=facing)
    truth = np.load(reply["path"])
    peak = float(np.nanmax(truth))
    reconstruction = np.stack([_on_sphere(maps, srf, light) for light in range(len(truth))])
    # The lobe of an SRF was found beside its residuals and is not the best without them.
    alone = fit_phong(sphere_measurements(maps)).phong
    bare = replace(srf, residual=np.zeros_like(srf.residual), phong=alone)
    lobe = np.stack([_on_sphere(maps, bare, light) for light in range(len(truth))])
    valid = np.isfinite(truth) & np.isfinite(maps.reflectance_cos)
    mse = [float((((model - truth)[valid] / peak) ** 2).mean()) for model in (reconstruction, lobe)]
    measured = Distribution.of((maps.reflectance_cos - truth)[valid] / peak)
    return SrfErrors(mse[0], mse[1], measured, truth, reconstruction, lobe)


def _light(config: RigConfig, step: Step) -> tuple[str, float]:
    """The lamp of a step, and the angle in degrees of the axis that carries it."""
    name = only_lamp(step)
    return name, degrees(step.axes_rad[config.lamps.lamp[name].mount])


def _on_sphere(maps: ReflectanceMaps, srf: Srf, light: int) -> NDArray[np.float32]:
    size = maps.reflectance_cos.shape[1]
    normals = sphere_normals(size)
    frames = tangent_frames(normals).reshape(-1, 3, 3)
    towards, views = maps.lights()[light].reshape(-1, 3), maps.views().reshape(-1, 3)
    uv = np.stack(np.meshgrid(*[(gradient_grid(size) + 1) / 2] * 2), axis=-1).reshape(-1, 2)
    local = [np.einsum("nij,nj->ni", frames, directions) for directions in (towards, views)]
    return np.asarray(srf.evaluate(uv, *local).reshape(size, size, 3), np.float32)


@dataclass(frozen=True, eq=False)
class BtfErrors:
    """A measured BTF, and its factored form, against the noise-free one, relative to the truth's RMS."""

    relative_rmse: float
    factored_rmse: float  # of the factors against the measured BTF, both times the light's cosine
    errors: Distribution
    truth: NDArray[np.float32]


def btf_errors(session: Session, calibrations: Calibrations, simulation: Simulation) -> BtfErrors:
    """Compare with the true reflectance of every light and view pair."""
    btf, factored = Btf.load(session.products / "btf"), FactoredBtf.load(session.products / "factored_btf")
    gathered, depth_m = stacks(session.frames()), texels_of(session).depth_m
    truth = np.full_like(btf.reflectance, np.nan)
    for stack, place in zip(gathered, btf_layout(gathered, session.config, calibrations).places, strict=True):
        reply = simulation.request(
            "truth", what="btf", camera=stack.camera, lamp=stack.step.lamps[0], texels=truth.shape[2],
            depth_m=depth_m, at=_at(stack.step),
        )  # fmt: skip
        truth[place] = np.load(reply["path"])
    rms = float(np.sqrt(np.nanmean(truth.astype(np.float64) ** 2)))
    spread = Distribution.of((btf.reflectance - truth) / rms)
    return BtfErrors(spread.rms, factored_error(btf, factored), spread, truth)


def factored_error(btf: Btf, factored: FactoredBtf) -> float:
    """Root of the factors' squared error over the BTF's sum of squares, both times the light's cosine."""
    left = whole = 0.0
    for light, measured in enumerate(btf.reflectance):
        weight = btf.light_directions[light, 2] ** 2
        left += weight * np.nansum((factored.under(light) - measured).astype(np.float64) ** 2)
        whole += weight * np.nansum(measured.astype(np.float64) ** 2)
    return float(np.sqrt(left / whole))


FALSE_M = 5e-4


@dataclass(frozen=True, eq=False)
class MdfErrors:
    """Measured displacements (view, y, x) against the true ones, in metres, and which texels were measured.

    A texel can be measured where the camera sees a surface that at least one laser location lights: `completeness` is
    the share of these that were. `false_points` are measured texels that cannot be, and those more than FALSE_M off, as
    a share of all measured ones. `within_one_code_step` is the share of the texels that can be measured whose value is
    within one step of the MDF's 8-bit code from the truth. Shares of nothing are NaN.
    """

    error_m: Distribution
    normalised: Distribution  # error over sigma
    completeness: float
    false_points: float
    within_one_code_step: float
    truth_m: NDArray[np.float64]
    measured_m: NDArray[np.float32]

    @classmethod
    def of(
        cls, mdf: Mdf, truth_m: NDArray[np.float64], lit: NDArray[np.bool_], step_m: float | None = None
    ) -> "MdfErrors":
        """From the true displacements, NaN where the camera sees none, and which of them a laser location lights.

        `step_m` is that of the code where more views are packed than these.
        """
        step_m = mdf.pack8()[1] if step_m is None else step_m
        error_m = mdf.displacement_m - truth_m
        measured, can_be = np.isfinite(mdf.displacement_m), lit & np.isfinite(truth_m)
        with np.errstate(invalid="ignore"):
            off, close = np.abs(error_m) > FALSE_M, np.abs(error_m) <= step_m
        return cls(
            Distribution.of(error_m),
            Distribution.of(error_m / np.sqrt(mdf.variance_m2)),
            _share(measured[can_be]),
            _share((off | ~can_be)[measured]),
            _share(close[can_be]),
            truth_m,
            mdf.displacement_m,
        )


def _share(which: NDArray[np.bool_]) -> float:
    return float(which.mean()) if which.size else float("nan")


def mdf_errors(session: Session, simulation: Simulation) -> MdfErrors:
    """Compare every view with the true displacement along its rays."""
    assert isinstance(session.plan, MdfPlan)
    mdf = Mdf.load(session.products / "mdf")
    truth: dict[tuple[str, float], Array] = {}
    lit: dict[tuple[str, float], NDArray[np.bool_]] = {}
    for record in session.frames():
        view = (record.camera, record.step.axes_rad["turntable"])
        reply = simulation.request(
            "truth",
            what="displacement",
            camera=record.camera,
            texels=session.plan.texels,
            depth_m=session.plan.depth_mm / 1e3,
            at=_at(record.step),
        )
        truth[view] = np.load(reply["path"])
        lit[view] = np.load(reply["lit_path"]) | lit.get(view, np.False_)
    views = sorted(truth)  # as the product has them
    return MdfErrors.of(mdf, np.stack([truth[view] for view in views]), np.stack([lit[view] for view in views]))


def _at(step: Step) -> dict[str, object]:
    """Where a step has the sample, the axes and the laser, as the control port reads it."""
    mounted = step.mount or {}
    axes = {f"{name}_deg": degrees(angle) for name, angle in step.axes_rad.items()}
    laser = {key: mounted[key] for key in ("laser_elevation_deg",) if key in mounted}
    return {"sample": mounted["sample"], **axes, **laser}


def _frame_lines(truth: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (truth / "frames.jsonl").read_text(encoding="utf-8").splitlines()]
