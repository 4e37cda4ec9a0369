"""`rig demo`: from capture plans to lit pictures on the simulated rig, with the error against truth of every stage."""

import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from math import degrees
from pathlib import Path
from typing import TypeVar

from processing.products import Btf, FactoredBtf, ReflectanceMaps, Srf
from rig.config import load_config
from rig.errors import ConfigError, StoreError
from rig.sessions import Plan, RunReport, Session, load_plan
from service import demo_pictures, truth
from service.capture import capture
from service.console import ConsoleProgress
from service.machine import machine, peak_memory_gb, versions
from service.pipeline import process
from service.pipeline.calibrations import Calibrations, load_calibrations
from service.pipeline.stacks import merge, stacks
from service.report import Measure, Report, Stage, write_report
from service.simulation import Simulation

PLANS = Path(__file__).parents[1] / "docs" / "plans"
KINDS = ("calibrate", "srf", "btf", "mdf")
MARK = ".rig-demo"  # the folder is a demo's and may be made anew

Result = TypeVar("Result")


@dataclass
class Stopwatch:
    """Wall time by stage."""

    wall_s: dict[str, float] = field(default_factory=dict)

    def time(self, stage: str, work: Callable[[], Result]) -> Result:
        """Do the work and add its time to the stage."""
        started = time.perf_counter()
        try:
            return work()
        finally:
            self.wall_s[stage] = self.wall_s.get(stage, 0.0) + time.perf_counter() - started


@dataclass(frozen=True)
class Captured:
    """The demo's sessions, open, and how their runs went."""

    sessions: dict[str, Session]
    reports: dict[str, RunReport]


def demo_plans() -> dict[str, Plan]:
    """The demo's plans by kind, in their order. Raises ConfigError outside of a checkout."""
    if not PLANS.is_dir():
        raise ConfigError("the demo's plans are in docs/plans of a checkout; run it from one.")
    return {kind: load_plan(PLANS / f"{kind}.toml") for kind in KINDS}


def run_demo(out: Path, plans: Mapping[str, Plan], *, seed: int, progress: ConsoleProgress) -> Report:
    """Everything from the simulators' start to the report in `out`, which is made anew.

    Raises StoreError where `out` holds something that is not an earlier demo.
    """
    started = time.perf_counter()
    out = out.resolve()
    _clear(out)
    watch = Stopwatch()
    with Simulation(out / "simulation", seed=seed) as simulation:
        with _captured(out, plans, simulation, progress, watch) as captured:
            for kind in KINDS:
                _process(captured.sessions, kind, progress, watch)
            stages = _stages(out, captured, simulation, watch)
    figures = {"wall_s": time.perf_counter() - started, **_figures(captured, stages)}
    used = {**machine(), "peak_memory_gb": round(peak_memory_gb(), 2)}
    report = Report("First light", INTRODUCTION, tuple(stages), figures, used, versions())
    write_report(report, out)
    return report


INTRODUCTION = (
    "A stone sphere under the LED arm, a brick under the light arc and under the laser: captured on the simulated rig "
    "through the devices' own protocols, processed, drawn, and compared with what the simulators know to be true."
)


def _clear(out: Path) -> None:
    if out.exists() and any(out.iterdir()):
        if not (out / MARK).is_file():
            raise StoreError(f"{out} holds something that is not an earlier demo; name another folder with --out.")
        shutil.rmtree(out)
    out.mkdir(parents=True, exist_ok=True)
    (out / MARK).touch()


@contextmanager
def _captured(
    out: Path, plans: Mapping[str, Plan], simulation: Simulation, progress: ConsoleProgress, watch: Stopwatch
) -> Iterator[Captured]:
    config = load_config(simulation.rig_toml)
    reports, sessions = {}, {}
    try:
        for kind in KINDS:
            run = partial(capture, plans[kind], config, out / kind, operator=simulation.mount)
            follow = progress.follow(f"capture {kind}")
            reports[kind] = watch.time(f"capture {kind}", partial(run, on_event=follow))
            sessions[kind] = Session.open(out / kind)
        yield Captured(sessions, reports)
    finally:
        for session in sessions.values():
            session.close()


