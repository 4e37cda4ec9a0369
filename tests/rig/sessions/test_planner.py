"""From plan to steps: identity, order, limits, skips and forecast."""

import json
from itertools import pairwise
from math import degrees, radians

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.errors import InterlockError, LimitError, PlanError, UnknownDeviceError
from rig.sessions import describe, expand, forecast, load_plan, parse_plan, schedule
from rig.sessions.forecast import lower_bound_s, motion_time_s, reference_rad
from rig.sessions.step import read_step, step_data
from tests.rig.sessions.fake_rig import PLANS, config
from tests.rig.sessions.test_plan import EXAMPLES, changed

CONFIG = config()
ONE = {"laser_azimuth_deg": [45], "laser_elevations_deg": [35]}
ANGLES = st.lists(st.integers(-1795, 1800).map(lambda tenths: tenths / 10), min_size=1, max_size=5, unique=True)


@st.composite
def plans(draw):
    kind = draw(st.sampled_from(["btf", "mdf", "srf"]))
    if kind == "btf":
        return changed(
            "btf",
            turntable_deg=draw(ANGLES),
            light_azimuth_deg=draw(ANGLES),
            lamps=draw(st.permutations(["lamp0", "lamp1"])),
            exposures_s=draw(st.lists(st.integers(1, 9999), min_size=1, max_size=3, unique=True).map(_tenths_of_ms)),
        )
    if kind == "mdf":
        return changed("mdf", turntable_deg=draw(ANGLES), laser_elevations_deg=draw(st.permutations([35, 50])))
    arm_deg = draw(st.lists(st.integers(-90, 90), min_size=1, max_size=6, unique=True))
    return changed("srf", arm_deg=[*arm_deg, 77.7])


def _tenths_of_ms(ticks):
    return [tick / 10_000 for tick in ticks]


def steps_of(data):
    """The steps, or nothing where every light azimuth falls into the light arc's forbidden zone."""
    try:
        return expand(parse_plan(data), CONFIG)
    except PlanError:
        return ()


@given(plans())
@settings(max_examples=50, deadline=None)
def test_identities_are_unique_and_stable(data):
    steps = steps_of(data)
    assert len({step.id for step in steps}) == len(steps)
    assert steps == steps_of(data)


@given(plans(), st.randoms())
@settings(max_examples=50, deadline=None)
def test_the_order_in_which_a_plan_lists_things_changes_nothing(data, random):
    shuffled = {
        key: random.sample(value, len(value)) if isinstance(value, list) else value for key, value in data.items()
    }
    assert steps_of(shuffled) == steps_of(data)


@given(plans())
@settings(max_examples=50, deadline=None)
def test_steps_survive_json(data):
    for step in steps_of(data):
        assert read_step(json.loads(json.dumps(step_data(step)))) == step


@given(plans())
@settings(max_examples=50, deadline=None)
def test_no_step_leaves_the_limits_or_stands_in_a_forbidden_zone(data):
    for step in steps_of(data):
        for name, axis in CONFIG.axes.items():
            angle = degrees(step.axes_rad[name])
            assert axis.min_deg - 1e-6 <= angle <= axis.max_deg + 1e-6
            assert not any(low <= angle <= high for low, high in axis.forbidden_deg)


@given(plans())
@settings(max_examples=30, deadline=None)
def test_the_operator_mounts_each_thing_once(data):
    steps = steps_of(data)
    changes = sum(a.mount != b.mount for a, b in pairwise(steps))
    assert changes == max(len({tuple(sorted(step.mount.items())) for step in steps}) - 1, 0)


@given(st.lists(st.integers(-18, 18).map(lambda tens: tens * 10), min_size=2, max_size=8, unique=True))
@settings(max_examples=30, deadline=None)
def test_one_axis_never_turns_back(angles):
    """With one axis on the move the shortest serpentine is one sweep from end to end."""
    angles = [angle for angle in angles if abs(angle) > 12 and angle > -180]
    if not angles:
        return
    steps = steps_of(changed("mdf", laser_azimuth_deg=angles, laser_elevations_deg=[35]))
    path = [degrees(step.axes_rad["light_arc"]) for step in steps]
    assert path in (sorted(path), sorted(path, reverse=True))


