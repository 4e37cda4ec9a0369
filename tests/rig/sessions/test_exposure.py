"""Laser sweeps whose exposure a test sweep chooses: how bright they get, what is kept, and what cannot be measured."""

from dataclasses import replace

import numpy as np
import pytest
import zarr
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rig.errors import DeviceError, FrameCheckError, ReadTimeoutError
from rig.sessions import Runner, Session, State, describe, expand, forecast, parse_plan
from rig.sessions.checks import Shot
from rig.sessions.exposure import FULL, LONGEST, TARGET, chosen_s, shorter_test, stripe_level, with_tests
from rig.sessions.plan import EXPOSURE_STEP_S
from tests.rig.sessions.fake_rig import BLACK, MDF, UNTOLD_MDF, WHITE, config, fake_rig, is_safe, whole

CONFIG = config()
RANGE_DN = WHITE - BLACK
ONE = {**UNTOLD_MDF, "laser_azimuth_deg": [45], "laser_elevations_deg": [35]}
TEST, SWEEP = expand(parse_plan(ONE), CONFIG)


def shot(burst):
    return Shot("cam0", 0.01, 0.0, 0, None, np.asarray(burst, np.uint16), {"black_dn": BLACK, "white_dn": WHITE})


def sweep_of(levels_dn, rest_dn=0.0):
    """A burst in which a stripe of these counts over black passes every pixel of a picture once."""
    levels = np.asarray(levels_dn, float)
    frames = np.full((4, *levels.shape), float(BLACK + rest_dn))
    for index in range(4):
        columns = slice(index * levels.shape[1] // 4, (index + 1) * levels.shape[1] // 4)
        frames[index, :, columns] += levels[:, columns]
    return shot(np.clip(np.rint(frames), 0, WHITE))


# ---- steps --------------------------------------------------------------------------------------------------------


def test_every_mounting_begins_with_a_test_in_its_first_pose():
    plan = {**UNTOLD_MDF, "turntable_deg": [0, 90]}
    steps = expand(parse_plan(plan), CONFIG)
    assert [step.test for step in steps] == [True, *[False] * 4] * 2
    for test, first in zip(steps[::5], steps[1::5], strict=True):
        assert (test.pose, test.mount, test.cameras, test.sweep) == (first.pose, first.mount, first.cameras, True)
        assert test.id == f"{first.id}_test"
        assert test.frames < first.frames
        assert test.duration_s <= first.duration_s
    told = expand(parse_plan({**plan, "exposure_s": 0.02}), CONFIG)
    assert [f"{step.id}_0.0200s" for step in steps if not step.test] == [step.id for step in told]


def test_what_is_not_kept_takes_time_but_no_disk():
    untold, told = (forecast(expand(parse_plan(plan), CONFIG), CONFIG) for plan in (UNTOLD_MDF, MDF))
    assert (untold.frames, untold.bytes, untold.mounts) == (told.frames, told.bytes, told.mounts)
    assert untold.steps == told.steps + 2
    assert untold.time_s > told.time_s + 2 * 0.5  # a sweep of 20 ticks at 40 a second


def test_a_dry_run_tells_the_test_from_the_sweep():
    assert "test sweep" in describe(TEST)
    assert "test sweep" not in describe(SWEEP)


def test_no_sweep_no_test():
    assert with_tests(()) == ()


# ---- levels -------------------------------------------------------------------------------------------------------


@given(st.floats(0.02, 0.9), st.integers(0, 3), st.floats(0.03, 1.0))
@settings(max_examples=30, deadline=None)
def test_the_level_is_that_of_the_brightest_colour_on_white(share, place, white):
    """Whichever colour of the mosaic the laser has, and however much more than a hundredth of the picture is white."""
    levels = np.zeros((40, 80))
    levels[place // 2 :: 2, place % 2 :: 2] = share * RANGE_DN
    brown = np.random.default_rng(1).permuted(np.arange(levels.size) / levels.size).reshape(levels.shape) > white
    levels[brown] *= 0.3
    assert stripe_level(sweep_of(levels)) == pytest.approx(share, abs=1 / RANGE_DN)


def test_glints_and_hot_pixels_do_not_count():
    levels = np.full((40, 80), 0.4 * RANGE_DN)
    levels[::40, ::20] = RANGE_DN  # one in two hundred of one colour
    assert stripe_level(sweep_of(levels)) == pytest.approx(0.4, abs=1e-3)
    burst = sweep_of(np.full((40, 80), 0.4 * RANGE_DN)).burst
    burst[:, ::40, ::20] = WHITE
    assert stripe_level(shot(burst)) == pytest.approx(0.4, abs=1e-3)


def test_a_saturated_stripe_has_a_full_level():
    assert stripe_level(sweep_of(np.full((8, 16), 3 * RANGE_DN))) >= FULL


@pytest.mark.parametrize(("stripe_dn", "room_dn"), [(0, 1000), (500, 1000), (0, 0), (5, -10)])
def test_a_room_brighter_than_the_stripe_and_no_stripe_are_errors(stripe_dn, room_dn):
    """Also where not even the black level is reached: no exposure follows from a level of nothing."""
    burst = sweep_of(np.full((40, 80), float(stripe_dn)), room_dn)
    with pytest.raises(FrameCheckError, match="cam0: no stripe passes"):
        stripe_level(burst)


@given(st.floats(1e-4, FULL), st.floats(1e-4, 600 / 4))
@example(0.9162064850218871, 0.1)
def test_the_chosen_exposure_meets_the_target_or_is_the_longest(level, interval_s):
    """To the nearest of the exposures that a camera can be told, the shortest at least."""
    test, _ = with_tests([replace(SWEEP, interval_s=interval_s)])
    exposure_s, half_s = chosen_s(test, level), 0.5 * EXPOSURE_STEP_S + 1e-6
    meeting_s = test.exposure_s * TARGET / level
    assert exposure_s == pytest.approx(max(min(meeting_s, LONGEST * interval_s), EXPOSURE_STEP_S), abs=half_s)


def test_shorter_tests_end_at_the_shortest_exposure():
    test = TEST
    while test.exposure_s > EXPOSURE_STEP_S:
        again = shorter_test(test)
        assert again.exposure_s < test.exposure_s
        test = again
    with pytest.raises(DeviceError, match=r"cam0, cam1 even within 0\.0001 s"):
        shorter_test(test)


# ---- sessions -----------------------------------------------------------------------------------------------------


def reached(session):
    """The share of full scale that the brightest pixels of every kept burst reach."""
    return [(zarr.open_array(r.path, mode="r")[:].max() - BLACK) / RANGE_DN for r in session.frames()]


@pytest.mark.parametrize("laser_dn_s", [60e3, 250e3, 1e6, 5e6])
def test_the_stripe_peaks_under_saturation_however_bright_the_laser(new_session, laser_dn_s):
    session = new_session(UNTOLD_MDF)
    rig, world = fake_rig(CONFIG)
    world.laser_dn_s = laser_dn_s
    told = []
    report = Runner(session, rig, on_event=told.append).run()
    assert (report.state, report.done, report.total) == (State.FINISHED, 6, 6)
    assert all(0.6 < level < 0.8 for level in reached(session))
    assert whole(session)
    assert is_safe(rig, world)
    chosen = [event.message for event in told if event.kind == "done" and event.message]
    assert len(chosen) == 2
    assert all(f"exposure {session.steps[1].exposure_s:.4f} s chosen from a test sweep" in text for text in chosen)
    assert not list(session.folder.glob("frames/*test*"))


def test_a_weak_laser_gets_the_longest_exposure(new_session):
    session = new_session(ONE)
    Runner(session, fake_rig(CONFIG)[0]).run()
    assert session.steps[1].exposure_s == pytest.approx(LONGEST / UNTOLD_MDF["frame_rate_hz"])


def test_every_mounting_has_its_own_exposure(new_session):
    session = new_session(UNTOLD_MDF)
    rig, world = fake_rig(CONFIG)

    def operator(mount):
        world.laser_dn_s = {35: 60e3, 50: 120e3}[mount["laser_elevation_deg"]]

    Runner(session, rig, operator).run()
    low, high = (
        {step.exposure_s for step in session.steps if step.mount["laser_elevation_deg"] == angle and not step.test}
        for angle in (35, 50)
    )
    assert len(low) == len(high) == 1
    assert low.pop() == pytest.approx(2 * high.pop(), abs=2 * EXPOSURE_STEP_S)


def test_the_dimmer_camera_does_not_decide(new_session):
    """What is right for the brighter one saturates in none."""
    session = new_session(ONE)
    rig, world = fake_rig(CONFIG)
    world.laser_dn_s = 60e3
    expose = rig.cameras["cam0"].expose

    def dimmed(*args, **kwargs):
        world.laser_dn_s /= 3
        expose(*args, **kwargs)
        world.laser_dn_s *= 3

    rig.cameras["cam0"].expose = dimmed
    Runner(session, rig).run()
    levels = dict(zip((r.camera for r in session.frames()), reached(session), strict=True))
    assert 0.6 < levels["cam1"] < 0.8
    assert levels["cam0"] == pytest.approx(levels["cam1"] / 3, rel=0.05)


@pytest.mark.parametrize("command", ["laser rewind", "laser sweep", "expose cam1", "fetch cam0"])
def test_an_interrupted_test_is_taken_again_and_a_finished_one_is_not(new_session, command):
    session = new_session(UNTOLD_MDF)
    rig, world = fake_rig(CONFIG)
    world.laser_dn_s = 120e3
    before = [step.id for step in session.steps]

    def interrupt(name):
        if name == command:
            world.on_command = lambda name: None
            raise KeyboardInterrupt

    world.on_command = interrupt
    with pytest.raises(KeyboardInterrupt):
        Runner(session, rig).run()
    assert session.done() == frozenset()
    assert is_safe(rig, world)
    runner = Runner(session, rig, on_event=lambda event: event.kind == "done" and runner.stop())
    assert runner.run().state is State.INTERRUPTED
    assert session.done() == {before[0]}
    assert is_safe(rig, world)
    chosen_s = session.steps[1].exposure_s
    world.laser_dn_s = 80e3  # too late for this mounting
    with Session.open(session.folder) as again:
        assert Runner(again, rig).run().state is State.FINISHED
        assert [step.id for step in again.steps] == before
        assert [step.exposure_s for step in again.steps[1:3]] == [chosen_s] * 2
        assert again.steps[4].exposure_s == pytest.approx(1.5 * chosen_s, rel=0.02)
        assert all(record.exposure_s == record.step.exposure_s for record in again.frames())
        assert again.journal.attempts(before[0]) == 2  # the interrupted one, and the one that was finished
        assert whole(again)


def test_a_stripe_that_saturates_everything_ends_the_session_until_it_is_dimmed(new_session):
    session = new_session(ONE)
    rig, world = fake_rig(CONFIG)
    world.laser_dn_s = 1e9
    with pytest.raises(DeviceError, match="stop the lens down"):
        Runner(session, rig).run()
    assert session.state is State.FAILED
    assert is_safe(rig, world)
    world.laser_dn_s = 1e6
    assert Runner(session, rig).run().state is State.FINISHED
    assert whole(session)


@pytest.mark.parametrize(("room_dn", "says"), [(0.0, "no light of laser"), (1000.0, "no stripe passes")])
def test_a_dead_laser_ends_the_session_in_the_dark_and_in_a_lit_room(new_session, room_dn, says):
    session = new_session(ONE)
    rig, world = fake_rig(CONFIG)
    world.laser_dn_s, world.room_dn = 0.0, room_dn
    with pytest.raises(FrameCheckError, match=says):
        Runner(session, rig).run()
    assert session.state is State.FAILED
    assert is_safe(rig, world)
    assert session.journal.attempts(session.steps[0].id) == 3


def test_a_camera_that_fails_once_in_a_test_delays_it(new_session):
    session = new_session(ONE)
    rig, world = fake_rig(CONFIG)
    failures = [ReadTimeoutError("cam1: no answer")]
    world.on_command = lambda name: _raise(failures) if name == "fetch cam1" and failures else None
    assert Runner(session, rig).run().state is State.FINISHED
    assert session.journal.attempts(session.steps[0].id) == 2
    assert whole(session)


def _raise(errors):
    raise errors.pop()
