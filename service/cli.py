"""The command `rig`: every subcommand parses, calls one thing and says where the result is.

What computes, draws or serves is imported by the subcommand that needs it: `rig plan` and `rig resume` answer at once.
"""

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from rig.config import RigConfig, load_config
from rig.sessions import Operator, RunReport, Session, describe, forecast, load_plan, schedule
from service.capture import capture as run_capture
from service.capture import resume as run_resume
from service.cli_materials import materials
from service.console import EXIT_EPILOG, SAFE, ConsoleProgress, ask_operator, console, reported_errors, tell
from service.simulation import Simulation, mount_at

# Threads of compiled loops that wait for work sleep instead of spinning: on a busy machine these are much faster so.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

app = typer.Typer(
    help="Drive a capture rig, turn its frames into materials, look at them. Start with: **rig demo**",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    epilog=EXIT_EPILOG,
)

RigOption = Annotated[Path, typer.Option("--rig", help="The rig.toml that says where each device is reached.")]
SimulatedOption = Annotated[bool, typer.Option("--simulated", help="Start a simulated rig and use that.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON, for scripts.")]
PlanArgument = Annotated[Path, typer.Argument(help="A plan, such as docs/plans/btf.toml.")]
SessionArgument = Annotated[Path, typer.Argument(help="The folder of a session.")]

DEFAULT_RIG = Path("rig.toml")


@contextmanager
def rig_at_hand(rig_toml: Path, simulated: bool) -> Iterator[tuple[RigConfig, Operator]]:
    """The rig's configuration and who changes what is mounted: a person, or the simulators' control port."""
    if not simulated:
        config = load_config(rig_toml)
        yield config, operator_at(config)
        return
    with tempfile.TemporaryDirectory(prefix="rig-") as state, Simulation(Path(state)) as simulation:
        yield load_config(simulation.rig_toml), simulation.mount


def operator_at(config: RigConfig) -> Operator:
    """A person at the terminal; at simulators that somebody else started, their control port."""
    return ask_operator if config.clock is None else mount_at(config.clock.address)


@app.command()
def plan(
    file: PlanArgument,
    rig: RigOption = DEFAULT_RIG,
    simulated: SimulatedOption = False,
    steps: Annotated[bool, typer.Option("--steps", help="List every step (a dry run).")] = False,
    as_json: JsonOption = False,
) -> None:
    """Check a plan against the rig's limits and forecast its time and size; nothing moves."""
    with reported_errors(), rig_at_hand(rig, simulated) as (config, _):
        laid_out = schedule(load_plan(file), config)
        expected = forecast(laid_out.steps, config)
    if as_json:
        listed = {"dry_run": [describe(step) for step in laid_out.steps]} if steps else {}
        tell(json.dumps({"steps": len(laid_out.steps), **asdict(expected), **listed}))
        return
    for step in laid_out.steps if steps else ():
        tell(describe(step))
    for skip in laid_out.skipped:
        tell(f"skipped {skip.what}: {skip.reason}")
    tell(
        f"{file}: {len(laid_out.steps)} steps, {expected.frames} frames, {expected.bytes / 1e6:.0f} MB, "
        f"about {expected.time_s / 60:.1f} min on the rig. Nothing was moved."
    )


@app.command()
def capture(
    file: PlanArgument,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the new session.")],
    rig: RigOption = DEFAULT_RIG,
    simulated: SimulatedOption = False,
    as_json: JsonOption = False,
) -> None:
    """Carry out a plan. Ctrl-C leaves the rig dark and still and the session resumable."""
    with reported_errors(SAFE), rig_at_hand(rig, simulated) as (config, operator), ConsoleProgress() as progress:
        follow = progress.follow(file.stem)
        report = run_capture(load_plan(file), config, out, operator=operator, on_event=follow)
    _tell_end(out, report, as_json)


@app.command()
def resume(
    session: SessionArgument,
    rig: Annotated[
        Path | None, typer.Option("--rig", help="rig.toml, where devices are reached elsewhere now.")
    ] = None,
    simulated: SimulatedOption = False,
    as_json: JsonOption = False,
) -> None:
    """Take the steps of a session that are not done yet."""
    with reported_errors(SAFE), Session.open(session) as opened:
        if rig is None and not simulated:
            report = _resume(opened, opened.config, operator_at(opened.config))
        else:
            with rig_at_hand(rig or DEFAULT_RIG, simulated) as (config, operator):
                report = _resume(opened, config, operator)
    _tell_end(session, report, as_json)


@app.command()
def verify(session: SessionArgument, as_json: JsonOption = False) -> None:
    """Read every frame of a session and compare its checksum."""
    with reported_errors(), Session.open(session) as opened:
        found = {"files": opened.verify(), "done": len(opened.done()), "total": len(opened.steps)}
    if as_json:
        tell(json.dumps(found))
        return
    tell(f"{session}: {found['files']} files, all whole; {found['done']} of {found['total']} steps done.")