def test_the_order_is_no_worse_than_the_plain_nested_loop():
    plan = changed("btf", turntable_deg=[0, 90, 180, -90], light_azimuth_deg=[45, 135, 225, 315])
    steps = steps_of(plan)
    loop = sorted(steps, key=lambda step: (step.axes_rad["turntable"], step.axes_rad["light_arc"]))
    assert travel_s(steps) < 0.9 * travel_s(loop)


def travel_s(steps):
    poses = [reference_rad(CONFIG), *(step.axes_rad for step in steps)]
    return sum(motion_time_s(a, b, CONFIG) for a, b in pairwise(poses))


def test_long_exposures_come_first_in_every_light():
    for a, b in pairwise(steps_of(PLANS["btf"])):
        if (a.pose, a.lamps) == (b.pose, b.lamps):
            assert a.exposure_s > b.exposure_s


def test_the_light_arc_follows_the_turntable():
    """A light's azimuth is told in the sample frame, which turns with the turntable."""
    for step in steps_of(PLANS["btf"]):
        azimuth = degrees(step.axes_rad["light_arc"] - step.axes_rad["turntable"]) % 360
        assert min(abs(azimuth - 45), abs(azimuth - 135)) < 1e-9


def test_an_angle_out_of_range_is_taken_by_whole_turns():
    steps = steps_of(changed("mdf", turntable_deg=[270], laser_azimuth_deg=[225]))
    assert {round(degrees(step.axes_rad["turntable"])) for step in steps} == {-90}
    assert {round(degrees(step.axes_rad["light_arc"])) for step in steps} == {-135}


def with_collision(low_deg, high_deg):
    axes = CONFIG.model_dump()["axes"]
    return config(axes={**axes, "turntable": {**axes["turntable"], "collision_deg": [[low_deg, high_deg]]}})


def test_an_angle_behind_a_collision_is_taken_from_the_other_side_or_refused():
    """A cable that may not be wound past 100 deg: 170 deg is -190 deg, and 120 deg cannot be."""
    settings = with_collision(100, 110)
    (step,) = expand(parse_plan(changed("mdf", turntable_deg=[170], **ONE)), settings)
    assert degrees(step.axes_rad["turntable"]) == pytest.approx(-190)
    with pytest.raises(InterlockError, match=r"turntable: 120 deg .*collision at 100 to 110 deg"):
        expand(parse_plan(changed("mdf", turntable_deg=[120], **ONE)), settings)


@given(st.lists(st.integers(-180, 179), min_size=1, max_size=6, unique=True), st.integers(20, 150))
@settings(max_examples=30, deadline=None)
def test_no_way_leads_into_a_collision(angles, low):
    data = parse_plan(changed("mdf", turntable_deg=angles, **ONE))
    try:
        steps = expand(data, with_collision(low, low + 5))
    except InterlockError:
        return
    way = [0.0, *(degrees(step.axes_rad["turntable"]) for step in steps)]
    assert all(max(pair) < low or min(pair) > low + 5 for pair in pairwise(way))


def test_axes_that_a_plan_does_not_use_stand_out_of_the_way():
    for step in steps_of(PLANS["srf"]):
        assert abs(degrees(step.axes_rad["light_arc"])) > 12
        assert step.axes_rad["turntable"] == 0