def _process(sessions: dict[str, Session], kind: str, progress: ConsoleProgress, watch: Stopwatch) -> None:
    calibrated = [] if kind == "calibrate" else [sessions["calibrate"].folder]
    watch.time(f"process {kind}", lambda: process(sessions[kind], calibrated, progress))


def _stages(out: Path, captured: Captured, simulation: Simulation, watch: Stopwatch) -> list[Stage]:
    sessions = captured.sessions
    return [
        _capture_stage(captured, watch),
        _calibration_stage(sessions["calibrate"], simulation, watch),
        _hdr_stage(sessions["srf"], simulation, watch),
        _srf_stage(out, sessions["srf"], simulation, watch),
        _btf_stage(out, sessions, simulation, watch),
        _mdf_stage(out, sessions["mdf"], simulation, watch),
        _preview_stage(out, sessions, watch),
    ]


def _capture_stage(captured: Captured, watch: Stopwatch) -> Stage:
    session_s = sum(report.session_s for report in captured.reports.values())
    bound_s = sum(report.lower_bound_s for report in captured.reports.values())
    frames = sum(record.frames for session in captured.sessions.values() for record in session.frames())
    return Stage(
        "Capture",
        "Four sessions through drivers, wires and journal: calibration board, sphere, brick under lamps, brick under "
        "laser sweeps.",
        sum(wall_s for name, wall_s in watch.wall_s.items() if name.startswith("capture")),
        session_s,
        (
            Measure("frames", frames, "", "frames taken"),
            Measure("session_overhead", session_s / bound_s, "x", "steps' time over their least, without homing"),
        ),
        demo_pictures.frames(captured.sessions),
    )


def _calibration_stage(session: Session, simulation: Simulation, watch: Stopwatch) -> Stage:
    calibrations = load_calibrations([session.folder])
    worst_px = max(camera.rms_px for camera in calibrations.cameras.values())
    errors = watch.time("truth", lambda: truth.calibration_errors(session, calibrations, simulation))
    return Stage(
        "Calibration",
        "Cameras of the arc and the turntable's axis in one adjustment, from a ChArUco board in several poses, one of "
        "which the turntable turns.",
        watch.wall_s["process calibrate"],
        None,
        (
            Measure("calibration_rms_px", worst_px, "px", "corners found less predicted, the worst camera's RMS"),
            Measure("axis_error_deg", degrees(errors.axis_rad), "deg", "turntable's axis against the true one"),
            Measure("pose_error_um", errors.sample_m.rms * 1e6, "um", "sample points as cameras place them, RMS error"),
        ),
        demo_pictures.calibration(session),
    )


def _hdr_stage(session: Session, simulation: Simulation, watch: Stopwatch) -> Stage:
    calibrations = Calibrations()
    merged = watch.time("merge", lambda: [merge(stack, calibrations) for stack in stacks(session.frames())])
    errors = watch.time("truth", lambda: truth.hdr_errors(merged, simulation.truth))
    read_ratio = sum(one.found.read.read_ratio for one in merged) / len(merged)
    return Stage(
        "Radiance",
        "Five exposures per light merged by maximum likelihood, with a variance per pixel.",
        watch.wall_s["merge"],
        None,
        (
            Measure("hdr_relative_rmse", errors.relative_rmse, "", "error over truth, root of summed squares"),
            Measure("hdr_p95", errors.per_pixel.p95, "", "relative error of a pixel over 10 sigmas, 95th percentile"),
            Measure("hdr_normalised_rms", errors.normalised.rms, "sigma", "error over the variance's own sigma"),
            Measure("hdr_read_ratio", read_ratio, "", "samples decoded over all; the others tell too little"),
        ),
    )


