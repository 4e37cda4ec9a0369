"""The sessions of one service: a folder of them, at most one running, in a process of its own."""

import json
import logging
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rig.config import RigConfig
from rig.errors import BusyError, StateError
from rig.sessions import Action, Plan, Session, State, allowed
from service.messages import Messages
from service.problems import NotFoundError

CLOSE_TIMEOUT_S = 30.0
ENDED = (State.FINISHED, State.ABORTED, State.FAILED, State.INTERRUPTED)

log = logging.getLogger(__name__)


@dataclass
class Run:
    """One worker process, the state that it told last, and everything it told."""

    session_id: str
    process: subprocess.Popen[str]
    messages: Messages
    state: State = State.PREPARING
    listener: threading.Thread = field(init=False)

    def __post_init__(self) -> None:
        self.listener = threading.Thread(target=self._listen, daemon=True, name=f"worker of {self.session_id}")
        self.listener.start()

    @property
    def alive(self) -> bool:
        """Whether the worker still runs."""
        return self.process.poll() is None

    def tell(self, line: str) -> None:
        """One line to the worker. Raises StateError where it has just ended."""
        assert self.process.stdin is not None
        try:
            self.process.stdin.write(line + "\n")
            self.process.stdin.flush()
        except (BrokenPipeError, ValueError) as error:  # ended, or ended and closed
            raise StateError(f"session {self.session_id} has just ended; nothing was passed on.") from error

    def close_input(self) -> None:
        """To the worker this says that the service is gone."""
        assert self.process.stdin is not None
        with suppress(BrokenPipeError):  # an action that the worker did not live to read
            self.process.stdin.close()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            for line in lines:
                self._hear(line)
        code = self.process.wait()
        self.close_input()
        self.messages.add({"kind": "end", "exit_code": code})

    def _hear(self, line: str) -> None:
        try:
            message = json.loads(line)
        except ValueError:  # a library that prints; the worker must not stall because nobody reads
            log.warning("%s said: %s", self.listener.name, line.rstrip())
            return
        if message.get("state") is not None:
            self.state = State(message["state"])
        self.messages.add(message)


class SessionHost:
    """Starts workers, remembers their messages, and refuses what does not fit the state."""

    def __init__(self, config: RigConfig, folder: Path) -> None:
        self.config = config
        self.folder = folder
        self._runs: dict[str, Run] = {}
        self._lock = threading.Lock()
        folder.mkdir(parents=True, exist_ok=True)

    def ids(self) -> list[str]:
        """Every session of the folder, the one created last first."""
        # Hidden ones are on their way to become sessions.
        found = [path for path in self.folder.glob("*/session.json") if not path.parent.name.startswith(".")]
        return [path.parent.name for path in sorted(found, key=_created_ns, reverse=True)]

    def folder_of(self, session_id: str) -> Path:
        """The folder of one session. Raises NotFoundError where there is none, and for what is not a plain name."""
        if session_id not in self.ids():
            raise NotFoundError(f"no session {session_id!r}; GET /api/v1/sessions lists them.")
        return self.folder / session_id

    def open(self, session_id: str) -> Session:
        """One session by its id. Raises NotFoundError where there is none, StoreError where it is damaged."""
        return Session.open(self.folder_of(session_id))

    def start(self, plan: Plan) -> str:
        """Create a session from a plan, run it and return its id. Raises BusyError while another one runs."""
        with self._lock:
            self._check_idle()
            session_id = self._create(plan)
            self._launch(session_id)
            return session_id

    def act(self, session_id: str, action: str) -> None:
        """Pass an action on. Raises StateError that names the state and what is allowed in it."""
        with self._lock:
            with self.open(session_id) as session:
                state = self.state(session)
            if action == "acknowledge":
                if state is not State.WAITING:
                    raise StateError(f"cannot acknowledge: the session is {state}, not waiting for the operator.")
            elif Action(action) not in allowed(state):
                possible = ", ".join(allowed(state)) or "nothing"
                raise StateError(f"cannot {action} a session that is {state}; allowed now: {possible}.")
            if action == "start":
                self._check_idle()
                self._launch(session_id)
            elif (run := self._runs.get(session_id)) is not None:
                run.tell(action)
            else:
                raise StateError(f"session {session_id} is {state} in another process; act on it there.")

    def state(self, session: Session) -> State:
        """The state now, from the worker where one runs, else from the journal."""
        run = self._runs.get(session.folder.name)
        return run.state if run is not None and run.alive else session.state

    def messages(self, session_id: str, after: int) -> list[dict[str, Any]]:
        """What was told since sequence number `after`, in order; they count from 1 as long as the service lives."""
        run = self._runs.get(session_id)
        return [] if run is None else run.messages.after(after)

    def close(self) -> None:
        """End the running worker safely: it stops at the next step and leaves the rig dark and still.

        One that takes longer is told to drop its step; after that it is left to end by itself.
        """
        runs = list(self._runs.values())
        for run in runs:
            run.close_input()
        for run in runs:
            if not _ended(run):
                run.process.terminate()
                if not _ended(run):
                    log.warning("session %s still makes the rig safe, as process %d", run.session_id, run.process.pid)

    def running(self) -> str | None:
        """Id of the session that runs, if one does."""
        return next((run.session_id for run in list(self._runs.values()) if run.alive), None)

    def _check_idle(self) -> None:
        for run in self._runs.values():
            if run.state in ENDED:  # it has told its end and is closing the rig
                _ended(run)
        if (busy := self.running()) is not None:
            raise BusyError(f"session {busy} is {self._runs[busy].state}; stop it first, or wait until it is finished.")

    def _create(self, plan: Plan) -> str:
        number = len(self.ids()) + 1
        while (self.folder / f"{plan.kind}-{number:04d}").exists():
            number += 1
        with Session.create(self.folder / f"{plan.kind}-{number:04d}", plan, self.config) as session:
            return session.folder.name

    def _launch(self, session_id: str) -> None:
        messages = Messages()
        if (earlier := self._runs.get(session_id)) is not None:
            earlier.listener.join(CLOSE_TIMEOUT_S)  # its last message comes before the first new one
            messages = earlier.messages
        command = [sys.executable, "-m", "service.worker", "--session", str(self.folder / session_id)]
        # A session of its own: a Ctrl-C at the service reaches the worker as a closed input, which ends it safely.
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        run = self._runs[session_id] = Run(session_id, process, messages)
        run.tell(self.config.model_dump_json())


def _ended(run: Run) -> bool:
    """Wait a while for the worker's end."""
    with suppress(subprocess.TimeoutExpired):
        run.process.wait(CLOSE_TIMEOUT_S)
    return not run.alive


def _created_ns(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:  # taken away a moment ago
        return 0
