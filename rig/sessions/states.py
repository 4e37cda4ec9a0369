"""The states of a session and the one table of what may happen in them.

The runner, the service's refusals, the page's buttons and the model-based test all read this table.
"""

import threading
from collections.abc import Callable
from enum import StrEnum

from rig.errors import StateError


class State(StrEnum):
    """Where a session stands."""

    IDLE = "idle"  # created; nothing was taken
    PREPARING = "preparing"  # dark, homing, checking
    RUNNING = "running"
    PAUSING = "pausing"  # the step under way is finished first
    PAUSED = "paused"  # dark and still, everything durable
    WAITING = "waiting"  # for the operator to mount something
    STOPPING = "stopping"  # the step under way is finished first
    ABORTING = "aborting"  # the step under way is dropped
    FINISHED = "finished"  # every step is done
    ABORTED = "aborted"  # by the operator; can be taken up again
    FAILED = "failed"  # by an error; can be taken up again
    INTERRUPTED = "interrupted"  # stopped early, Ctrl-C or a crash; can be taken up again


class Action(StrEnum):
    """What moves a session from state to state: the operator's requests, then the runner's own."""

    START = "start"
    PAUSE = "pause"
    RESUME = "resume"
    STOP = "stop"
    ABORT = "abort"
    READY = "ready"  # homed and checked
    HOLD = "hold"  # the step before the pause is finished
    WAIT = "wait"  # something is to be mounted
    MOUNTED = "mounted"
    COMPLETE = "complete"  # no step is left
    END = "end"  # what was asked for, stop or abort, is carried out
    FAIL = "fail"
    INTERRUPT = "interrupt"


REQUESTS = (Action.START, Action.PAUSE, Action.RESUME, Action.STOP, Action.ABORT)
ACTIVE = (
    State.PREPARING, State.RUNNING, State.PAUSING, State.PAUSED, State.WAITING, State.STOPPING, State.ABORTING,
)  # fmt: skip

_S, _A = State, Action
TRANSITIONS: dict[tuple[State, Action], State] = {
    (_S.IDLE, _A.START): _S.PREPARING,
    (_S.ABORTED, _A.START): _S.PREPARING,
    (_S.FAILED, _A.START): _S.PREPARING,
    (_S.INTERRUPTED, _A.START): _S.PREPARING,
    (_S.PREPARING, _A.READY): _S.RUNNING,
    (_S.PREPARING, _A.PAUSE): _S.PAUSING,
    (_S.RUNNING, _A.PAUSE): _S.PAUSING,
    (_S.RUNNING, _A.WAIT): _S.WAITING,
    (_S.RUNNING, _A.COMPLETE): _S.FINISHED,
    (_S.PAUSING, _A.READY): _S.PAUSING,
    (_S.PAUSING, _A.RESUME): _S.RUNNING,
    (_S.PAUSING, _A.HOLD): _S.PAUSED,
    (_S.PAUSING, _A.COMPLETE): _S.FINISHED,
    (_S.PAUSED, _A.RESUME): _S.RUNNING,
    (_S.WAITING, _A.MOUNTED): _S.RUNNING,
    (_S.STOPPING, _A.READY): _S.STOPPING,
    (_S.STOPPING, _A.MOUNTED): _S.STOPPING,
    (_S.STOPPING, _A.COMPLETE): _S.FINISHED,
    (_S.STOPPING, _A.END): _S.INTERRUPTED,
    (_S.ABORTING, _A.READY): _S.ABORTING,
    (_S.ABORTING, _A.MOUNTED): _S.ABORTING,
    (_S.ABORTING, _A.END): _S.ABORTED,
    **{(state, _A.STOP): _S.STOPPING for state in (_S.PREPARING, _S.RUNNING, _S.PAUSING, _S.PAUSED, _S.WAITING)},
    **{(state, _A.ABORT): _S.ABORTING for state in ACTIVE if state is not _S.ABORTING},
    **{(state, _A.FAIL): _S.FAILED for state in ACTIVE},
    **{(state, _A.INTERRUPT): _S.INTERRUPTED for state in ACTIVE},
}


def allowed(state: State) -> tuple[Action, ...]:
    """The requests that an operator may make in this state."""
    return tuple(action for action in REQUESTS if (state, action) in TRANSITIONS)


class Machine:
    """One session's state; safe to use from several threads. `on_change` is called outside of its lock."""

    def __init__(self, state: State, on_change: Callable[[State, Action], None] = lambda state, action: None) -> None:
        self._state = state
        self._changed = threading.Condition()
        self._on_change = on_change

    @property
    def state(self) -> State:
        """The state now."""
        with self._changed:
            return self._state

    def apply(self, action: Action) -> State:
        """Take the transition and return the new state. Raises StateError where the table has none."""
        with self._changed:
            if (self._state, action) not in TRANSITIONS:
                possible = ", ".join(allowed(self._state)) or "nothing"
                raise StateError(f"cannot {action} a session that is {self._state}; allowed now: {possible}.")
            before, self._state = self._state, TRANSITIONS[self._state, action]
            now = self._state
            self._changed.notify_all()
        if now is not before:
            self._on_change(now, action)
        return now

    def wait_while(self, state: State) -> State:
        """Block as long as the session is in this state; returns the next one."""
        with self._changed:
            self._changed.wait_for(lambda: self._state is not state)
            return self._state
