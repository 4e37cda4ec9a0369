"""The runner: what it orders of the devices, what it checks, and how it ends."""

import dataclasses
import signal
import threading
from math import degrees
from types import SimpleNamespace

import numpy as np
import pytest

from rig.errors import (
    DeviceError,
    DiskFullError,
    FrameCheckError,
    LimitError,
    ReadTimeoutError,
    ReplyError,
    StateError,
    UnknownDeviceError,
)
from rig.sessions import Runner, Session, State, forecast, parse_plan, progress
from rig.sessions import store as frame_store
from rig.sessions.forecast import SHUTTER_LAG_S
from tests.reference.dng import dng
from tests.rig.sessions.fake_rig import PLANS, config, fake_rig, is_safe
from tests.rig.sessions.test_plan import changed

CONFIG = config()
SLOW = {name: {**camera, "frame_megabytes": 40.0} for name, camera in CONFIG.model_dump()["cameras"].items()}
SMALL = changed("srf", arm_deg=[-20, 30], exposures_s=[0.05, 0.2])


@pytest.fixture
def new_session(tmp_path):
    """Makes a session of a plan; closed at the end."""
    made = []

    def make(data, settings=CONFIG):
        made.append(Session.create(tmp_path / f"session{len(made)}", parse_plan(data), settings))
        return made[-1]

    yield make
    for session in made:
        session.close()


def whole(session):
    """Every step is done once, every frame is there once and unchanged."""
    wanted = sum(len(step.cameras) for step in session.steps)
    done = [event.step for event in session.events() if event.kind == "done"]
    return session.verify() == wanted and sorted(done) == sorted(step.id for step in session.steps)


@pytest.mark.parametrize("kind", PLANS)
def test_a_session_of_every_kind_runs_to_its_end(kind, new_session):
    session = new_session(PLANS[kind])
    rig, world = fake_rig(CONFIG)
    report = Runner(session, rig).run()
    assert report.state is session.state is State.FINISHED
    assert (report.done, report.total) == (len(session.steps),) * 2
    assert report.unconfirmed == ()
    assert world.offences == []
    assert is_safe(rig, world)
    assert whole(session)


@pytest.mark.parametrize("kind", PLANS)
def test_the_exposures_are_those_of_the_plan(kind, new_session):
    """Angles, lamps and times as ordered; a camera that photographs through a motion would have been noted."""
    session = new_session(PLANS[kind])
    rig, world = fake_rig(CONFIG)
    Runner(session, rig).run()
    wanted = [
        (camera, tuple(round(degrees(step.axes_rad[name]), 3) for name in rig.axes), step.lamps, step.exposure_s, index)
        for step in session.steps
        for camera in step.cameras
        for index in range(step.frames)
    ]
    assert world.exposures == wanted


def test_everything_is_dark_and_homed_before_the_first_move(new_session):
    session = new_session(PLANS["btf"])
    rig, world = fake_rig(CONFIG)
    world.lamps, world.laser_on = {"lamp0": 1.0}, True
    Runner(session, rig).run()
    first_move = next(i for i, command in enumerate(world.commands) if command.startswith("move"))
    before = world.commands[:first_move]
    assert [command for command in before if command.startswith("home")] == [f"home {name}" for name in rig.axes]
    assert before.index("lamps off") < before.index("home arm")
    assert before.index("laser stop") < before.index("home arm")


def test_the_session_time_is_close_to_its_lower_bound(new_session):
    """What is left over are lamp settling, the shutters' lag after sweeps, and downloads one after the other."""
    for kind, most in (("srf", 1.05), ("btf", 1.05), ("mdf", 1.1)):
        session = new_session(PLANS[kind])
        rig, _ = fake_rig(CONFIG)
        report = Runner(session, rig).run()
        assert 1.0 <= report.overhead <= most
        assert session.timing() == (report.session_s, report.lower_bound_s)
        assert report.prepare_s == pytest.approx(3.0)  # three axes, a second each


def test_axes_leave_while_long_downloads_go_on(new_session):
    """Frames of 40 MB take 2 s at 20 MB/s; every move takes longer, so that all downloads but the last are hidden."""
    settings = config(cameras=SLOW)
    session = new_session(changed("btf", lamps=["lamp0"], exposures_s=[0.1], cameras=["cam0"]), settings)
    rig, world = fake_rig(settings)
    report = Runner(session, rig).run()
    one_after_the_other = forecast(session.steps, settings).time_s
    hidden_s = (len(session.steps) - 1) * (2.0 - SHUTTER_LAG_S)
    assert report.session_s == pytest.approx(one_after_the_other - hidden_s, abs=0.1)
    assert world.offences == []


