"""The process that runs one session: events out as JSON lines, actions in as lines, safe when either end closes.

The service starts it with `python -m service.worker --session FOLDER`, so that a driver crash never takes the service
down, and a service crash (standard input ends) never leaves a lamp on. The first line in is the rig's configuration:
a session may be taken up on a rig whose devices are reached elsewhere now.
"""

import argparse
import json
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

from rig.assembly import open_rig
from rig.config import RigConfig
from rig.errors import StateError
from rig.sessions import Event, Runner, Session, State
from service.capture import terminate_as_interrupt
from service.problems import DEFECT, problem_of
from service.simulation import mount_at

_telling = threading.Lock()


class Actions:
    """Actions that arrive on standard input; the runner is told, an operator's acknowledgement is kept."""

    def __init__(self) -> None:
        self.runner: Runner | None = None
        self._acknowledged = threading.Event()

    def show(self, event: Event) -> None:
        """Tell an event, and be ready beforehand for what may be answered to it."""
        if event.kind == "state" and event.state is State.PREPARING:
            # Not before: a runner that has not started yet would refuse a stop, and go on.
            threading.Thread(target=self._listen, daemon=True, name="actions").start()
        if event.kind == "state" and event.state is State.WAITING:
            self._acknowledged.clear()
        tell(asdict(event))

    def wait_for_operator(self, instruction: Mapping[str, object]) -> None:
        """Return once somebody says that the instruction was followed, or that the session is to end."""
        self._acknowledged.wait()

    def _listen(self) -> None:
        for line in sys.stdin:
            self._act(line.strip())
        self._act("stop")  # the service is gone: nobody watches the rig any more

    def _act(self, action: str) -> None:
        assert self.runner is not None
        known: dict[str, Callable[[], None]] = {
            "pause": self.runner.pause,
            "resume": self.runner.resume,
            "stop": self.runner.stop,
            "abort": self.runner.abort,
            "acknowledge": self._acknowledged.set,
        }
        try:
            known[action]()
        except StateError as error:
            tell({"kind": "refused", "message": str(error)})
        if action in ("stop", "abort"):
            self._acknowledged.set()


def tell(message: Mapping[str, object]) -> None:
    """One line to whoever started this process; where nobody is left to read it, its end of the input says so too."""
    with _telling, suppress(BrokenPipeError):
        sys.stdout.write(json.dumps(message) + "\n")
        sys.stdout.flush()


def run(folder: Path, config: RigConfig) -> int:
    """Run the session in `folder` to its end and return the exit code."""
    actions = Actions()
    # At a simulated rig its control port is the operator.
    operator = actions.wait_for_operator if config.clock is None else mount_at(config.clock.address)
    try:
        with Session.open(folder) as session, terminate_as_interrupt(), open_rig(config) as rig:
            actions.runner = Runner(session, rig, operator, actions.show)
            actions.runner.run()
    except KeyboardInterrupt:
        return 130
    except Exception as error:
        problem = problem_of(error)
        tell({"kind": "problem", "code": (problem or DEFECT).code, "message": str(error)})
        if problem is None:
            raise
        return problem.exit_code
    return 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--session", type=Path, required=True)
    folder = parser.parse_args().session
    first_line = sys.stdin.readline()
    sys.exit(run(folder, RigConfig.model_validate_json(first_line)) if first_line else 0)
