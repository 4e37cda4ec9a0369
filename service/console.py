"""What the command line shows: progress with time left, one clear line per error, exit codes that scripts can use."""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TypeVar

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn

from rig.sessions import Event
from service.problems import problem_of

console = Console(stderr=True, highlight=False)
INTERRUPTED = 130

Item = TypeVar("Item")


@contextmanager
def reported_errors() -> Iterator[None]:
    """Turn every expected error into one line and its exit code; a defect keeps its traceback."""
    try:
        yield
    except KeyboardInterrupt as interrupt:
        console.print("Interrupted: lamps and laser are off. `rig resume SESSION` goes on.", style="yellow")
        raise typer.Exit(INTERRUPTED) from interrupt
    except Exception as error:
        problem = problem_of(error)
        if problem is None:
            raise
        console.print(f"{problem.code}: {error}", style="red", soft_wrap=True, markup=False)
        raise typer.Exit(problem.exit_code) from error


class SessionProgress:
    """A bar with the time left, driven by the session's events; a line each where nobody watches a terminal."""

    def __init__(self) -> None:
        self._progress = Progress(
            SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
            TextColumn("{task.fields[left]}"), console=console, transient=False,
        )  # fmt: skip
        self._task = self._progress.add_task("preparing", total=None, left="")

    def __enter__(self) -> Callable[[Event], None]:
        self._progress.start()
        return self.show

    def __exit__(self, *exc: object) -> None:
        self._progress.stop()

    def show(self, event: Event) -> None:
        """Show one event of the session."""
        left = "" if event.eta_s is None else f"{event.eta_s:5.0f} s left"
        self._progress.update(
            self._task, completed=event.done, total=event.total, left=left, description=event.state or event.kind
        )


class StageProgress:
    """Progress over the parts of a computation, with the time left."""

    def __init__(self) -> None:
        self._progress = Progress(
            SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
            console=console, transient=True,
        )  # fmt: skip

    def __enter__(self) -> "StageProgress":
        self._progress.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._progress.stop()

    def track(self, items: Iterable[Item], description: str) -> Iterator[Item]:
        """Yield the items and show how far along they are."""
        yield from self._progress.track(items, description=description)


def ask_operator(instruction: Mapping[str, object]) -> None:
    """Ask the person at the rig to change what is mounted, and wait for Enter."""
    wish = ", ".join(f"{name} = {value}" for name, value in instruction.items())
    console.print(f"Please mount: {wish}. Press Enter when it is done (Ctrl-C leaves the session resumable).")
    sys.stdin.readline()
