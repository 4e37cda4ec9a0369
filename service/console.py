"""What the command line shows: progress with time left, one clear line per error, exit codes that scripts can use."""

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Self, TypeVar

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn

from rig.errors import StateError
from rig.sessions import Event
from service.problems import EXIT_CODES, problem_of

console = Console(stderr=True, highlight=False)
INTERRUPTED = 130
SAFE = "Interrupted: lamps and laser are off. `rig resume SESSION` goes on."
NOTABLE = ("retake", "warning", "failed", "unconfirmed")
EXIT_EPILOG = "Exit codes: " + "; ".join(f"{code} {meaning}" for code, meaning in EXIT_CODES.items()) + "."

Item = TypeVar("Item")


@contextmanager
def reported_errors(interrupted: str = "Interrupted.") -> Iterator[None]:
    """Turn every expected error into one line and its exit code; a defect keeps its traceback."""
    try:
        yield
    except KeyboardInterrupt as interrupt:
        console.print(interrupted, style="yellow")
        raise typer.Exit(INTERRUPTED) from interrupt
    except Exception as error:
        problem = problem_of(error)
        if problem is None:
            raise
        console.print(f"{problem.code}: {error}", style="red", soft_wrap=True, markup=False)
        raise typer.Exit(problem.exit_code) from error


def tell(line: str) -> None:
    """A line of the result, on standard output; everything else goes to standard error."""
    typer.echo(line)


class ConsoleProgress:
    """Bars with the time left, on standard error: of a computation's parts, and of a session's steps."""

    def __init__(self) -> None:
        self._progress = Progress(
            SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
            TextColumn("{task.fields[left]}"), console=console, transient=True,
            disable=not console.is_terminal,  # else it leaves blank lines in a script's log
        )  # fmt: skip

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def track(self, items: Iterable[Item], description: str) -> Iterator[Item]:
        """Yield the items and show how far along they are."""
        listed = list(items)
        task = self._progress.add_task(description, total=len(listed), left="")
        started_s = time.monotonic()
        for done, item in enumerate(listed):
            yield item
            left_s = (time.monotonic() - started_s) / (done + 1) * (len(listed) - done - 1)
            self._progress.update(task, completed=done + 1, left=f"{left_s:.0f} s left")
        self._progress.remove_task(task)

    def note(self, text: str) -> None:
        """A line beside the bars."""
        console.print(text, style="yellow", soft_wrap=True, markup=False)

    def follow(self, description: str) -> Callable[[Event], None]:
        """A new bar that shows a session's events; what an operator must know is also printed."""
        task = self._progress.add_task(description, total=None, left="")

        def show(event: Event) -> None:
            left = "" if event.eta_s is None else f"{event.eta_s:.0f} s left"
            text = f"{description}: {event.state}"
            self._progress.update(task, completed=event.done, total=event.total, left=left, description=text)
            if event.kind in NOTABLE or (event.kind == "done" and event.message):
                console.print(f"{event.kind}: {event.step or ''} {event.message}", style="yellow", markup=False)

        return show


def ask_operator(instruction: Mapping[str, object]) -> None:
    """Ask the person at the rig to change what is mounted, and wait for Enter.

    Raises StateError where nobody can answer: to go on unasked would photograph the wrong thing.
    """
    wish = ", ".join(f"{name} = {value}" for name, value in instruction.items())
    console.print(f"Please mount: {wish}. Press Enter when it is done (Ctrl-C leaves the session resumable).")
    if not sys.stdin.readline():
        raise StateError(f"nobody answers at the terminal, and somebody has to mount: {wish}. Nothing was taken of it.")
