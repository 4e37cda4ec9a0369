"""Whole sessions over real wires: plan, planner, runner, drivers, simulators, frames on disk."""

import json
import os
import signal
import subprocess
import sys
from contextlib import closing
from math import degrees
from pathlib import Path

import exifread
import numpy as np
import pytest
import rawpy
import zarr

from rig import load_config, open_rig
from rig.drivers import bus, lamps, laser_unit
from rig.errors import FrameCheckError, RigError
from rig.sessions import Runner, Session, State, parse_plan

ROOT = Path(__file__).parents[2]
BTF = {
    "kind": "btf", "turntable_deg": [0, 90], "light_azimuth_deg": [45], "lamps": ["lamp3", "lamp6"],
    "cameras": ["cam4", "cam7"], "exposures_s": [0.02, 0.06], "texels": 16,
}  # fmt: skip
MDF = {
    "kind": "mdf", "turntable_deg": [0], "laser_azimuth_deg": [45], "laser_elevations_deg": [35, 50],
    "cameras": ["cam4"], "exposure_s": 0.03, "frame_rate_hz": 3.0, "texels": 16,
}  # fmt: skip
SRF = {
    "kind": "srf", "arm_deg": [-40, 30], "exposures_s": [0.1], "sphere_radius_mm": 50,
    "card": {"y_mm": 0, "z_mm": -59, "width_mm": 40, "height_mm": 11, "reflectance": 0.9},
}  # fmt: skip
CALIBRATE = {
    "kind": "calibrate", "board_poses": 3, "lamp": "lamp6", "light_arc_deg": 60, "cameras": ["cam4"],
    "exposure_s": 0.05,
}  # fmt: skip
SENSOR = {
    "kind": "sensor", "cameras": ["cam4"], "dark_exposures_s": [0.1, 0.01], "flat_exposures_s": [0.05], "repeats": 3,
}  # fmt: skip
LAMPS = {
    "kind": "lamps", "lamps": ["lamp4", "led"], "light_arc_deg": [60, -60], "arm_deg": [45], "cameras": ["cam4"],
    "mirror": {"radius_mm": 20, "exposures_s": [0.004]}, "white": {"reflectance": 0.9, "exposures_s": [0.03]},
}  # fmt: skip
ONE_LIGHT = {**BTF, "turntable_deg": [0], "lamps": ["lamp6"], "cameras": ["cam7"]}


@pytest.fixture(autouse=True)
def short_timeouts(monkeypatch):
    """The simulators answer within milliseconds or not at all."""
    for module in (bus, lamps, laser_unit):
        monkeypatch.setattr(module, "_REPLY_TIMEOUT_S", 0.4)


@pytest.fixture
def lab(shared_simulated_rig):
    """The running simulators, mended and put back afterwards."""
    before = shared_simulated_rig.control("status")["sample"]
    shared_simulated_rig.control("clear_faults")
    yield shared_simulated_rig
    shared_simulated_rig.control("clear_faults")
    shared_simulated_rig.control("mount", sample=before)


@pytest.fixture
def new_session(lab, tmp_path):
    made = []

    def make(data, **changes):
        folder = tmp_path / f"session{len(made)}"
        made.append(Session.create(folder, parse_plan({**data, **changes}), load_config(lab.toml)))
        return made[-1]

    yield make
    for session in made:
        session.close()


def run(lab, session, on_event=lambda event: None):
    """One run with the rig opened for it; the control port is the operator."""
    with open_rig(session.config) as rig:
        return Runner(session, rig, lambda mount: lab.control("mount", **mount), on_event).run()


def whole(session):
    return session.verify() == sum(len(step.cameras) for step in session.steps if not step.test)


def is_safe(lab):
    """Dark and still, as the simulated world itself knows it."""
    status = lab.control("status")
    moving = [name for name, axis in status["axes"].items() if axis["moving"]]
    lit = [name for name, level in status["lamps"].items() if level > 0]
    return not moving and not lit and not status["laser"]


def taken(lab):
    """What the world knows of every exposure, by the frame's own id."""
    notes = lab.state / "truth" / "frames.jsonl"
    lines = notes.read_text().splitlines() if notes.exists() else []
    return {frame["id"]: frame for frame in map(json.loads, lines)}


def unique_id(path):
    with path.open("rb") as file:
        tags = exifread.process_file(file, details=False)
    return str(next(tag for name, tag in tags.items() if name.endswith("ImageUniqueID")))