def test_events_are_numbered_and_count_down(new_session):
    session = new_session(SMALL)
    told = []
    Runner(session, fake_rig(CONFIG)[0], on_event=told.append).run()
    assert [event.number for event in told] == [event.number for event in session.events()]
    done = [event for event in told if event.kind == "done"]
    assert [event.done for event in done] == [1, 2, 3, 4]
    assert {event.total for event in told} == {4}
    assert told[0].eta_s is None
    assert done[-1].eta_s == pytest.approx(0, abs=1e-6)
    assert all(event.eta_s > 0 for event in done[:-1])
    assert [event.state for event in told if event.kind == "state"][-1] is State.FINISHED


def test_the_operator_is_asked_only_when_the_mounting_changes(new_session):
    session = new_session(changed("mdf", turntable_deg=[0, 90]))
    rig, world = fake_rig(CONFIG)
    asked = []

    def operator(instruction):
        assert runner.state is State.WAITING
        assert is_safe(rig, world)
        world.time_s += 60.0
        asked.append(instruction)

    runner = Runner(session, rig, operator)
    report = runner.run()
    assert asked == [{"sample": "brick", "laser_elevation_deg": 35}, {"sample": "brick", "laser_elevation_deg": 50}]
    assert report.waited_s == pytest.approx(120.0, abs=1.0)
    assert report.overhead < 1.1


def test_the_time_left_does_not_grow_with_the_operators_pause(new_session, monkeypatch):
    """An hour of mounting between two sweeps says nothing about the sweeps; the wall's time is the rig's here."""
    session = new_session(PLANS["mdf"])
    rig, world = fake_rig(CONFIG)
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: world.time_s))

    def operator(instruction):
        world.time_s += 3600.0

    told = []
    Runner(session, rig, operator, told.append).run()
    most_s = max(event.eta_s for event in told if event.eta_s is not None)
    assert 0 < most_s < 360.0  # the sweeps take 12 s in all; the writer may tell of the first when the last is taken


def test_what_was_not_mounted_is_not_told_as_mounted(new_session):
    session = new_session(SMALL)

    def operator(instruction):
        runner.abort()

    runner = Runner(session, fake_rig(CONFIG)[0], operator)
    assert runner.run().state is State.ABORTED
    assert [event.text for event in session.events() if event.kind == "mount"] == ["mount: sample sphere"]


@pytest.mark.parametrize("kind", PLANS)
def test_the_operator_never_reaches_into_a_lit_or_moving_rig(new_session, kind):
    session = new_session(PLANS[kind])
    rig, world = fake_rig(CONFIG)
    safe = []
    Runner(session, rig, lambda instruction: safe.append(is_safe(rig, world))).run()
    assert safe
    assert all(safe)


def test_an_operator_who_gives_up_ends_the_session_safely(new_session):
    session = new_session(SMALL)
    rig, world = fake_rig(CONFIG)

    def operator(instruction):
        raise DeviceError("the sphere fell down")

    with pytest.raises(DeviceError, match="fell down"):
        Runner(session, rig, operator).run()
    assert session.state is State.FAILED
    assert is_safe(rig, world)
    assert session.events()[-1].text == "the sphere fell down"


# --- frames that are not what was asked for ---


def remade(frame, **changes):
    return dataclasses.replace(frame, **changes)


