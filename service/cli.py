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
        str, typer.Option(help="sphere, plane, torus, vase, statue, or a mesh file (OBJ, PLY, GLB).")
    ] = "",
    azimuth_deg: Annotated[
        float, typer.Option(help="Of the light, or of the environment's middle, from +X toward +Y.")
    ] = 40.0,
    elevation_deg: Annotated[float, typer.Option(help="Of the light, from the horizon.")] = 45.0,
    environment: Annotated[
        Path | None, typer.Option(help="Light from all around instead: a picture twice as wide as high (.exr, .hdr).")
    ] = None,
    size: Annotated[int, typer.Option(help="Pixels on a side.", min=16, max=4096)] = 600,
) -> None:
    """Draw a material on a shape under light that stands or moves; or a BTF, MDF or reflectance maps as measured."""
    from service import viewing

    with reported_errors():
        lights = viewing.lights_of(azimuth_deg, elevation_deg, environment)
        tell(viewing.draw_product(product, out, shape, lights, size))


@app.command("import")
def import_(
    source: Annotated[Path, typer.Argument(help="Folder or zip of one BTF's pictures.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the new product.")],
    linear: Annotated[bool, typer.Option("--linear", help="Values are in proportion to light, not sRGB.")] = False,
    white: Annotated[
        float, typer.Option(help="Value, 0 to 1 in proportion to light, of a perfect diffuser under light from above.")
    ] = 1.0,
    region: Annotated[
        str, typer.Option(metavar="LEFT,TOP,WIDTH,HEIGHT", help="Part of the pictures that is taken, in pixels.")
    ] = "",
    size: Annotated[
        str, typer.Option(metavar="WIDTH,HEIGHT", help="Texels that this is averaged down to; all pixels unless given.")
    ] = "",
) -> None:
    """Make the product btf of a published BTF: a picture for each pair of directions, named as in Bonn's UBO2003.

    Names end in `tl015 pl060 tv030 pv090.jpg` (or .png): polar angle and azimuth of the light, then of the view, in
    degrees. What is read how: docs/analyse-a-btf.md
    """
    from service import importing

    with reported_errors(), ConsoleProgress() as progress:
        options = importing.options_of(region, size, white, linear=linear)
        for line in importing.import_btf(source, out, options, progress):
            tell(line)


@app.command()
def analyse(
    product: Annotated[Path, typer.Argument(metavar="BTF", help="Folder of a btf, of the rig or imported.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results, new or empty.")],
) -> None:
    """Take a BTF apart into SBRDF+: lobes, shadows, shifts and hidden points, as pictures, figures and a product.

    The product draws as the BTF does and is some thirty times smaller; the pictures show each step and the result
    beside the BTF. What it needs and writes: docs/analyse-a-btf.md
    """
    from service import analysing

    with reported_errors(), ConsoleProgress() as progress:
        for line in analysing.analyse_product(product, out, progress):
            tell(line)


@app.command()
def drape(
    product: Annotated[Path, typer.Argument(metavar="SRF", help="Folder of an SRF.")],
    mesh: Annotated[str, typer.Argument(help="A mesh file (OBJ, PLY, GLB), or sphere, torus, vase, statue.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the SRF made for this mesh, and the mesh.")],
    repeats: Annotated[
        float, typer.Option(help="Widths of the sample that go into the mesh's longest side.", min=0.1, max=100)
    ] = 3.0,
    size: Annotated[int, typer.Option(help="Texels on a side of the texture, about at most.", min=64, max=8192)] = 1024,
    seed: Annotated[int, typer.Option(help="Of the choice between places that fit alike.")] = 0,
) -> None:
    """Grow an SRF over a mesh without seams, from patches of the sample that fit their neighbours."""
    from service import draping

    with reported_errors():
        tell(draping.drape_product(product, mesh, out, repeats, size, seed))