@pytest.mark.parametrize("data", [BTF, SRF, CALIBRATE, SENSOR, LAMPS], ids=lambda data: data["kind"])
def test_every_frame_shows_what_its_step_says(lab, new_session, data):
    """The world's own record of the exposure behind each file: camera, time, angles, lamps."""
    session = new_session(data)
    report = run(lab, session)
    assert report.state is State.FINISHED
    assert report.unconfirmed == ()
    assert is_safe(lab)
    assert whole(session)
    truth = taken(lab)
    records = session.frames()
    assert len({unique_id(record.path) for record in records}) == len(records)
    for record in records:
        frame = truth[unique_id(record.path)]
        assert frame["camera"] == record.camera
        assert frame["exposure_s"] == pytest.approx(record.step.exposure_s, abs=1e-6)
        assert tuple(name for name, level in frame["lamps"].items() if level > 0) == record.step.lamps
        for name, angle_deg in frame["axes_deg"].items():
            commanded_deg = degrees(record.step.axes_rad[name])
            assert angle_deg == pytest.approx(commanded_deg, abs=0.02)  # repeatability and one step of 0.01 deg
        assert frame["sample"] == record.step.mount["sample"]


def test_a_sweep_crosses_the_sample_while_the_cameras_record(lab, new_session):
    session = new_session(MDF)
    before = len(taken(lab))
    report = run(lab, session)
    assert whole(session)
    assert is_safe(lab)
    frames = list(taken(lab).values())[before:]
    assert len(frames) == sum(step.frames for step in session.steps)
    assert all(frame["laser"]["on"] for frame in frames)
    assert {round(frame["axes_deg"]["light_arc"]) for frame in frames} == {45}
    trace_m = [end["offset_m"] for frame in frames for end in frame["laser"]["planes"]]
    assert min(trace_m) < 0 < max(trace_m)  # the plane passed the origin
    assert report.overhead < 1.15


def test_a_test_sweep_finds_the_exposure_that_fills_the_range(lab, new_session):
    """On real frames of a real scene: the white frame's stripe peaks at 0.6 to 0.8 of full scale, or the time is up."""
    untold = {key: value for key, value in MDF.items() if key != "exposure_s"}
    session = new_session(untold, laser_elevations_deg=[50], frame_rate_hz=6.0)
    told = []
    assert run(lab, session, told.append).state is State.FINISHED
    assert is_safe(lab)
    (record,) = session.frames()
    (message,) = (event.message for event in told if event.kind == "done" and event.message)
    assert f"exposure {record.exposure_s:.4f} s chosen from a test sweep" in message
    burst = zarr.open_array(record.path, mode="r")
    black_dn, white_dn = burst.attrs["black_dn"], burst.attrs["white_dn"]
    red_dn = burst[:, ::2, ::2].max(axis=0) - black_dn
    assert 0.6 < np.quantile(red_dn, 0.99) / (white_dn - black_dn) < 0.8
    assert np.diff(burst.attrs["times_s"]) == pytest.approx(1 / 6, abs=1e-3)


def test_the_session_time_is_near_its_lower_bound(lab, new_session):
    """What is added are the messages: 19 ms each on the bus, 23 ms a DMX frame."""
    report = run(lab, new_session(BTF))
    assert 1.0 <= report.overhead < 1.2


def test_stopping_and_going_on_gives_the_same_bits(start_simulators, tmp_path):
    """Frames are keyed by what is photographed: a second opening of the rig changes none of them."""
    data = {**ONE_LIGHT, "turntable_deg": [0, 90], "light_azimuth_deg": [45, 135], "exposures_s": [0.02]}
    digests = []
    for halves in (False, True):
        lab = start_simulators("--seed", "7")
        with Session.create(tmp_path / f"{halves}", parse_plan(data), load_config(lab.toml)) as session:
            if halves:
                with open_rig(session.config) as rig:
                    assert run_half(lab, session, rig).state is State.INTERRUPTED
            assert run(lab, session).state is State.FINISHED
            digests.append([pixels(record.path) for record in session.frames()])
    assert digests[0] == digests[1]


def run_half(lab, session, rig):
    """Stop in the second of four steps."""

    def watch(event):
        if event.step == session.steps[1].id and event.kind == "step":
            runner.stop()

    runner = Runner(session, rig, lambda mount: lab.control("mount", **mount), watch)
    return runner.run()


def pixels(path):
    """The counts of a file without its time stamps."""
    with rawpy.imread(str(path)) as raw:
        return raw.raw_image.tobytes()


@pytest.mark.parametrize("kind", ["dark", "frozen", "no_frame", "wrong_camera"])
def test_a_faulty_frame_is_taken_again(lab, new_session, kind):
    session = new_session(ONE_LIGHT, light_azimuth_deg=[45, 135])
    run_before = len(taken(lab))
    struck = []

    def break_the_camera(event):
        if event.kind == "done" and not struck:
            struck.append(event)
            lab.control("fault", device="cam7", kind=kind, **({"other": "cam4"} if kind == "wrong_camera" else {}))

    assert run(lab, session, break_the_camera).state is State.FINISHED
    assert lab.control("faults")["faults"][0]["struck"] == 1
    assert whole(session)
    assert len(taken(lab)) >= run_before + len(session.steps)
    assert is_safe(lab)


