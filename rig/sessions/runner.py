"""Runs a session: step by step, frame by frame, and to a safe end whatever happens.

One thread, the one that calls `run`, commands the devices and lets the rig's time pass; another makes frames durable.
`pause`, `resume`, `stop` and `abort` may come from any thread. An abort takes effect between two device commands: a
camera's download or an axis' arrival is not cut short.
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from rig.devices import Rig
from rig.errors import FrameCheckError, ProtocolError, StateError, StoreError, TransportError
from rig.interrupts import postponed
from rig.sessions.checks import FrameChecks
from rig.sessions.choreography import Choreography
from rig.sessions.exposure import FULL, chosen_s, shorter_test, stripe_level
from rig.sessions.forecast import Effort, effort, lower_bound_s
from rig.sessions.journal import utc_now
from rig.sessions.progress import Event, Progress
from rig.sessions.session import Session
from rig.sessions.states import Action, Machine, State
from rig.sessions.step import Mount, Step
from rig.sessions.writer import Capture, Writer

Operator = Callable[[Mapping[str, Any]], None]
RETAKES = {FrameCheckError: 2, TransportError: 1, ProtocolError: 1}


@dataclass(frozen=True, slots=True)
class RunReport:
    """How a run ended. `session_s` and `lower_bound_s` are rig time of this run's steps, without `prepare_s` (homing).

    `waited_s` is the rig time during which the operator mounted or the session was paused; it is not in `session_s`.
    `unconfirmed` has one line per device whose safe state could not be confirmed.
    """

    state: State
    done: int
    total: int
    prepare_s: float
    session_s: float
    waited_s: float
    lower_bound_s: float
    unconfirmed: tuple[str, ...]

    @property
    def overhead(self) -> float:
        """Session time over its lower bound; 1 is perfect, NaN where nothing was taken."""
        return self.session_s / self.lower_bound_s if self.lower_bound_s else float("nan")


class _HaltError(Exception):
    """Stop or abort was asked for."""


class Runner:
    """Takes the steps of a session that are not done; good for one `run`.

    `operator` is called with what has to be mounted ({"sample": ..., "pose": ..., "laser_elevation_deg": ...}) and
    returns once it is; the session is `waiting` meanwhile. A stop or abort takes effect when it returns, so an operator
    that can be told should return as soon as `state` is no longer `waiting`. `on_event` gets every event, from several
    threads but one at a time; it must not raise.
    """

    def __init__(
        self,
        session: Session,
        rig: Rig,
        operator: Operator = lambda instruction: None,
        on_event: Callable[[Event], None] = lambda event: None,
    ) -> None:
        self._session = session
        self._operator = operator
        self._progress = Progress(session, on_event)
        self._machine = Machine(session.state, self._changed)
        self._devices = Choreography(rig, self._check_abort)
        self._rig = rig
        self._checks = FrameChecks(session.config, session.steps)
        self._queue = deque(session.remaining())
        self._failures: dict[tuple[str, type[Exception]], int] = {}
        self._mounted: Mount | None = None
        self._efforts: dict[str, Effort] = {}
        self._started_s: float | None = None
        self._prepared_s = self._waited_s = 0.0
        self._writer = Writer(session.folder, self._progress.complete)
        self._message = ""

    @property
    def state(self) -> State:
        """The state now."""
        return self._machine.state

    def pause(self) -> None:
        """Finish the step under way, then hold, dark and still. Raises StateError."""
        self._machine.apply(Action.PAUSE)

    def resume(self) -> None:
        """Go on after a pause. Raises StateError."""
        self._machine.apply(Action.RESUME)

    def stop(self) -> None:
        """Finish the step under way, then end; the session can be taken up again. Raises StateError."""
        self._machine.apply(Action.STOP)

    def abort(self) -> None:
        """Drop the step under way and end; the session can be taken up again. Raises StateError."""
        self._machine.apply(Action.ABORT)

    def run(self) -> RunReport:
        """Take every remaining step; returns when all are done, or after a stop or an abort.

        Raises BusyError where another runs this session, StateError where it is finished, and whatever ended it early:
        UnknownDeviceError, LimitError or InterlockError before anything moved, FrameCheckError after two retakes,
        TransportError or ProtocolError after one, DiskFullError, KeyboardInterrupt. However it ends, lamps and laser
        are off, motion is stopped, what could not be confirmed is in the journal, and the session can be resumed.
        """
        with self._session.exclusive():
            self._machine.apply(Action.START)
            unconfirmed: list[str] = []
            ending = Action.FAIL
            try:
                with self._writer:
                    try:
                        self._prepare()
                        self._take_all()
                        ending = Action.COMPLETE
                    except _HaltError:
                        ending = Action.END
                    finally:
                        with postponed():
                            unconfirmed = self._rig.make_safe()
                    self._writer.drain()
            except BaseException as error:
                ending = Action.FAIL if isinstance(error, Exception) else Action.INTERRUPT
                self._message = str(error) or type(error).__name__
                raise
            finally:
                with postponed():
                    report = self._close(ending, unconfirmed)
        return report

    def _prepare(self) -> None:
        begun_s = self._tick()
        self._devices.check(self._session.steps)
        if self._queue:
            self._devices.prepare()
        self._prepared_s = self._tick() - begun_s
        self._started_s = begun_s + self._prepared_s
        self._progress.start()
        self._machine.apply(Action.READY)

    def _take_all(self) -> None:
        """Step by step; one that failed is taken again at once."""
        while self._queue:
            self._hold()
            step = self._queue.popleft()
            self._mount(step)
            try:
                self._take(step)
            except tuple(RETAKES) as error:
                self._take_again(step, error)
        self._writer.drain()

    def _take(self, step: Step) -> None:
        before_rad = self._devices.reported_rad
        self._progress.begin(step.id)
        self._devices.pose(step)
        self._tick()
        self._devices.expose(step)
        capture = Capture(step, utc_now(), step.axes_rad, self._devices.reported_rad)
        self._devices.see_out(step, self._next_in_view(step))
        levels, transferred = {}, {}
        for camera, frames in self._devices.fetch(step):
            shot, warnings = self._checks.take(step, camera, frames)
            for warning in warnings:
                self._progress.say("warning", warning, step.id)
            if step.test:
                levels[camera] = stripe_level(shot)
            else:
                self._writer.put(capture, shot)
            transferred[camera] = shot.transferred_bytes / 1e6 / self._session.config.cameras[camera].megabytes_per_s
        ideal = effort(step, before_rad, self._session.config)
        self._efforts[step.id] = Effort(ideal.motion_s, ideal.exposure_s, transferred)
        self._tick()
        if step.test:
            self._choose_exposure(step, levels)

    def _choose_exposure(self, test: Step, levels: Mapping[str, float]) -> None:
        """What a test sweep is for; one that was saturated is taken again with a shorter exposure."""
        camera, level = max(levels.items(), key=lambda item: item[1])
        if level >= FULL:
            again = shorter_test(test)
            saturated = f"{camera}: the stripe is saturated within {test.exposure_s:.4f} s"
            self._progress.say("retake", f"{saturated}; tested again with {again.exposure_s:.4f} s.", test.id)
            self._queue.appendleft(again)
            return
        exposure_s = chosen_s(test, level)
        reached = f"on white the stripe reaches {level * exposure_s / test.exposure_s:.0%} of full scale in {camera}"
        self._progress.choose(test, exposure_s, f"exposure {exposure_s:.4f} s chosen from a test sweep: {reached}")
        told = {step.id: step for step in self._session.steps}
        self._queue = deque(told[step.id] for step in self._queue)

    def _next_in_view(self, step: Step) -> Step | None:
        """The step to which the axes may leave already: none where the session holds or the operator comes first."""
        following = self._queue[0] if self._queue else None
        if following is None or following.mount != step.mount or self.state is not State.RUNNING:
            return None
        return following

    def _take_again(self, step: Step, error: Exception) -> None:
        kind = next(kind for kind in RETAKES if isinstance(error, kind))
        count = self._failures[step.id, kind] = self._failures.get((step.id, kind), 0) + 1
        if count > RETAKES[kind]:
            self._progress.fail(step.id, str(error))
            raise error
        problems = self._devices.drop()
        self._progress.say("retake", "; ".join([f"{error} The step is taken again.", *problems]), step.id)
        self._queue.appendleft(step)

    def _mount(self, step: Step) -> None:
        if step.mount is None or step.mount == self._mounted:
            return
        begun_s, waited_s = self._tick(), self._waited_s
        self._devices.calm()
        self._wait_state()
        asked = ", ".join(f"{key} {value}" for key, value in step.mount.items())
        self._progress.say("mount", f"mount: {asked}", step.id)
        self._operator(dict(step.mount))
        self._machine.apply(Action.MOUNTED)
        self._waited_s = waited_s + self._tick() - begun_s
        self._check_halt()
        self._mounted = step.mount
        self._progress.say("mount", f"mounted: {asked}", step.id)

    def _wait_state(self) -> None:
        """Enter `waiting`, unless a request came in the meantime: then it is honoured first."""
        while self.state is not State.WAITING:
            try:
                self._machine.apply(Action.WAIT)
            except StateError:
                self._hold()

    def _hold(self) -> None:
        """Between two steps: the place where pauses and stops take effect."""
        while self.state in (State.PAUSING, State.PAUSED):
            begun_s = self._tick()
            self._devices.calm()
            self._writer.drain()
            try:
                self._machine.apply(Action.HOLD)
            except StateError:
                continue  # resumed, stopped or aborted a moment ago
            self._machine.wait_while(State.PAUSED)
            self._waited_s += self._tick() - begun_s
        self._check_halt()

    def _check_halt(self) -> None:
        if self.state in (State.STOPPING, State.ABORTING):
            raise _HaltError

    def _check_abort(self) -> None:
        if self.state is State.ABORTING:
            raise _HaltError

    def _close(self, ending: Action, unconfirmed: list[str]) -> RunReport:
        """Write down how it ended; an end that the journal cannot take is still an end."""
        for line in unconfirmed:
            self._attempt(partial(self._progress.say, "unconfirmed", line))
        bound_s = lower_bound_s(list(self._efforts.values()))
        if self._efforts:
            self._attempt(partial(self._session.add_timing, self._session_s(), bound_s))
        self._finish(ending)
        return RunReport(
            self.state, *self._progress.count, self._prepared_s, self._session_s(), self._waited_s, bound_s,
            tuple(unconfirmed),
        )  # fmt: skip

    def _session_s(self) -> float:
        return 0.0 if self._started_s is None else self._progress.rig_s - self._started_s - self._waited_s

    def _finish(self, ending: Action) -> None:
        try:
            self._machine.apply(ending)
        except StateError:  # an abort came after the last step
            self._machine.apply(Action.END)

    @staticmethod
    def _attempt(action: Callable[[], None]) -> None:
        try:
            action()
        except StoreError:
            return  # the disk is full or gone: the session's own error says so already

    def _tick(self) -> float:
        """Note the rig's time for the events of threads that must not touch its clock."""
        self._progress.rig_s = self._devices.now_s()
        return self._progress.rig_s

    def _changed(self, state: State, action: Action) -> None:
        self._progress.change(lambda: self._machine.state, self._message or action)