def test_what_the_geometry_cannot_use_is_skipped_with_its_reason():
    under = schedule(parse_plan(changed("btf", lamps=["led", "lamp1"], cameras=["front", "cam0"])), CONFIG)
    assert [skip.what for skip in under.skipped] == ["camera front", "lamp led"]
    assert "horizon" in under.skipped[1].reason
    assert all(step.lamps == ("lamp1",) and step.cameras == ("cam0",) for step in under.steps)
    before = schedule(parse_plan(changed("btf", light_azimuth_deg=[0, 45], turntable_deg=[0])), CONFIG)
    assert [skip.what for skip in before.skipped] == ["turntable 0 deg, light azimuth 0 deg"]
    arm = schedule(parse_plan(changed("srf", arm_deg=[-10, 0, 10])), CONFIG)
    assert "before camera front" in arm.skipped[0].reason
    still = schedule(parse_plan(changed("lamps", arm_deg=[])), CONFIG)
    assert [(skip.what, "arm_deg" in skip.reason) for skip in still.skipped] == [("lamp led", True)]
    level = schedule(parse_plan({k: v for k, v in PLANS["lamps"].items() if k != "mirror"}), CONFIG)
    assert [(skip.what, "white plate" in skip.reason) for skip in level.skipped] == [("lamp led", True)]
    assert {round(degrees(step.axes_rad["arm"])) for step in arm.steps} == {-10, 10}


DOME = changed("srf", lamps=["lamp0", "led", "lamp1"], light_arc_deg=[45, -45], camera="cam1")


def test_a_dome_is_every_lamp_at_every_angle_of_its_axis():
    steps = steps_of(DOME)
    lights = {
        (step.lamps, round(degrees(step.axes_rad["arm" if step.lamps == ("led",) else "light_arc"]))) for step in steps
    }
    on_the_arc = {((lamp,), angle) for lamp in ("lamp0", "lamp1") for angle in (45, -45)}
    assert lights == on_the_arc | {(("led",), angle) for angle in (-20, 0, 30)}
    assert len(steps) == 2 * len(lights)
    assert {step.mount["card"] for step in steps} == {"cam1"}
    assert "card" not in steps_of(PLANS["srf"])[0].mount


def test_the_arm_stands_aside_where_the_arc_lights_what_the_front_camera_sees():
    for step in steps_of({**DOME, "camera": "front"}):
        arm_deg, arc_deg = degrees(step.axes_rad["arm"]), degrees(step.axes_rad["light_arc"])
        assert step.lamps == ("led",) or arm_deg == (-90 if arc_deg > 0 else 90)


def test_a_sweep_is_recorded_from_end_to_end():
    for step in steps_of(PLANS["mdf"]):
        nominal_s = CONFIG.laser.sweep_ticks / CONFIG.laser.ticks_per_s
        assert step.sweep
        assert step.frames * step.interval_s >= nominal_s
        assert step.lamps == ()


def test_a_sensor_is_measured_without_lamps_and_every_repeat_is_a_step():
    steps = steps_of(PLANS["sensor"])
    assert [step.mount["sample"] for step in steps] == ["cap"] * 4 + ["lightbox"] * 4  # mounted twice, not per frame
    assert not any(step.lamps or step.sweep for step in steps)
    assert all(step.cameras == ("cam0", "front") for step in steps)
    assert [step.id for step in steps[:2]] == ["cap00_0.2000s", "cap00_0.0100s"]  # in rounds, longest first
    assert all(-12 > degrees(step.axes_rad["light_arc"]) or degrees(step.axes_rad["light_arc"]) > 12 for step in steps)


@pytest.mark.parametrize(
    ("data", "error", "says"),
    [
        (changed("sensor", cameras=["cam9"]), UnknownDeviceError, "cam9"),
        (changed("btf", cameras=["cam9"]), UnknownDeviceError, "cam0, cam1, front"),
        (changed("btf", lamps=["sun"]), UnknownDeviceError, "led, lamp0, lamp1"),
        (changed("srf", lamp="sun"), UnknownDeviceError, "sun"),
        (changed("calibrate", cameras=["cam9"]), UnknownDeviceError, "cam9"),
        (changed("srf", arm_deg=[120]), LimitError, r"arm: 120 deg is outside -90 to 90 deg"),
        (changed("mdf", laser_azimuth_deg=[5]), InterlockError, r"light_arc: 5 deg is forbidden \(-12 to 12 deg\)"),
        (changed("calibrate", light_arc_deg=0), InterlockError, r"nothing was moved"),
        (changed("mdf", laser_azimuth_deg=[[45], [60, 5]]), InterlockError, r"light_arc: 5 deg is forbidden"),
        (changed("mdf", laser_elevations_deg=[40]), PlanError, "35, 50"),
        (changed("srf", lamp="lamp0"), PlanError, "field arm_deg: none of lamp0 sits on the arm"),
        (changed("srf", lamps=["lamp0", "led"]), PlanError, "field light_arc_deg: lamp0 sits on the light_arc"),
        (changed("srf", lamps=["led"], camera="cam9"), UnknownDeviceError, "cam9"),
        (changed("calibrate", lamp="led"), PlanError, "led"),
        (changed("btf", lamps=["led"]), PlanError, "no step is left"),
        (changed("mdf", cameras=["front"]), PlanError, "no step is left"),
        (changed("srf", arm_deg=[0]), PlanError, "no step is left"),
    ],
)
def test_an_impossible_plan_is_refused_before_anything_moves(data, error, says):
    with pytest.raises(error, match=says):
        expand(parse_plan(data), CONFIG)


