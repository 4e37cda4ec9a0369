"""Debian's nqc drives the RCX through the echoing serial tower."""

import pytest


@pytest.fixture
def nqc(live_rig, command):
    """nqc on the tower."""
    return lambda *arguments: command("nqc", f"-S{live_rig.state / 'tower'}", *arguments)


def raw(nqc, payload):
    """The reply's data to a payload in hex."""
    answer = nqc("-raw", payload)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    return bytes.fromhex(answer.stdout)


def test_battery_and_versions(nqc):
    assert 7000 < int.from_bytes(raw(nqc, "30"), "little") < 9500
    versions = raw(nqc, "15010305070b")
    assert len(versions) == 8
    assert versions[4:] != bytes(4), "no firmware is loaded"


def test_motor_turns_the_sensor_and_the_laser_shines(nqc, live_rig):
    for payload in ("320004", "4200e0", "d100", "13010207", "e183", "2183"):
        assert raw(nqc, payload) == b""
    status = live_rig.control("status")
    assert status["laser"]
    assert status["motor"]["running"]
    counted = int.from_bytes(raw(nqc, "120900"), "little", signed=True)
    assert counted > 0
    assert raw(nqc, "2143") == b""
    status = live_rig.control("status")
    assert not status["laser"]
    assert not status["motor"]["running"]


def test_program_is_downloaded_and_started(nqc, live_rig, tmp_path):
    source = tmp_path / "sweep.nqc"
    source.write_text("task main() { SetSensor(SENSOR_1, SENSOR_ROTATION); OnFwd(OUT_A); Wait(100); Off(OUT_A); }")
    done = nqc("-d", "-pgm", "1", str(source), "-run")
    assert done.returncode == 0, done.stdout + done.stderr
    rcx = live_rig.control("status")["rcx"]
    assert rcx["program"] == 0, "nqc counts programs from 1, the RCX from 0"
    assert rcx["tasks"]["0"] > 0
    assert rcx["running"] == [0]


def test_actions(nqc, live_rig):
    for action in (("-watch", "1234"), ("-sleep", "200"), ("-near",), ("-far",), ("-msg", "7"), ("-clear",)):
        done = nqc(*action)
        assert done.returncode == 0
        assert "No reply" not in done.stdout + done.stderr, action
    rcx = live_rig.control("status")["rcx"]
    assert rcx["message"] == 7
    assert rcx["power_down_min"] == 200
    assert rcx["tasks"] == {}


def test_lost_reply_is_asked_for_again_and_done_once(nqc, live_rig):
    """nqc sends the same bytes again; the RCX repeats its reply but does not execute."""
    for payload in ("320004", "4200e0", "d100", "13010207", "e181"):
        raw(nqc, payload)
    # nqc pings first: the message struck is the flip of the direction itself.
    seen = live_rig.control("faults")["seen"]["tower"]["message"]
    live_rig.control("fault", device="tower", kind="drop", at_message=seen + 2)
    assert raw(nqc, "e141") == b""
    assert live_rig.control("faults")["faults"][0]["struck"] == 1
    assert int.from_bytes(raw(nqc, "120300"), "little") & 0x08 == 0, "flipped once: reverse"
