"""The process that runs one session: events out as JSON lines, actions in as lines, safe when either end closes.

The service starts it with `python -m service.worker --session FOLDER`, so that a driver crash never takes the service
down, and a service crash (standard input ends) never leaves a lamp on.
"""

import argparse
import json
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path

from rig.assembly import open_rig
from rig.errors import RigError, StateError
from rig.sessions import Operator, Runner, Session
from service.capture import terminate_as_interrupt
from service.problems import problem_of
from service.simulation import ControlPort


class Actions:
    """Actions that arrive on standard input; the runner is told, an operator's acknowledgement is kept."""

    def __init__(self) -> None:
        self._acknowledged = threading.Event()
        self._runner: Runner | None = None

    def follow(self, runner: Runner) -> None:
        """Start listening."""
        self._runner = runner
        threading.Thread(target=self._listen, daemon=True, name="actions").start()

    def wait_for_operator(self, instruction: Mapping[str, object]) -> None:
        """Return once somebody says that the instruction was followed."""
        self._acknowledged.clear()
        self._acknowledged.wait()

    def _listen(self) -> None:
        for line in sys.stdin:
            self._act(line.strip())
        self._act("stop")  # the service is gone: nobody watches the rig any more

    def _act(self, action: str) -> None:
        assert self._runner is not None
        known: dict[str, Callable[[], None]] = {
            "pause": self._runner.pause,
            "resume": self._runner.resume,
            "stop": self._runner.stop,
            "abort": self._runner.abort,
            "acknowledge": self._acknowledged.set,
        }
        try:
            known[action]()
        except StateError as error:
            tell({"kind": "refused", "message": str(error)})
        if action in ("stop", "abort"):
            self._acknowledged.set()


def tell(message: Mapping[str, object]) -> None:
    """One line to whoever started this process."""
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


def run(folder: Path) -> int:
    """Run the session in `folder` to its end and return the exit code."""
    actions = Actions()
    try:
        session = Session.open(folder)
        operator: Operator = actions.wait_for_operator
        if session.config.clock is not None:  # a simulated rig: its control port is the operator
            operator = ControlPort(session.config.clock.address).mount
        with terminate_as_interrupt(), open_rig(session.config) as rig:
            runner = Runner(session, rig, operator, lambda event: tell(asdict(event)))
            actions.follow(runner)
            runner.run()
    except KeyboardInterrupt:
        return 130
    except RigError as error:
        problem = problem_of(error)
        assert problem is not None
        tell({"kind": "problem", "code": problem.code, "message": str(error)})
        return problem.exit_code
    return 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--session", type=Path, required=True)
    sys.exit(run(parser.parse_args().session))
