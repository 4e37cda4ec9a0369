"""The command `rig`: every subcommand parses, calls one function and says where the result is."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from rig.config import RigConfig, load_config
from rig.sessions import Session, expand, load_plan
from service.capture import Operator, capture, resume
from service.console import SessionProgress, StageProgress, ask_operator, console, reported_errors
from service.simulation import Simulation

app = typer.Typer(
    help="Drive a capture rig, turn its frames into materials, look at them. Start with: rig demo",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_show_locals=False,
    epilog="Exit codes: 0 done, 2 wrong input, 3 device or wire, 4 busy or wrong state, 5 storage, "
    "130 interrupted (resumable), 1 a defect of this program.",
)

RigOption = Annotated[Path, typer.Option("--rig", help="The rig.toml that says where each device is reached.")]
SimulatedOption = Annotated[bool, typer.Option("--simulated", help="Start the simulated rig and use it.")]
OutOption = Annotated[Path, typer.Option("--out", "-o", help="Where the result goes.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON for scripts.")]

DEFAULT_RIG = Path("rig.toml")


@contextmanager
def rig_at_hand(rig_toml: Path, simulated: bool, state: Path) -> Iterator[tuple[RigConfig, Operator]]:
    """The rig's configuration and who changes what is mounted: a person, or the simulators' control port."""
    if simulated:
        with Simulation(state) as simulation:
            yield load_config(simulation.rig_toml), simulation.mount
    else:
        yield load_config(rig_toml), ask_operator


@app.command()
def plan(
    file: Annotated[Path, typer.Argument(help="A plan, such as docs/plans/btf.toml.")],
    rig: RigOption = DEFAULT_RIG,
    simulated: SimulatedOption = False,
    steps: Annotated[bool, typer.Option(help="List every step (a dry run).")] = False,
    as_json: JsonOption = False,
) -> None:
    """Check a plan against the rig's limits and forecast its time and size; nothing moves."""
