"""Frames that are not what was asked for and wires that fail: what is taken again, and what ends a session."""

import dataclasses

import numpy as np
import pytest
import zarr

from rig.errors import (
    FrameCheckError,
    ReadTimeoutError,
    ReplyError,
)
from rig.sessions import Runner, State
from tests.reference.dng import dng
from tests.rig.sessions.fake_rig import PLANS, config, fake_rig, is_safe, whole
from tests.rig.sessions.test_plan import changed

CONFIG = config()
SLOW = {name: {**camera, "frame_megabytes": 40.0} for name, camera in CONFIG.model_dump()["cameras"].items()}
SMALL = changed("srf", arm_deg=[-20, 30], exposures_s=[0.05, 0.2])


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


def test_a_burst_with_a_frame_missing_is_taken_again(new_session):
    session = new_session(changed("mdf", laser_azimuth_deg=[45], laser_elevations_deg=[35]))
    rig, _ = fake_rig(CONFIG)
    rig.cameras["cam1"].spoil = [lambda frames: [*frames[:2], *frames[3:]]]
    Runner(session, rig).run()
    assert ["4 frames came" in event.text for event in session.events() if event.kind == "retake"] == [True]
    assert whole(session)


def test_a_burst_keeps_the_time_of_every_frame(new_session):
    """As the frames are stamped, also where the camera was late."""
    late_s = np.array([0.0, 0.1, 0.23, 0.3, 0.45])
    session = new_session(changed("mdf", laser_azimuth_deg=[45], laser_elevations_deg=[35], cameras=["cam0"]))
    rig, _ = fake_rig(CONFIG)
    rig.cameras["cam0"].spoil = [
        lambda frames: [remade(f, taken_s=frames[0].taken_s + t) for f, t in zip(frames, late_s, strict=True)]
    ]
    Runner(session, rig).run()
    about = zarr.open_array(session.frames()[0].path, mode="r").attrs.asdict()
    assert about["times_s"] == pytest.approx(late_s)
    assert about["interval_s"] == pytest.approx(late_s[-1] / 4)


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


def test_a_tilted_board_may_turn_its_dark_side_to_a_camera(new_session):
    """On the turntable (pose 0) it may not: there a dark frame is a dead lamp."""
    session = new_session(changed("calibrate"))
    rig, _ = fake_rig(CONFIG)
    tilted = [step.mount["pose"] != 0 for step in session.steps]
    rig.cameras["cam0"].spoil = [filled(256) if apart else (lambda frames: frames) for apart in tilted]
    assert Runner(session, rig).run().state is State.FINISHED
    turned = ["turned away" in event.text for event in session.events() if event.kind == "warning"]
    assert turned == [True] * sum(tilted)
    assert not [event for event in session.events() if event.kind == "retake"]

    level = new_session(changed("calibrate"))
    rig, _ = fake_rig(CONFIG)
    rig.cameras["cam0"].spoil = [(lambda frames: frames) if apart else filled(256) for apart in tilted]
    Runner(level, rig).run()
    retakes = [event for event in level.events() if event.kind == "retake"]
    assert len(retakes) == len(tilted) - sum(tilted)


def spotted(side):
    """A dark frame with a bright square of this side, as a lamp in a mirror ball is; a hot pixel has side 1."""
    mosaic = np.full((60, 80), 256, np.uint16)
    mosaic[10 : 10 + side, 13 : 13 + side] = 2000
    data = dng(mosaic, noise_profile=(1e-4, 6.8e-8))
    return lambda frames: [remade(frame, data=data) for frame in frames]


@pytest.mark.parametrize(("side", "retakes"), [(1, 1), (2, 0)])
def test_a_spot_is_light_and_a_hot_pixel_is_none(new_session, side, retakes):
    session = new_session(SMALL)
    rig, _ = fake_rig(CONFIG)
    rig.cameras["front"].spoil = [spotted(side)]
    assert Runner(session, rig).run().state is State.FINISHED
    assert len([event for event in session.events() if event.kind == "retake"]) == retakes


def test_a_saturated_frame_is_a_warning(new_session):
    session = new_session(changed("srf", arm_deg=[-30, 30], exposures_s=[0.2]))
    rig, _ = fake_rig(CONFIG)
    rig.cameras["front"].spoil = [filled(4095), filled(4095)]
    assert Runner(session, rig).run().state is State.FINISHED
    assert ["saturated" in event.text for event in session.events() if event.kind == "warning"] == [True, True]


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
