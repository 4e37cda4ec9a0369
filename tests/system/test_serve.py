"""`rig serve` as a process: however it ends, the rig is dark and still and the session can be taken up again."""

import json
import re
import signal
import socket
import time
from contextlib import contextmanager

import httpx2
import pytest

from rig.sessions import Session, State
from tests.command import ended, rig, running_rig, wait_until

PLAN = {
    "kind": "btf",
    "turntable_deg": [0, 90, 180, -90],
    "light_azimuth_deg": [45, 135, 225, 315],
    "lamps": ["lamp3", "lamp6"],
    "cameras": ["cam4", "cam7"],
    "exposures_s": [0.02],
    "texels": 8,
}


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


@contextmanager
def capturing(cwd, *options):
    """A service in the middle of a session: its process, and the session's folder."""
    port = free_port()
    with running_rig("serve", "--port", port, *options, cwd=cwd) as process:
        assert f"http://127.0.0.1:{port}/" in process.stdout.readline()
        with httpx2.Client(base_url=f"http://127.0.0.1:{port}/api/v1", timeout=30) as client:
            session = cwd / "sessions" / client.post("/sessions", json=PLAN).json()["id"]
        wait_until(lambda: len(list(session.glob("frames/*/*.dng"))) > 4, process)
        yield process, session


def dark_and_still(simulators):
    status = simulators.control("status")
    return not status["lamps"] and not any(axis["moving"] for axis in status["axes"].values())


def state_of(session):
    with Session.open(session) as opened:
        return opened.state


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_service_that_is_ended_stops_its_session_safely(how, tmp_path, simulated_rig):
    with capturing(tmp_path, "--rig", simulated_rig.toml) as (process, session):
        wait_until(lambda: simulated_rig.control("status")["lamps"], process)
        process.send_signal(how)
        said = ended(process)
    assert (said.code, said.err) == (0, "")
    assert dark_and_still(simulated_rig)
    assert state_of(session) is State.INTERRUPTED
    done = rig("resume", session, "--json", cwd=tmp_path)
    assert json.loads(done.out)["state"] == "finished", done.err


def test_a_service_that_is_killed_leaves_no_lamp_on(tmp_path, simulated_rig):
    """Its worker notices that nobody is there any more, finishes the step and ends."""
    with capturing(tmp_path, "--rig", simulated_rig.toml) as (process, session):
        process.kill()
        process.wait()
    deadline_s = time.monotonic() + 30
    while state_of(session) not in (State.INTERRUPTED, State.FAILED):
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    assert state_of(session) is State.INTERRUPTED
    assert dark_and_still(simulated_rig)
    with Session.open(session) as opened:
        assert 0 < opened.verify() < 2 * len(opened.steps)


def test_the_simulated_rig_of_a_service_goes_with_it_and_the_next_one_takes_the_session_up(tmp_path):
    with capturing(tmp_path, "--simulated") as (process, session):
        process.send_signal(signal.SIGTERM)
        said = ended(process)
    assert said.code == 0, said.err
    assert state_of(session) is State.INTERRUPTED
    toml = re.search(r'"address": "(127\.0\.0\.1:\d+)"', (session / "session.json").read_text())
    host, port = toml[1].split(":")
    with pytest.raises(OSError, match="refused"):
        socket.create_connection((host, int(port)), timeout=5)
    assert rig("resume", session, "--simulated", cwd=tmp_path).code == 0
