"""The thread that makes frames durable, and a Ctrl-C at the worst moment."""

import signal
import threading

import pytest

from rig.sessions import Session, parse_plan
from rig.sessions.checks import Shot
from rig.sessions.writer import Capture, Writer
from tests.rig.sessions.fake_rig import PLANS, config


@pytest.fixture
def session(tmp_path):
    with Session.create(tmp_path / "session", parse_plan(PLANS["srf"]), config()) as session:
        yield session


@pytest.mark.timeout(30)
def test_a_ctrl_c_within_the_queues_notification_does_not_put_the_thread_to_sleep_for_ever(session):
    """The interrupt falls between choosing the sleeper to wake and waking it: where a notification can be lost."""
    done = []
    writer = Writer(session.folder, lambda step, entries: done.append(step))
    sleepers = writer._queue.not_empty

    def interrupted_notify(count=1):
        sleeper = sleepers._waiters.popleft()
        signal.raise_signal(signal.SIGINT)
        sleeper.release()

    step = session.steps[0]
    shot = Shot(step.cameras[0], step.exposure_s, 0.0, 4, b"data", None, {})
    with writer:
        while not sleepers._waiters:  # until the thread waits for work
            threading.Event().wait(0.001)
        sleepers.notify = interrupted_notify
        with pytest.raises(KeyboardInterrupt):
            writer.put(Capture(step, "2026-01-01T00:00:00+00:00", {}, {}), shot)
        del sleepers.notify
    assert done == [step.id]
    assert not writer._thread.is_alive()
