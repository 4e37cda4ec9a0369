"""The sessions of one service: a folder of them, at most one running, in a process of its own."""

import json
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rig.config import RigConfig
from rig.errors import BusyError, StateError, StoreError
from rig.sessions import Action, Plan, Session, State, allowed

CLOSE_TIMEOUT_S = 30.0
ENDED = (State.FINISHED, State.ABORTED, State.FAILED, State.INTERRUPTED)


@dataclass
class Run:
    """One worker process and everything it told."""

    session_id: str
    process: subprocess.Popen[str]
    state: State = State.PREPARING
    messages: list[dict[str, Any]] = field(default_factory=list)


class SessionHost:
    """Starts workers, remembers their messages, and refuses what does not fit the state."""

    def __init__(self, config: RigConfig, folder: Path) -> None:
        self.config = config
        self.folder = folder
        self._runs: dict[str, Run] = {}
        self._lock = threading.Lock()
        folder.mkdir(parents=True, exist_ok=True)

    def ids(self) -> list[str]:
        """Every session of the folder, newest first."""
        found = sorted(self.folder.glob("*/session.json"), key=lambda path: path.stat().st_mtime_ns, reverse=True)
        return [path.parent.name for path in found]

    def open(self, session_id: str) -> Session:
        """One session by its id. Raises StoreError where there is none, and for an id that is not a plain name."""
        if session_id not in self.ids():
            raise StoreError(f"no session {session_id!r}; GET /api/v1/sessions lists them.")
        return Session.open(self.folder / session_id)

    def start(self, plan: Plan) -> str:
        """Create a session from a plan, run it and return its id. Raises BusyError while another one runs."""
        with self._lock:
            self._check_idle()
            return self._launch(self._create(plan))

    def act(self, session_id: str, action: str) -> State:
        """Pass an action on and return the state it was accepted in. Raises StateError that names what is allowed."""
        with self._lock:
            state = self.state(session_id)
            if action == "acknowledge" and state is not State.WAITING:
                raise StateError(f"cannot acknowledge: the session is {state}, not waiting for the operator.")
            if action != "acknowledge" and Action(action) not in allowed(state):
                possible = ", ".join(allowed(state)) or "nothing"
                raise StateError(f"cannot {action} a session that is {state}; allowed now: {possible}.")
            if action == "start":
                self._check_idle()
                self._launch(session_id)
            else:
                self._tell(session_id, action)
            return state

    def state(self, session_id: str) -> State:
        """The state now, from the worker where one runs, else from the journal."""
        run = self._runs.get(session_id)
        if run is not None and run.process.poll() is None:
            return run.state
        with self.open(session_id) as session:
            return session.state

    def messages(self, session_id: str, after: int) -> list[dict[str, Any]]:
        """What was told since sequence number `after`, in order; they count from 1 as long as the service lives."""
        run = self._runs.get(session_id)
        return [] if run is None else run.messages[after:]

    def close(self) -> None:
        """End the running worker safely: it stops at the next step and leaves the rig dark and still."""
        for run in self._runs.values():
            _close_input(run)
            try:
                run.process.wait(CLOSE_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                run.process.terminate()
                run.process.wait()

    def running(self) -> str | None:
        """Id of the session that runs, if one does."""
        return next((key for key, run in self._runs.items() if run.process.poll() is None), None)

    def _check_idle(self) -> None:
        for run in self._runs.values():
            if run.state in ENDED:  # it has told its end and is closing the rig
                run.process.wait(CLOSE_TIMEOUT_S)
        if (busy := self.running()) is not None:
            raise BusyError(f"session {busy} is {self._runs[busy].state}; stop it first, or wait until it is finished.")

    def _create(self, plan: Plan) -> str:
        number = len(self.ids()) + 1
        while (self.folder / f"{plan.kind}-{number:04d}").exists():
            number += 1
        with Session.create(self.folder / f"{plan.kind}-{number:04d}", plan, self.config) as session:
            return session.folder.name

    def _launch(self, session_id: str) -> str:
        command = [sys.executable, "-m", "service.worker", "--session", str(self.folder / session_id)]
        # A session of its own: a Ctrl-C at the service reaches the worker as a closed input, which ends it safely.
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        earlier = self._runs.get(session_id)
        run = Run(session_id, process, messages=[] if earlier is None else earlier.messages)
        self._runs[session_id] = run
        threading.Thread(target=self._listen, args=(run,), daemon=True, name=f"worker of {session_id}").start()
        return session_id

    def _listen(self, run: Run) -> None:
        assert run.process.stdout is not None
        with run.process.stdout as lines:
            for line in lines:
                message = json.loads(line)
                if message.get("state") is not None:
                    run.state = State(message["state"])
                run.messages.append({"sequence": len(run.messages) + 1, **message})
        code = run.process.wait()
        _close_input(run)
        run.messages.append({"sequence": len(run.messages) + 1, "kind": "end", "exit_code": code})

    def _tell(self, session_id: str, action: str) -> None:
        run = self._runs.get(session_id)
        if run is None or run.process.stdin is None or run.process.poll() is not None:
            raise StateError(f"session {session_id} has no running worker; start it again.")
        run.process.stdin.write(action + "\n")
        run.process.stdin.flush()


def _close_input(run: Run) -> None:
    assert run.process.stdin is not None
    with suppress(BrokenPipeError):  # an action that the worker did not live to read
        run.process.stdin.close()