def truncated(frames):
    return [remade(frame, data=frame.data[: len(frame.data) // 2]) for frame in frames]


def filled(value):
    def spoil(frames):
        data = dng(np.full((24, 32), value, np.uint16), noise_profile=(1e-4, 6.8e-8))
        return [remade(frame, data=data) for frame in frames]

    return spoil


SPOILERS = {
    "wrong camera": (lambda frames: [remade(f, serial="VC-0005") for f in frames], "expected serial DS-0001"),
    "wrong exposure": (lambda frames: [remade(f, exposure_s=f.exposure_s * 1.3) for f in frames], "asked for"),
    "truncated": (truncated, "not a whole raw image"),
    "no image": (lambda frames: [remade(f, data=b"<html>busy</html>") for f in frames], "not a whole raw image"),
    "empty": (lambda frames: [remade(f, data=b"") for f in frames], "not a whole raw image"),
    "no frame": (lambda frames: [], "0 frames came"),
    "one too many": (lambda frames: [*frames, frames[0]], "2 frames came"),
    "dark": (filled(256), "no light of led"),
}


@pytest.mark.parametrize(("spoil", "says"), SPOILERS.values(), ids=SPOILERS.keys())
def test_a_wrong_frame_is_taken_again(new_session, spoil, says):
    session = new_session(SMALL)
    rig, _ = fake_rig(CONFIG)
    rig.cameras["front"].spoil = [spoil, spoil]
    assert Runner(session, rig).run().state is State.FINISHED
    retakes = [event.text for event in session.events() if event.kind == "retake"]
    assert len(retakes) == 2
    assert all(says in text for text in retakes)
    assert session.journal.attempts(session.steps[0].id) == 3
    assert whole(session)


@pytest.mark.parametrize(("spoil", "says"), SPOILERS.values(), ids=SPOILERS.keys())
def test_a_frame_that_stays_wrong_fails_the_session_and_can_be_taken_later(new_session, spoil, says):
    session = new_session(SMALL)
    rig, world = fake_rig(CONFIG)
    rig.cameras["front"].spoil = [spoil] * 3
    with pytest.raises(FrameCheckError, match=says):
        Runner(session, rig).run()
    assert session.state is State.FAILED
    assert is_safe(rig, world)
    failed = [event for event in session.events() if event.kind == "failed"]
    assert [event.step for event in failed] == [session.steps[0].id]
    assert Runner(session, rig).run().state is State.FINISHED
    assert whole(session)


def test_a_frozen_camera_is_found(new_session):
    """The second step's frame is the first one's again, with another file around it."""
    session = new_session(changed("srf", arm_deg=[-20, 30], exposures_s=[0.2]))
    rig, _ = fake_rig(CONFIG)
    kept = []

    def keep(frames):
        kept.extend(frames)
        return frames

    rig.cameras["front"].spoil = [keep, lambda frames: [remade(frames[0], data=kept[0].data + b"\0")]]
    Runner(session, rig).run()
    assert ["frozen" in event.text for event in session.events() if event.kind == "retake"] == [True]


def test_a_frozen_burst_is_found(new_session):
    session = new_session(changed("mdf", laser_azimuth_deg=[45], laser_elevations_deg=[35]))
    rig, _ = fake_rig(CONFIG)
    rig.cameras["cam1"].spoil = [lambda frames: [frames[0], frames[0], *frames[2:]]]
    Runner(session, rig).run()
    assert ["frozen" in event.text for event in session.events() if event.kind == "retake"] == [True]
    assert whole(session)


def test_a_dead_lamp_fails_the_session_by_name(new_session):
    session = new_session(SMALL)
    rig, world = fake_rig(CONFIG)
    world.dead_lamps = {"led"}
    with pytest.raises(FrameCheckError, match="no light of led"):
        Runner(session, rig).run()
    assert is_safe(rig, world)


def test_a_short_exposure_may_be_dark(new_session):
    """0.1 ms carry less than the read noise: a warning, because the longer exposure of the same light is fine."""
    session = new_session(changed("srf", arm_deg=[30], exposures_s=[0.0001, 0.2]))
    assert Runner(session, fake_rig(CONFIG)[0]).run().state is State.FINISHED
    assert ["no light" in event.text for event in session.events() if event.kind == "warning"] == [True]


def test_a_saturated_frame_is_a_warning(new_session):
    session = new_session(changed("srf", arm_deg=[-30, 30], exposures_s=[0.2]))
    rig, _ = fake_rig(CONFIG)
    rig.cameras["front"].spoil = [filled(4095), filled(4095)]
    assert Runner(session, rig).run().state is State.FINISHED
    assert ["saturated" in event.text for event in session.events() if event.kind == "warning"] == [True, True]


# --- what devices may raise ---


def raising(error, times):
    left = [error] * times

    def act(name):
        if name.startswith("fetch") and left:
            raise left.pop()

    return act


@pytest.mark.parametrize("error", [ReadTimeoutError("cam0: no answer"), ReplyError("cam0: device busy")])
def test_a_failing_wire_is_tried_once_more(new_session, error):
    session = new_session(PLANS["btf"])
    rig, world = fake_rig(CONFIG)
    world.on_command = raising(error, 1)
    assert Runner(session, rig).run().state is State.FINISHED
    assert whole(session)
    assert world.offences == []


def test_a_retake_trusts_neither_light_nor_pose(new_session):
    """Whatever broke the first attempt may have switched a lamp off or moved an axis."""
    session = new_session(SMALL)
    rig, world = fake_rig(CONFIG)
    broken = []

    def break_everything(name):
        if name == "fetch front" and not broken:
            broken.append(name)
            world.lamps = {}
            rig.axes["arm"].target_rad = 1.0
            raise ReadTimeoutError("front: no answer")

    world.on_command = break_everything
    Runner(session, rig).run()
    first, second, *_ = world.exposures
    assert second == first


def test_axes_that_left_for_the_next_pose_arrive_before_they_come_back(new_session):
    """The first frame's download fails when the axes are on their way already."""
    settings = config(cameras=SLOW)
    session = new_session(changed("btf", lamps=["lamp0"], exposures_s=[0.1], cameras=["cam0"]), settings)
    rig, world = fake_rig(settings)
    world.on_command = raising(ReadTimeoutError("cam0: no answer"), 1)
    assert Runner(session, rig).run().state is State.FINISHED
    assert whole(session)
    assert world.offences == []


@pytest.mark.parametrize("error", [ReadTimeoutError("cam0: no answer"), ReplyError("cam0: device busy")])
def test_a_dead_wire_fails_the_session(new_session, error):
    session = new_session(PLANS["btf"])
    rig, world = fake_rig(CONFIG)
    world.on_command = raising(error, 2)
    with pytest.raises(type(error)):
        Runner(session, rig).run()
    assert session.state is State.FAILED
    assert is_safe(rig, world)


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


# --- requests from other threads ---


def at_done(count, action):
    """An on_event that acts once when so many steps are done."""
    acted = []

    def act(event):
        if event.kind == "done" and event.done == count and not acted:
            acted.append(event)
            action()

    return act


def test_a_stopped_session_keeps_what_it_has_and_goes_on(new_session):
    session = new_session(PLANS["btf"])
    rig, world = fake_rig(CONFIG)
    runner = Runner(session, rig, on_event=at_done(3, lambda: runner.stop()))
    report = runner.run()
    assert report.state is session.state is State.INTERRUPTED
    assert 3 <= report.done < report.total
    assert is_safe(rig, world)
    taken = len(world.exposures)
    assert Runner(session, rig).run().state is State.FINISHED
    assert len(world.exposures) - taken == 2 * (report.total - report.done)
    assert whole(session)


def test_an_aborted_session_drops_the_step_under_way(new_session):
    session = new_session(PLANS["btf"])
    rig, world = fake_rig(CONFIG)
    runner = Runner(session, rig)

    def abort_in_an_exposure(name):
        if name == "fetch cam1" and len(session.done()) == 2:
            world.on_command = lambda name: None
            runner.abort()

    world.on_command = abort_in_an_exposure
    report = runner.run()
    assert report.state is session.state is State.ABORTED
    assert is_safe(rig, world)
    assert Runner(session, rig).run().state is State.FINISHED
    assert whole(session)


def test_a_long_exposure_is_aborted_within_a_second(new_session):
    session = new_session(changed("btf", exposures_s=[600.0], cameras=["cam0"]))
    rig, world = fake_rig(CONFIG)
    runner = Runner(session, rig)
    sleep, begun_s = rig.clock.sleep, []

    def abort_while_exposing(seconds):
        if world.exposures and not begun_s:
            begun_s.append(world.time_s)
            runner.abort()
        sleep(seconds)

    rig.clock.sleep = abort_while_exposing
    assert runner.run().state is State.ABORTED
    assert world.time_s - begun_s[0] < 1.0


def test_while_paused_the_rig_is_dark_and_everything_is_on_disk(new_session):
    session = new_session(PLANS["btf"])
    rig, world = fake_rig(CONFIG)
    paused = threading.Event()

    def watch(event):
        if event.kind == "done" and event.done == 2:
            runner.pause()
        if event.state is State.PAUSED:
            paused.set()

    runner = Runner(session, rig, on_event=watch)
    reports = []
    thread = threading.Thread(target=lambda: reports.append(runner.run()))
    thread.start()
    assert paused.wait(20)
    assert is_safe(rig, world)
    assert session.state is State.PAUSED
    begun = {event.step for event in session.events() if event.kind == "step"}
    assert begun == session.done()
    assert session.verify() == 2 * len(begun)
    with pytest.raises(StateError, match=r"paused; allowed now: resume, stop, abort"):
        runner.pause()
    runner.resume()
    thread.join(20)
    assert reports[0].state is State.FINISHED
    assert whole(session)


# --- the disk ---


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


def test_a_burst_may_hold_one_frame(new_session):
    """A frame rate so low that the sweep fits into one interval."""
    session = new_session(changed("mdf", frame_rate_hz=1.0, laser_azimuth_deg=[45], laser_elevations_deg=[35]))
    rig, _ = fake_rig(CONFIG)
    assert Runner(session, rig).run().state is State.FINISHED
    assert {record.path.suffix for record in session.frames()} == {".zarr"}
