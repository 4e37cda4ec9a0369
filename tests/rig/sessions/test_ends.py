"""However a run ends, the rig is safe and the session can be taken up again."""

import signal

import pytest

from rig.errors import (
    DeviceError,
    DiskFullError,
    LimitError,
    ReadTimeoutError,
    UnknownDeviceError,
)
from rig.sessions import Runner, State
from rig.sessions import store as frame_store
from tests.rig.sessions.fake_rig import PLANS, config, fake_rig, is_safe, whole
from tests.rig.sessions.test_plan import changed

CONFIG = config()
SMALL = changed("srf", arm_deg=[-20, 30], exposures_s=[0.05, 0.2])


def fail_at(step_command, error):
    """Raise at the first command that begins with these words, once."""
    left = [error]

    def act(name):
        if name.startswith(step_command) and left:
            raise left.pop()

    return act


COMMANDS = ("home arm", "move arm", "wait arm", "light led", "expose front", "fetch front")


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("error", "state"),
    [(DeviceError("stalled"), State.FAILED), (KeyboardInterrupt(), State.INTERRUPTED), (OSError("gone"), State.FAILED)],
)
def test_whatever_fails_wherever_the_rig_is_safe_and_the_session_resumes(new_session, command, error, state):
    session = new_session(SMALL)
    rig, world = fake_rig(CONFIG)
    world.on_command = fail_at(command, error)
    with pytest.raises(type(error)):
        Runner(session, rig).run()
    assert session.state is state
    assert is_safe(rig, world)
    assert Runner(session, rig).run().state is State.FINISHED
    assert whole(session)
    assert world.offences == []


@pytest.mark.parametrize("command", ["laser rewind", "laser sweep", "expose cam1", "laser stop", "fetch cam0"])
def test_an_interrupted_sweep_leaves_the_laser_off(new_session, command):
    session = new_session(PLANS["mdf"])
    rig, world = fake_rig(CONFIG)

    def interrupt_the_second(name):
        if world.commands.count(command) == 2:
            world.on_command = lambda name: None
            raise KeyboardInterrupt

    world.on_command = interrupt_the_second
    with pytest.raises(KeyboardInterrupt):
        Runner(session, rig).run()
    assert is_safe(rig, world)
    assert Runner(session, rig).run().state is State.FINISHED
    assert whole(session)


def test_ctrl_c_waits_until_the_rig_is_safe(new_session):
    """A second Ctrl-C while the lamps are being switched off must not leave the rest on."""
    session = new_session(SMALL)
    rig, world = fake_rig(CONFIG)
    exposed = []

    def press(name):
        if name == "fetch front" and not exposed:
            exposed.append(name)
            signal.raise_signal(signal.SIGINT)
        elif name == "lamps off" and exposed:
            signal.raise_signal(signal.SIGINT)

    world.on_command = press
    with pytest.raises(KeyboardInterrupt):
        Runner(session, rig).run()
    world.on_command = lambda name: None
    assert is_safe(rig, world)
    assert session.state is State.INTERRUPTED


def test_what_cannot_be_made_safe_is_told(new_session):
    session = new_session(SMALL)
    rig, world = fake_rig(CONFIG)

    def refuse(name):
        if name == "stop arm" and session.done():
            raise ReadTimeoutError("arm: no answer")

    world.on_command = refuse
    report = Runner(session, rig).run()
    assert report.unconfirmed == ("arm: unconfirmed (arm: no answer)",)
    assert world.lamps == {}
    assert [event.text for event in session.events() if event.kind == "unconfirmed"] == list(report.unconfirmed)


def test_ctrl_c_at_the_end_does_not_hide_what_could_not_be_made_safe(new_session):
    session = new_session(SMALL)
    rig, world = fake_rig(CONFIG)

    def press_and_refuse(name):
        if name == "lamps off" and len(world.exposures) == len(session.steps):
            signal.raise_signal(signal.SIGINT)
        if name == "stop arm" and world.exposures:
            raise ReadTimeoutError("arm: no answer")

    world.on_command = press_and_refuse
    with pytest.raises(KeyboardInterrupt):
        Runner(session, rig).run()
    assert [e.text for e in session.events() if e.kind == "unconfirmed"] == ["arm: unconfirmed (arm: no answer)"]


def test_ctrl_c_while_the_end_is_written_down_does_not_leave_it_out(new_session):
    session = new_session(SMALL)
    rig, world = fake_rig(CONFIG)

    def refuse(name):
        if name == "stop arm" and world.exposures:
            raise ReadTimeoutError("arm: no answer")

    def press(event):
        if event.kind == "unconfirmed":
            signal.raise_signal(signal.SIGINT)

    world.on_command = refuse
    with pytest.raises(KeyboardInterrupt):
        Runner(session, rig, on_event=press).run()
    assert session.events()[-1].text == "complete"
    assert session.state is State.FINISHED


def test_a_run_that_ended_without_a_word_is_told_by_the_next(new_session):
    session = new_session(SMALL)
    session.journal.enter_state(State.RUNNING, 1.0, "ready")
    assert session.state is State.INTERRUPTED
    assert Runner(session, fake_rig(CONFIG)[0]).run().state is State.FINISHED
    texts = [event.text for event in session.events() if event.kind == "state"]
    assert texts[:3] == ["ready", "the last run ended without a word", "start"]


def test_a_rig_that_cannot_be_made_safe_does_not_start(new_session):
    session = new_session(SMALL)
    rig, world = fake_rig(CONFIG)
    world.on_command = fail_at("lamps off", ReadTimeoutError("no answer"))
    with pytest.raises(DeviceError, match="before the session"):
        Runner(session, rig).run()
    assert not [command for command in world.commands if command.startswith(("home", "move", "light"))]


def test_a_rig_other_than_the_plans_is_refused_before_anything_moves(new_session):
    session = new_session(PLANS["btf"])
    axes = {**CONFIG.model_dump()["axes"], "turntable": {**CONFIG.model_dump()["axes"]["turntable"], "max_deg": 45}}
    lamps = {"port": "/fake/dmx", "lamp": {"lamp0": CONFIG.lamps.lamp["lamp0"].model_dump()}}
    cameras = {"cam0": CONFIG.cameras["cam0"].model_dump()}
    for settings, error in (
        (config(axes=axes), LimitError),
        (config(lamps=lamps), UnknownDeviceError),
        (config(cameras=cameras), UnknownDeviceError),
    ):
        rig, world = fake_rig(settings)
        with pytest.raises(error):
            Runner(session, rig).run()
        assert not [command for command in world.commands if command.startswith(("home", "move", "light"))]
    swept = new_session(PLANS["mdf"])
    with pytest.raises(UnknownDeviceError, match="laser"):
        Runner(swept, fake_rig(config(laser=None))[0]).run()


def test_a_full_disk_stops_cleanly_and_nothing_is_lost(new_session, monkeypatch):
    session = new_session(PLANS["btf"])
    rig, world = fake_rig(CONFIG)
    write, written = frame_store.write_file, []

    def write_until_full(path, data):
        written.append(path)
        if len(written) > 5:
            raise DiskFullError(f"{path}: the disk is full")
        return write(path, data)

    with monkeypatch.context() as patch:
        patch.setattr(frame_store, "write_file", write_until_full)
        with pytest.raises(DiskFullError):
            Runner(session, rig).run()
    assert session.state is State.FAILED
    assert is_safe(rig, world)
    assert len(session.done()) == 2
    assert session.verify() == 4
    assert Runner(session, rig).run().state is State.FINISHED
    assert whole(session)
