"""What a session says while it runs: numbered events, each of them in the journal before anybody hears of it."""

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from rig.errors import StoreError
from rig.sessions.journal import FrameEntry
from rig.sessions.session import Session
from rig.sessions.states import State
from rig.sessions.step import Step


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened in a session.

    `number` grows over all runs of the session; 0 where the journal could not take it. `kind`: 'state', 'step' (begun),
    'done' (of a test sweep: with the exposure that it chose as its message), 'retake', 'warning', 'mount', 'failed',
    'unconfirmed'. `done` of `total` steps are durable; `eta_s` is the wall time left by the pace so far, without pauses
    and mounting; None before there is a pace. `step` is a step's id where the event is about one. `rig_s` is the rig
    clock's time.
    """

    number: int
    kind: str
    state: State
    done: int
    total: int
    eta_s: float | None
    step: str | None
    message: str
    rig_s: float


class Progress:
    """Numbers and publishes the events of one run. `on_event` is called by several threads, but one at a time."""

    def __init__(self, session: Session, on_event: Callable[[Event], None]) -> None:
        self._session = session
        self._on_event = on_event
        self._lock = threading.RLock()
        self._done = set(session.done())
        self._total = len(session.steps)
        remaining = session.remaining()
        self._step_s: Mapping[str, float] = {
            step.id: time_s for step, time_s in zip(remaining, session.forecast().step_s, strict=True)
        }
        self._left_s = sum(self._step_s.values())
        self._past_s = 0.0
        self._started_s = time.monotonic()
        self._held_since_s: float | None = None
        self.state = session.state
        self.rig_s = 0.0

    @property
    def count(self) -> tuple[int, int]:
        """Steps that are done, and all of them."""
        with self._lock:
            return len(self._done), self._total

    def start(self) -> None:
        """Measure the pace from now on."""
        self._started_s = time.monotonic()

    def say(self, kind: str, message: str, step: str | None = None) -> None:
        """Journal it, then publish it."""
        with self._lock:
            number = self._session.journal.record(kind, message, self.rig_s, step)
            self._publish(number, kind, message, step)

    def change(self, current: Callable[[], State], message: str) -> None:
        """Tell the state that the session is in now; several threads may have changed it since.

        Where the disk is full the state still changes, unjournalled: reopening then finds a crash.
        """
        with self._lock:
            state = current()
            if state is self.state:
                return
            self.state = state
            self._note_hold(state in (State.PAUSED, State.WAITING))
            try:
                number = self._session.journal.enter_state(state, self.rig_s, message)
            except StoreError:
                number = 0
            self._publish(number, "state", message, None)

    def begin(self, step: str) -> None:
        """Journal the intent to take a step."""
        with self._lock:
            self._publish(self._session.journal.begin(step, self.rig_s, ""), "step", "", step)

    def fail(self, step: str, reason: str) -> None:
        """Journal that a step failed."""
        with self._lock:
            self._publish(self._session.journal.fail(step, self.rig_s, reason), "failed", reason, step)

    def complete(self, step: str, frames: Sequence[FrameEntry]) -> None:
        """Journal that a step is done, with its durable frames. Under one lock, so that numbers are told in order."""
        with self._lock:
            self._count(step, self._session.journal.complete(step, frames, self.rig_s, ""), "")

    def choose(self, test: Step, exposure_s: float, message: str) -> None:
        """Journal that a test sweep is done, with the exposure that it chose."""
        with self._lock:
            self._count(test.id, self._session.choose_exposure(test, exposure_s, self.rig_s, message), message)

    def _count(self, step: str, number: int, message: str) -> None:
        self._done.add(step)
        self._past_s += self._step_s.get(step, 0.0)
        self._left_s -= self._step_s.get(step, 0.0)
        self._publish(number, "done", message, step)

    def _note_hold(self, holds: bool) -> None:
        """What passes while the session is paused or waits for the operator says nothing about its pace."""
        now_s = time.monotonic()
        if self._held_since_s is not None:
            self._started_s += now_s - self._held_since_s
        self._held_since_s = now_s if holds else None

    def _publish(self, number: int, kind: str, message: str, step: str | None) -> None:
        self._on_event(
            Event(number, kind, self.state, len(self._done), self._total, self._eta_s(), step, message, self.rig_s)
        )

    def _eta_s(self) -> float | None:
        if self._past_s <= 0:
            return None
        until_s = time.monotonic() if self._held_since_s is None else self._held_since_s
        pace = (until_s - self._started_s) / self._past_s
        return max(self._left_s, 0.0) * pace
