"""The runner: what it orders of the devices, what it tells, and what it lets itself be told."""

import threading
from math import degrees
from types import SimpleNamespace

import pytest

from rig.errors import (
    DeviceError,
    StateError,
)
from rig.sessions import Runner, State, forecast, progress
from rig.sessions.forecast import SHUTTER_LAG_S
from tests.rig.sessions.fake_rig import PLANS, config, fake_rig, is_safe, whole
from tests.rig.sessions.test_plan import changed

CONFIG = config()
SLOW = {name: {**camera, "frame_megabytes": 40.0} for name, camera in CONFIG.model_dump()["cameras"].items()}
SMALL = changed("srf", arm_deg=[-20, 30], exposures_s=[0.05, 0.2])


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


def test_a_burst_may_hold_one_frame(new_session):
    """A frame rate so low that the sweep fits into one interval."""
    session = new_session(changed("mdf", frame_rate_hz=1.0, laser_azimuth_deg=[45], laser_elevations_deg=[35]))
    rig, _ = fake_rig(CONFIG)
    assert Runner(session, rig).run().state is State.FINISHED
    assert {record.path.suffix for record in session.frames()} == {".zarr"}


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