def test_mountings_may_have_azimuths_of_their_own():
    """Each is taken where it was asked for, and a step is the same step in whichever form the plan names it."""
    steps = steps_of(changed("mdf", laser_elevations_deg=[50, 35], laser_azimuth_deg=[[60, -60, 90], [45]]))
    taken = {(step.mount["laser_elevation_deg"], round(degrees(step.axes_rad["light_arc"]))) for step in steps}
    assert len(steps) == 4
    assert taken == {(35, 45), (50, 60), (50, -60), (50, 90)}
    flat = steps_of(changed("mdf", laser_elevations_deg=[50, 35], laser_azimuth_deg=[45, 60]))
    assert flat == steps_of(changed("mdf", laser_elevations_deg=[35, 50], laser_azimuth_deg=[[60, 45], [45, 60]]))
    assert steps[0] in flat


def test_a_rig_without_laser_or_axis_says_so():
    with pytest.raises(UnknownDeviceError, match="laser"):
        expand(parse_plan(PLANS["mdf"]), config(laser=None))
    axes = {name: axis for name, axis in CONFIG.model_dump()["axes"].items() if name != "turntable"}
    with pytest.raises(UnknownDeviceError, match="turntable"):
        expand(parse_plan(PLANS["btf"]), config(axes=axes))


@given(plans())
@settings(max_examples=30, deadline=None)
def test_the_forecast_is_consistent(data):
    steps = steps_of(data)
    expected = forecast(steps, CONFIG)
    assert expected.lower_bound_s <= expected.time_s + 1e-9
    assert expected.time_s == pytest.approx(sum(expected.step_s))
    assert expected.exposure_s == pytest.approx(sum(step.duration_s for step in steps))
    assert expected.frames == sum(step.frames * len(step.cameras) for step in steps)
    assert expected.bytes == pytest.approx(expected.frames * 2000)  # 2 kB a frame, rig.toml


def test_the_lower_bound_of_no_step_is_zero():
    assert lower_bound_s([]) == 0


def test_a_move_takes_what_its_ramps_take():
    """30 deg/s at 60 deg/s2: ramps of 15 deg together; 45 deg take 1.5 s + 0.5 s, 3.75 deg 0.5 s; 0.2 s to settle."""
    here = {"arm": 0.0, "light_arc": 0.0}
    assert motion_time_s(here, {"arm": radians(45)}, CONFIG) == pytest.approx(2.2)
    assert motion_time_s(here, {"arm": radians(3.75)}, CONFIG) == pytest.approx(0.7)
    assert motion_time_s(here, {"arm": radians(45), "light_arc": radians(3.75)}, CONFIG) == pytest.approx(2.2)
    assert motion_time_s(here, here, CONFIG) == 0


def test_the_board_of_pose_zero_is_turned():
    """At every angle but the one at which all poses are taken anyway, without another mounting."""
    steps = steps_of(changed("calibrate", turntable_deg=[90, 0, -120]))
    shots = [(step.mount["pose"], round(degrees(step.axes_rad["turntable"]))) for step in steps]
    assert sorted(shots) == [(0, -120), (0, 0), (0, 90), (1, 0), (2, 0)]
    assert [pose for pose, _ in shots] == [0, 0, 0, 1, 2]