@app.command()
def process(
    session: SessionArgument,
    calibration: Annotated[
        list[Path] | None, typer.Option(help="Processed session that measured the rig; may be given several times.")
    ] = None,
    rank: Annotated[int | None, typer.Option(help="Eigenmaps of a BTF; 4 unless given.", min=1)] = None,
    as_json: JsonOption = False,
) -> None:
    """Turn a session's frames into its products. What has not changed is not made again."""
    from service.pipeline import DEFAULT_RANK
    from service.pipeline import process as run_pipeline

    with reported_errors(), Session.open(session) as opened, ConsoleProgress() as progress:
        folders = run_pipeline(opened, calibration or [], progress, rank=rank or DEFAULT_RANK)
    if as_json:
        tell(json.dumps({"products": [str(folder) for folder in folders]}))
        return
    for folder in folders:
        tell(str(folder))


@app.command()
def preview(
    product: Annotated[Path, typer.Argument(help="Folder of a product.")],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Picture (.png), moving light (.webp, .gif), or a folder for all.")
    ],
    shape: Annotated[
        str,
        typer.Option(
            help="sphere, plane, torus, cylinder, knot, vase, statue, teapot, or a mesh file (OBJ, PLY, GLB)."
        ),
    ] = "",
    floor: Annotated[bool, typer.Option("--floor", help="Lay a floor of the material under the shape.")] = False,
    azimuth_deg: Annotated[
        float, typer.Option(help="Of the light, or of the environment's middle, from +X toward +Y.")
    ] = 40.0,
    elevation_deg: Annotated[float, typer.Option(help="Of the light, from the horizon.")] = 45.0,
    environment: Annotated[
        Path | None,
        typer.Option(help="Light from all around instead: a picture (.exr, .hdr) or environment."),
    ] = None,
    size: Annotated[int, typer.Option(help="Pixels on a side.", min=16, max=4096)] = 600,
) -> None:
    """Draw a material on a shape under light that stands or moves; or a BTF, MDF or reflectance maps as measured."""
    from service import viewing

    with reported_errors():
        lights = viewing.lights_of(azimuth_deg, elevation_deg, environment)
        tell(viewing.draw_product(product, out, shape, lights, size, floor=floor))


app.add_typer(materials)


@app.command()
def demo(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of sessions, pictures and report.")] = Path(
        "out/demo"
    ),
    seed: Annotated[int, typer.Option(help="Of the simulated rig: the same seed gives the same bits.")] = 1,
    as_json: JsonOption = False,
) -> None:
    """Capture, process and draw a sphere and a brick on the simulated rig, and report error against truth."""
    from service.demo import demo_plans, run_demo

    with reported_errors(), ConsoleProgress() as progress:
        report = run_demo(out, demo_plans(), seed=seed, progress=progress)
    if as_json:
        tell(json.dumps(report.figures))
        return
    for name, value in report.figures.items():
        tell(f"  {name:34} {value:.4g}")
    tell(f"Report with all pictures: {(out / 'report.html').resolve()}")
    for stage in report.stages:
        for picture in stage.pictures:
            tell(f"  {picture.path.resolve()}: {picture.caption}")


@app.command()
def bench(
    name: Annotated[
        str, typer.Argument(help="Which benchmark; `report` draws all that were written, none lists what there is.")
    ] = "",
    to: Annotated[Path | None, typer.Argument(metavar="[FILE]", help="File for the whole record, as JSON.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Under a minute.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the whole record, where no FILE is named.")] = False,
    listing: Annotated[bool, typer.Option("--list", help="List the benchmarks.")] = False,
    records: Annotated[Path, typer.Option(help="Folder of written records, for `report`.")] = Path("out"),
) -> None:
    """Measure run time and error: figures that a machine can compare."""
    from service import measuring

    with reported_errors():
        for line in measuring.benchmark("" if listing else name, quick=quick, to=to, as_json=as_json, records=records):
            tell(line)


@app.command()
def serve(
    rig: RigOption = DEFAULT_RIG,
    simulated: SimulatedOption = False,
    sessions: Annotated[Path, typer.Option(help="Folder of the sessions.")] = Path("sessions"),
    scenes: Annotated[Path, typer.Option(help="Folder of scenes to relight, and of environments.")] = Path("scenes"),
    port: Annotated[int, typer.Option(help="Port on the loopback address.", min=1, max=65535)] = 8100,
) -> None:
    """Serve REST and the start page on the loopback address, for one rig."""
    from service.server import serve as run_server

    with reported_errors(), rig_at_hand(rig, simulated) as (config, _):
        run_server(config, sessions, scenes, port)


def _resume(session: Session, config: RigConfig, operator: Operator) -> RunReport:
    with ConsoleProgress() as progress:
        return run_resume(session, config, operator=operator, on_event=progress.follow(session.id))


def _tell_end(folder: Path, report: RunReport, as_json: bool) -> None:
    if as_json:
        tell(json.dumps(asdict(report)))
        return
    for line in report.unconfirmed:
        console.print(f"unconfirmed: {line}", style="red", markup=False)
    more = "" if report.done == report.total else f" `rig resume {folder}` takes the rest."
    tell(f"{folder}: {report.state}, {report.done} of {report.total} steps.{more}")


def main() -> None:
    """Entry point of the command."""
    app()