def test_a_dead_lamp_ends_the_session_and_a_new_one_lets_it_go_on(lab, new_session):
    session = new_session(ONE_LIGHT)
    lab.control("fault", device="lamp6", kind="dead_lamp")
    with pytest.raises(FrameCheckError, match="no light of lamp6"):
        run(lab, session)
    assert session.state is State.FAILED
    assert is_safe(lab)
    lab.control("clear_faults")
    assert run(lab, session).state is State.FINISHED
    assert whole(session)


@pytest.mark.parametrize(("device", "kind"), [("turntable", "stall"), ("bus", "unplug"), ("cam7", "unplug")])
def test_a_broken_device_ends_the_session_dark(start_simulators, tmp_path, device, kind):
    """Also where the axes cannot be asked any more: then the journal says so. Wires stay unplugged in this rig."""
    lab = start_simulators()
    struck = []

    def break_the_device(event):
        if event.kind == "done" and not struck:
            struck.append(event)
            lab.control("fault", device=device, kind=kind, count=99)

    data = {**ONE_LIGHT, "turntable_deg": [0, 90]}
    with Session.create(tmp_path / "session", parse_plan(data), load_config(lab.toml)) as session:
        with pytest.raises(RigError):
            run(lab, session, break_the_device)
        assert session.state is State.FAILED
        assert not any(lab.control("status")["lamps"].values())
        unconfirmed = [event.text for event in session.events() if event.kind == "unconfirmed"]
        assert any(name in " ".join(unconfirmed) for name in session.config.axes) == (device == "bus")
        assert session.verify() == len(session.done())


CAPTURE = """
import json, signal, sys
from pathlib import Path
from rig import open_rig
from rig.sessions import Runner, Session
from tests.conftest import ControlPort
session = Session.open(Path(sys.argv[1]))
control = ControlPort(session.config.clock.address)
with open_rig(session.config) as rig:
    Runner(session, rig, lambda mount: control("mount", **mount), lambda event: print(event.kind, flush=True)).run()
"""


@pytest.mark.parametrize(
    ("how", "data"),
    [
        ("SIGKILL", BTF),
        ("SIGINT", BTF),
        ("SIGKILL", MDF),
        ("SIGKILL", LAMPS),
        ("SIGINT", LAMPS),
        ("SIGKILL", SENSOR),
    ],
    ids=lambda value: value if isinstance(value, str) else value["kind"],
)
def test_a_process_that_dies_in_the_middle_is_taken_up_by_another(lab, new_session, how, data):
    session = new_session(data)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", CAPTURE, str(session.folder)]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        with closing(process.stdout):
            while (line := process.stdout.readline()) != b"done\n":
                assert line, process.stderr.read().decode()
            process.send_signal(getattr(signal, how))
            process.stdout.read()
        process.wait()
    assert session.state is State.INTERRUPTED
    assert 0 < len(session.done()) < len(session.steps)
    if how == "SIGINT":
        assert is_safe(lab)
    attempts = {step: session.journal.attempts(step) for step in session.done()}
    assert run(lab, session).state is State.FINISHED
    assert {step: session.journal.attempts(step) for step in attempts} == attempts
    assert whole(session)
    assert is_safe(lab)


# ---- laser sweeps -------------------------------------------------------------------------------------------------

ONE_SWEEP = {**MDF, "laser_elevations_deg": [50]}


def at_step(lab, number, *faults):
    """An event handler that injects these faults when the step of that number begins, once.

    A fault's `frame` or `move` says the how-manieth of its device from then on is struck, `after_s` from when on.
    """
    begun = []

    def inject(event):
        if event.kind == "step":
            begun.append(event.step)
            for fault in faults if len(begun) == number else ():
                lab.control("fault", **counted(lab, dict(fault)))

    return inject


def counted(lab, fault):
    """The fault with its place in the device's own count, as the simulators want it."""
    seen = lab.control("faults")["seen"].get(fault["device"], {})
    for occasion in fault.keys() & {"frame", "move"}:
        fault["at_message"] = seen.get(occasion, 0) + fault.pop(occasion)
    if "after_s" in fault:
        fault["at_time_s"] = lab.control("now")["time_s"] + fault.pop("after_s")
    return fault


def struck(lab):
    return [fault["struck"] for fault in lab.control("faults")["faults"]]