def _srf_stage(out: Path, session: Session, simulation: Simulation, watch: Stopwatch) -> Stage:
    maps = ReflectanceMaps.load(session.products / "reflectance_maps")
    srf = Srf.load(session.products / "srf")
    errors = watch.time("truth", lambda: truth.srf_errors(session, maps, srf, simulation))
    return Stage(
        "Spatially varying residual function",
        "The sphere's twelve reflectance maps, one Blinn-Phong lobe for all, and a residual vector per texel.",
        watch.wall_s["process srf"],
        None,
        (
            Measure("srf_mse_over_phong_mse", errors.mse_over_phong, "", "squared error over that of one lobe", 0.85),
            Measure("srf_mse", errors.mse_srf, "", "mean squared error of the SRF, of values normalised to 1"),
            Measure("maps_p95", errors.maps.p95, "", "error of the measured maps over the peak, 95th percentile"),
        ),
        demo_pictures.srf(out, errors),
    )


def _btf_stage(out: Path, sessions: dict[str, Session], simulation: Simulation, watch: Stopwatch) -> Stage:
    calibrations = load_calibrations([sessions["calibrate"].folder])
    errors = watch.time("truth", lambda: truth.btf_errors(sessions["btf"], calibrations, simulation))
    btf = Btf.load(sessions["btf"].products / "btf")
    return Stage(
        "Bidirectional texture function",
        "The brick rectified to 64 x 64 texels in every view under every light, over the white frame; four eigenmaps.",
        watch.wall_s["process btf"],
        None,
        (
            Measure("btf_rank4_relative_rmse", errors.factored_rmse, "", "four eigenmaps against the BTF, both lit"),
            Measure("btf_relative_rmse", errors.relative_rmse, "", "measured BTF against truth"),
            Measure("btf_p95", errors.errors.p95, "", "error of a sample over the truth's RMS, 95th percentile"),
        ),
        demo_pictures.btf(out, btf, errors),
    )


def _mdf_stage(out: Path, session: Session, simulation: Simulation, watch: Stopwatch) -> Stage:
    errors = watch.time("truth", lambda: truth.mdf_errors(session, simulation))
    return Stage(
        "Mesostructure distance function",
        "Eight laser sweeps per view, analysed in space-time and merged: how far the surface lies under the frame.",
        watch.wall_s["process mdf"],
        None,
        (
            Measure("displacement_rms_um", errors.error_m.rms * 1e6, "um", "error, root mean square"),
            Measure("displacement_median_um", errors.error_m.median * 1e6, "um", "error, median"),
            Measure("displacement_p95_um", errors.error_m.p95 * 1e6, "um", "error, 95th percentile"),
            Measure("displacement_completeness", errors.completeness, "", "measured share of what a laser reaches"),
            Measure(
                "false_point_share", errors.false_points, "", "measured where no laser reaches, or over 0.5 mm off"
            ),
            Measure("mdf_within_one_code_step", errors.within_one_code_step, "", "of what a laser reaches, in 8 bits"),
            Measure("displacement_normalised_rms", errors.normalised.rms, "sigma", "error over its own sigma"),
        ),
        demo_pictures.mdf(out, errors),
    )


def _preview_stage(out: Path, sessions: dict[str, Session], watch: Stopwatch) -> Stage:
    srf = Srf.load(sessions["srf"].products / "srf")
    factored = FactoredBtf.load(sessions["btf"].products / "factored_btf")
    drawn = watch.time("preview", lambda: demo_pictures.previews(out, srf, factored))
    measures = () if drawn.difference is None else (
        Measure("gl_vs_reference_max_relative", drawn.difference, "", "shaders against NumPy, largest error", 1e-3),
    )  # fmt: skip
    text = (
        f"SRF on the sphere and on a vase, BTF on a plane and a torus, under moving light. Drawn by {drawn.renderer}."
    )
    return Stage("Preview", text, watch.wall_s["preview"], None, measures, drawn.pictures)


FIGURES = (
    "frames", "hdr_relative_rmse", "displacement_rms_um", "displacement_completeness", "srf_mse_over_phong_mse",
    "btf_rank4_relative_rmse", "gl_vs_reference_max_relative", "session_overhead",
)  # fmt: skip


def _figures(captured: Captured, stages: list[Stage]) -> dict[str, float]:
    measured = {measure.name: measure.value for stage in stages for measure in stage.measures}
    return {name: measured[name] for name in FIGURES if name in measured}
