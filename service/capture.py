"""Running a session: the plan becomes a folder, the folder runs on a rig, and every end is a safe one."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from rig.assembly import open_rig
from rig.config import RigConfig
from rig.sessions import Event, Operator, Plan, Runner, RunReport, Session, schedule


def capture(
    plan: Plan, config: RigConfig, folder: Path, *, operator: Operator, on_event: Callable[[Event], None]
) -> RunReport:
    """Create the session folder and run all of its steps.

    Raises what the rig raises; whatever ends it, lamps and laser are off, and `resume` takes it up again. A plan that
    cannot be carried out touches neither rig nor disk, and a rig that cannot be opened leaves no folder.
    """
    schedule(plan, config)
    with terminate_as_interrupt(), open_rig(config) as rig, Session.create(folder, plan, config) as session:
        return Runner(session, rig, operator, on_event).run()


def resume(session: Session, config: RigConfig, *, operator: Operator, on_event: Callable[[Event], None]) -> RunReport:
    """Run the steps of a session that are not done yet."""
    with terminate_as_interrupt(), open_rig(config) as rig:
        return Runner(session, rig, operator, on_event).run()


@contextmanager
def terminate_as_interrupt() -> Iterator[None]:
    """Within the context a SIGTERM is a Ctrl-C, so that both take the way that leaves the rig safe.

    So is a terminal that is closed (SIGHUP), unless the process was told to outlive it, as `nohup` does.
    """

    def interrupt(signal_number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    def terminate(signal_number: int, frame: FrameType | None) -> None:
        signal.raise_signal(signal.SIGTERM)  # to whoever handles it now

    handlers = {signal.SIGTERM: interrupt, signal.SIGHUP: terminate}
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        del handlers[signal.SIGHUP]
    previous = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