def test_a_dry_run_names_everything_of_a_step():
    line = describe(steps_of(PLANS["mdf"])[0])
    for word in ("light_arc", "laser sweep", "0.0200 s", "cam0, cam1", "laser_elevation_deg=35"):
        assert word in line


def lamps_steps(plan):
    """The led on the arm stands level with the white plate, which is photographed under the others only."""
    on_arc = len(plan.light_arc_deg) * (len(plan.lamps) - 1)
    return on_arc * len(plan.white.exposures_s) + (on_arc + len(plan.arm_deg)) * len(plan.mirror.exposures_s)


def srf_lights(plan):
    """Every lamp at every angle of the axis that carries it; the examples use one of the two axes."""
    return len(plan.lamp_names()) * len(plan.arm_deg or plan.light_arc_deg)


def mdf_steps(plan):
    """Every place of the laser at every angle of the turntable, and a test in each mounting where it chooses."""
    tests = len(plan.laser_elevations_deg) if plan.exposure_s is None else 0
    return len(plan.turntable_deg) * sum(len(azimuths) for _, azimuths in plan.mountings_deg()) + tests


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_examples_use_only_what_their_comments_count(path):
    """The examples are for the simulated rig; their numbers of steps follow from their lists."""
    plan = load_plan(path)
    counted = {
        "srf": lambda: len(plan.exposures_s) * srf_lights(plan),
        "btf": lambda: len(plan.turntable_deg) * len(plan.light_azimuth_deg) * len(plan.lamps) * len(plan.exposures_s),
        "mdf": lambda: mdf_steps(plan),
        "calibrate": lambda: plan.board_poses + len(plan.turntable_deg),
        "sensor": lambda: plan.repeats * (len(plan.dark_exposures_s) + len(plan.flat_exposures_s)),
        "lamps": lambda: lamps_steps(plan),
        "environment": lambda: 2 * len(plan.exposures_s),
    }[plan.kind]()
    lamp = CONFIG.lamps.lamp["lamp1"].model_dump()
    camera = CONFIG.cameras["cam1"].model_dump()
    lamps = {f"lamp{i}": {**lamp, "channel": i + 1} for i in range(8)} | {"led": CONFIG.lamps.lamp["led"].model_dump()}
    cameras = {f"cam{i}": camera for i in range(8)} | {
        name: CONFIG.cameras[name].model_dump() for name in ("front", "phone")
    }
    laser = {**CONFIG.laser.model_dump(), "elevations_deg": [20, 35, 50, 65, 75]}
    whole = config(lamps={"port": "/fake/dmx", "lamp": lamps}, cameras=cameras, laser=laser)
    laid_out = schedule(plan, whole)
    assert len(laid_out.steps) == counted
    assert laid_out.skipped == ()


def test_a_place_is_photographed_front_and_back_from_long_to_short():
    plan = parse_plan(PLANS["environment"])
    steps = schedule(plan, CONFIG).steps
    assert [step.mount["facing"] for step in steps] == ["front"] * 3 + ["back"] * 3
    assert [step.id for step in steps[:3]] == ["front_0.5000s", "front_0.0100s", "front_0.000031s"]
    assert [step.exposure_s for step in steps[3:]] == [0.5, 0.01, 1 / 32_000]
    assert all(step.lamps == () and step.cameras == ("phone",) and step.file_format == "jpg" for step in steps)
    raw = schedule(parse_plan({**PLANS["environment"], "files": "raw"}), CONFIG).steps
    assert {step.file_format for step in raw} == {"dng"}


def test_a_camera_in_the_hand_and_mounted_ones_serve_their_own_plans():
    with pytest.raises(PlanError, match="front is mounted"):
        schedule(parse_plan({**PLANS["environment"], "camera": "front"}), CONFIG)
    with pytest.raises(PlanError, match="phone is held by hand"):
        schedule(parse_plan({**PLANS["sensor"], "cameras": ["phone"]}), CONFIG)
    with pytest.raises(UnknownDeviceError, match="'tablet'"):
        schedule(parse_plan({**PLANS["environment"], "camera": "tablet"}), CONFIG)