@app.command()
def merge(
    files: Annotated[list[Path], typer.Argument(help="Bracketed photographs: RAW or DNG, or JPEG with EXIF.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Linear picture to write (.exr).")],
    measured_times: Annotated[
        bool, typer.Option("--measured-times", help="Of RAW: go by the frames where they contradict their times.")
    ] = False,
    moved: Annotated[bool, typer.Option("--moved", help="Merge although the camera moved between them.")] = False,
    sensor: Annotated[
        Path | None, typer.Option(help="Of RAW: the camera's measured sensor, a folder products/sensors/SERIAL.")
    ] = None,
    response: Annotated[
        Path | None, typer.Option(help="Of JPEG: the camera's response, saved (.json) by an earlier merge.")
    ] = None,
    grey_patch: Annotated[
        str, typer.Option(metavar="LEFT,TOP,WIDTH,HEIGHT", help="Pixels that are grey, for the white balance.")
    ] = "",
) -> None:
    """Merge bracketed photographs into one linear EXR with a variance layer, and a tone-mapped PNG beside it."""
    from processing.radiometry.stack import MergeOptions
    from service import measuring

    with reported_errors():
        options = MergeOptions(measured_times, moved)
        for line in measuring.merge_photographs(files, out, options, sensor, response, grey_patch):
            tell(line)


@app.command()
def displacement(
    source: Annotated[
        Path, typer.Argument(help="Folder of laser-line photographs or of a scan, GIF of a sweep, or TOML of a scan.")
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Depth picture (.png) or point cloud (.ply, .glb); the other is beside.")
    ],
) -> None:
    """Measure range in laser images that another rig took: stripe, laser plane, depth picture and point cloud.

    A folder is photographs of the stripe on a chessboard, with board.toml or their MATLAB calibration, or a scan with
    its scan.toml; a GIF is a laser swept by hand before two printed rectangles, with intrinsics.xml beside it or none;
    a TOML describes pictures of an object on a turntable or a stage before a laser that stands. What each needs:
    docs/range-of-your-own-images.md
    """
    from service import ranging

    with reported_errors(), ConsoleProgress() as progress:
        for line in ranging.measure_displacement(source, out, lambda frames: progress.track(frames, source.stem)):
            tell(line)


@app.command()
def export(
    product: Annotated[Path, typer.Argument(help="Folder of a product: reflectance_maps, a light_stack or a btf.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="A .ptm, an .rti, a folder for web viewers, or an .lp.")],
    luminance: Annotated[
        bool, typer.Option("--luminance", help="One colour per pixel, only its brightness follows the light (LRGB).")
    ] = False,
    harmonics: Annotated[
        bool, typer.Option("--harmonics", help="Of a folder: hemispherical harmonics, closer to gloss than a PTM.")
    ] = False,
) -> None:
    """Write a product for relighting viewers: polynomial texture map, RTI, or a folder for the web.

    RTIViewer and others open .ptm and .rti, OpenLIME and Relight the folder; an .lp has the pictures beside it, for
    programs that fit for themselves: docs/relight-your-own-photographs.md
    """
    from service import relighting

    with reported_errors():
        for line in relighting.export_product(product, out, luminance=luminance, harmonics=harmonics):
            tell(line)


@app.command()
def rti(
    source: Annotated[Path, typer.Argument(help="Folder of photographs, with an .lp of their lights, or that .lp.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")],
    mask: Annotated[Path | None, typer.Option(help="Picture that is not black where the object is.")] = None,
    chrome: Annotated[
        Path | None, typer.Option(help="Without .lp: picture that is not black where a chrome sphere is.")
    ] = None,
    unequal_lights: Annotated[
        bool, typer.Option("--unequal-lights", help="Find how strong each light was; the object must be curved.")
    ] = False,
    linear: Annotated[bool, typer.Option("--linear", help="Counts are in proportion to light, not sRGB.")] = False,
    pixel_mm: Annotated[float, typer.Option(help="Side of a pixel on the object.", min=1e-6)] = 1.0,
) -> None:
    """Relight photographs that another camera took under one light after another, and measure normals from them.

    --chrome lies among the photographs of the sphere, which are all pictures of that folder: those of the object, if
    the sphere stands beside it, or as many others under the same lights, in the same order of names.
    What it needs and writes: docs/relight-your-own-photographs.md
    """
    from service import relighting
    from service.light_photographs import PhotographFiles

    with reported_errors():
        files = PhotographFiles(source, mask, chrome, linear)
        for line in relighting.relight_photographs(files, out, pixel_m=pixel_mm / 1e3, unequal_lights=unequal_lights):
            tell(line)


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
    port: Annotated[int, typer.Option(help="Port on the loopback address.", min=1, max=65535)] = 8100,
) -> None:
    """Serve REST and the start page on the loopback address, for one rig."""
    from service.server import serve as run_server

    with reported_errors(), rig_at_hand(rig, simulated) as (config, _):
        run_server(config, sessions, port)


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