@pytest.mark.parametrize("kind", ["frozen", "no_frame", "wrong_camera"])
def test_a_faulty_frame_in_the_middle_of_a_burst_is_taken_again(lab, new_session, kind):
    """The whole burst: no other frame of it is trusted either."""
    session = new_session(ONE_SWEEP)
    fault = {"device": "cam4", "kind": kind, "frame": 12, "other": "cam7" if kind == "wrong_camera" else ""}
    assert run(lab, session, at_step(lab, 1, fault)).state is State.FINISHED
    assert struck(lab) == [1]
    assert session.journal.attempts(session.steps[0].id) == 2
    assert whole(session)
    assert is_safe(lab)


def test_a_late_frame_is_stored_with_its_own_time(lab, new_session):
    """The eleventh and all after it come 0.2 s late, and the camera's stamps say so."""
    session = new_session(ONE_SWEEP)
    late = {"device": "cam4", "kind": "late", "frame": 10, "seconds": 0.2}
    assert run(lab, session, at_step(lab, 1, late)).state is State.FINISHED
    times_s = np.array(zarr.open_array(session.frames()[0].path, mode="r").attrs["times_s"])
    expected_s = np.arange(len(times_s)) * 0.333 + 0.2 * (np.arange(len(times_s)) >= 10)
    np.testing.assert_allclose(times_s, expected_s, atol=1e-3)
    assert session.journal.attempts(session.steps[0].id) == 1
    assert whole(session)


def test_a_laser_unit_on_a_bad_wire_still_sweeps(lab, new_session):
    """Infrared in daylight: replies lost, late, doubled, cut and garbled while the stripe is on its way."""
    session = new_session(ONE_SWEEP)
    kinds = ("lose", "drop", "corrupt", "duplicate", "truncate", "delay")
    faults = [{"device": "tower", "kind": kind, "probability": 0.15, "count": 2, "seconds": 0.05} for kind in kinds]
    assert run(lab, session, at_step(lab, 1, *faults)).state is State.FINISHED
    assert sum(struck(lab)) > 3
    assert whole(session)
    assert is_safe(lab)


@pytest.mark.parametrize(
    ("fault", "says"),
    [
        ({"device": "laser", "kind": "stall", "move": 1}, "laser: the count stands"),
        ({"device": "laser", "kind": "stall", "move": 2}, "laser: the motor turned by"),
        ({"device": "tower", "kind": "lose", "count": 10_000, "after_s": 18.0}, "laser"),  # 12 s back, then the sweep
        ({"device": "cam4", "kind": "no_frame", "count": 10_000}, "cam4"),
    ],
    ids=["motor stops on its way back", "motor stops in the sweep", "no infrared replies", "camera stops"],
)
def test_a_sweep_that_cannot_be_completed_ends_safe_and_is_resumed(lab, new_session, fault, says):
    """In the second of two sweeps; the first one stays as it was. Where nobody answers, the journal says so."""
    session = new_session(MDF)
    with pytest.raises(RigError, match=says):
        run(lab, session, at_step(lab, 2, fault))
    assert session.state is State.FAILED
    assert session.done() == {session.steps[0].id}
    assert session.verify() == 1
    unconfirmed = " ".join(event.text for event in session.events() if event.kind == "unconfirmed")
    assert ("laser: unconfirmed" in unconfirmed) == (fault["device"] == "tower")
    assert lab.control("status")["laser"] == (fault["device"] == "tower")
    assert is_safe(lab) or fault["device"] == "tower"
    lab.control("clear_faults")
    assert run(lab, session).state is State.FINISHED
    assert session.journal.attempts(session.steps[0].id) == 1
    assert whole(session)
    assert is_safe(lab)


def test_a_lamp_that_was_left_on_is_off_before_the_first_sweep(lab, new_session):
    session = new_session(ONE_SWEEP)
    before = len(taken(lab))
    with open_rig(session.config) as rig:
        rig.lamps.light({"lamp3": 1.0, "led": 0.5})
        Runner(session, rig, lambda mount: lab.control("mount", **mount)).run()
    assert not any(level for frame in list(taken(lab).values())[before:] for level in frame["lamps"].values())
    assert whole(session)


def test_a_test_sweep_under_faults_chooses_the_same_exposure(lab, new_session):
    """Its burst is taken again like any other; what it finds does not depend on how often it was tried."""
    untold = {key: value for key, value in ONE_SWEEP.items() if key != "exposure_s"}
    faults = (
        {"device": "cam4", "kind": "frozen", "frame": 5},
        {"device": "tower", "kind": "drop", "count": 2},
    )
    exposures_s = []
    for injected in ((), faults):
        session = new_session(untold)
        assert run(lab, session, at_step(lab, 1, *injected)).state is State.FINISHED
        assert session.journal.attempts(session.steps[0].id) == 1 + bool(injected)
        assert whole(session)
        exposures_s.append(session.frames()[0].exposure_s)
        assert is_safe(lab)
    assert exposures_s[1] == pytest.approx(exposures_s[0], rel=0.05)
