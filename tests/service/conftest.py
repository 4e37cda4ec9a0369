"""A service on a simulated rig, driven as a program would drive it."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from rig.config import load_config
from service.app import create_app

API = "/api/v1"
ORIGIN = "http://127.0.0.1"
LIVE = f"ws://127.0.0.1{API}"  # the test client has another host of its own for WebSockets
ROOT_OPENAPI = Path(__file__).parents[2] / "service" / "openapi.json"
SMALL_BTF = {
    "kind": "btf",
    "turntable_deg": [0, 90],
    "light_azimuth_deg": [45, 135],
    "lamps": ["lamp4"],
    "cameras": ["cam4", "cam6"],
    "exposures_s": [0.02],
    "texels": 8,
}
LONG_BTF = SMALL_BTF | {"exposures_s": [0.01 + 0.001 * k for k in range(8)]}  # not over before it is acted upon
LONG_STEPS = 32
CALIBRATE = {
    "kind": "calibrate",
    "board_poses": 4,
    "lamp": "lamp6",
    "light_arc_deg": 60,
    "cameras": ["cam4", "cam7"],
    "exposure_s": 0.05,
}
UNTOLD_MDF = {
    "kind": "mdf",
    "turntable_deg": [0],
    "laser_azimuth_deg": [[45]],
    "laser_elevations_deg": [50],
    "cameras": ["cam7"],
    "frame_rate_hz": 5.0,
    "texels": 8,
}
SENSOR = {
    "kind": "sensor",
    "cameras": ["cam4"],
    "dark_exposures_s": [0.001, 0.5, 2.0],
    "flat_exposures_s": [0.01, 0.05, 0.1, 0.15, 0.2, 0.25, 0.33, 0.4, 0.5],
    "repeats": 2,
}


@pytest.fixture
def client(simulated_rig, tmp_path) -> Iterator[TestClient]:
    with TestClient(create_app(load_config(simulated_rig.toml), tmp_path / "sessions"), base_url=ORIGIN) as client:
        yield client


@pytest.fixture
def idle_client(shared_simulated_rig, tmp_path) -> Iterator[TestClient]:
    """On the rig that all share: for what moves nothing and starts nothing."""
    config = load_config(shared_simulated_rig.toml)
    with TestClient(create_app(config, tmp_path / "sessions"), base_url=ORIGIN) as client:
        yield client


@pytest.fixture
def wait_for(client) -> Callable[..., dict]:
    def wait(session: str, *states: str, timeout_s: float = 60.0) -> dict:
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            found = client.get(f"{API}/sessions/{session}").json()
            if found["state"] in states:
                return found
            time.sleep(0.05)
        raise AssertionError(f"{session} is {found['state']}, not {states}")

    return wait


@pytest.fixture
def wait_for_step(client) -> Callable[[str], None]:
    """Until one step is taken: everything is mounted, so that a session may be paused."""

    def wait(session: str) -> None:
        while client.get(f"{API}/sessions/{session}").json()["done"] == 0:
            time.sleep(0.02)

    return wait


def start(client: TestClient, plan: dict) -> str:
    reply = client.post(f"{API}/sessions", json=plan)
    assert reply.status_code == 201, reply.text
    return reply.headers["location"].rsplit("/", 1)[1]


@pytest.fixture
def start_session(client) -> Callable[[dict], str]:
    return lambda plan: start(client, plan)
