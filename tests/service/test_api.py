"""The REST service over the real rig layer and real simulators."""

import io
import json
import re
import time

import numpy as np
import pytest
from fastapi.testclient import TestClient
from PIL import Image

from processing.products import BlinnPhong, Srf
from rig.config import load_config
from rig.sessions import Session, parse_plan
from service.app import create_app
from tests.service.conftest import (
    API,
    CALIBRATE,
    LIVE,
    LONG_BTF,
    LONG_STEPS,
    ORIGIN,
    ROOT_OPENAPI,
    SENSOR,
    SMALL_BTF,
    UNTOLD_MDF,
)


def problem(reply, status, code):
    assert reply.status_code == status, reply.text
    assert reply.headers["content-type"] == "application/problem+json"
    body = reply.json()
    assert (body["status"], body["code"]) == (status, code)
    assert body["detail"]
    return body["detail"]


def test_devices_are_those_of_the_rig(idle_client):
    devices = idle_client.get(f"{API}/devices").json()
    assert set(devices["axes"]) == {"arm", "light_arc", "turntable"}
    assert devices["held_by"] is None


def test_an_axis_goes_where_it_is_sent_and_says_so(client, simulated_rig):
    moved = client.post(f"{API}/devices/axes/turntable/moves", json={"angle_deg": 12.5}).json()
    assert moved["angle_deg"] == pytest.approx(12.5, abs=0.01)
    assert simulated_rig.control("status")["axes"]["turntable"]["deg"] == pytest.approx(12.5, abs=0.05)


def test_unknown_devices_and_angles_out_of_range_move_nothing(idle_client, shared_simulated_rig):
    before = shared_simulated_rig.control("status")["axes"]
    assert "turntable" in problem(idle_client.get(f"{API}/devices/axes/tilt"), 404, "unknown-device")
    reply = idle_client.post(f"{API}/devices/axes/turntable/moves", json={"angle_deg": 500})
    assert "-200 to 200" in problem(reply, 422, "out-of-range")
    reply = idle_client.post(f"{API}/devices/axes/light_arc/moves", json={"angle_deg": 0})
    problem(reply, 422, "interlock")
    problem(idle_client.post(f"{API}/devices/axes/turntable/moves", json={"angle": 5}), 422, "malformed-request")
    assert shared_simulated_rig.control("status")["axes"] == before


def test_a_plan_is_checked_and_forecast_without_a_session(idle_client):
    found = idle_client.post(f"{API}/plans/validate?steps=true", json=SMALL_BTF).json()
    assert found["steps"] == len(found["dry_run"]) == 4
    assert found["forecast"]["frames"] == 8
    assert found["forecast"]["time_s"] > found["forecast"]["lower_bound_s"] > 0
    assert idle_client.get(f"{API}/sessions").json() == []


@pytest.mark.parametrize(
    ("change", "status", "code", "named"),
    [
        ({"lamps": ["sun"]}, 404, "unknown-device", "sun"),
        ({"light_azimuth_deg": [0], "turntable_deg": [0]}, 422, "impossible-plan", "light_arc"),  # before the cameras
        ({"texel": 8}, 422, "impossible-plan", "texel"),
        ({"exposures_s": []}, 422, "impossible-plan", "exposures_s"),
        ({"kind": "video"}, 422, "impossible-plan", "kind"),
    ],
)
def test_an_impossible_plan_never_becomes_a_session(idle_client, change, status, code, named):
    for path in ("plans/validate", "sessions"):
        assert named in problem(idle_client.post(f"{API}/{path}", json=SMALL_BTF | change), status, code)
    assert idle_client.get(f"{API}/sessions").json() == []


def test_a_session_tells_the_exposure_that_a_test_sweep_chose(client, start_session):
    checked = client.post(f"{API}/plans/validate?steps=true", json=UNTOLD_MDF).json()
    assert ["test sweep" in line for line in checked["dry_run"]] == [True, False]
    session = start_session(UNTOLD_MDF)
    with client.websocket_connect(f"{LIVE}/sessions/{session}/events") as socket:
        told = [socket.receive_json()]
        while told[-1]["kind"] != "end":
            told.append(socket.receive_json())
    test, sweep = (message for message in told if message["kind"] == "done")
    (frame,) = client.get(f"{API}/sessions/{session}/frames").json()
    assert f"exposure {frame['exposure_s']:.4f} s chosen from a test sweep" in test["message"]
    assert (frame["step"], test["step"]) == (sweep["step"], f"{sweep['step']}_test")


def test_a_session_runs_to_its_end_and_tells_it_live(client, start_session, wait_for):
    session = start_session(CALIBRATE)
    with client.websocket_connect(f"{LIVE}/sessions/{session}/events") as socket:
        told = [socket.receive_json()]
        while told[-1]["kind"] != "end":
            told.append(socket.receive_json())
    assert told[-1]["exit_code"] == 0
    assert sum(message["kind"] == "done" for message in told) == CALIBRATE["board_poses"]
    assert any(message.get("eta_s") for message in told)
    assert wait_for(session, "finished")["allowed"] == []

    with client.websocket_connect(f"{LIVE}/sessions/{session}/events?after={len(told) - 2}") as socket:
        assert [socket.receive_json(), socket.receive_json()] == told[-2:]

    frames = client.get(f"{API}/sessions/{session}/frames").json()
    assert len(frames) == CALIBRATE["board_poses"] * len(CALIBRATE["cameras"])
    of_step = client.get(f"{API}/sessions/{session}/frames", params={"step": frames[0]["step"]}).json()
    assert of_step == [frame for frame in frames if frame["step"] == frames[0]["step"]]
    picture = client.get(f"{API}/sessions/{session}/frames/{frames[0]['step']}/{frames[0]['camera']}.png")
    assert np.asarray(Image.open(io.BytesIO(picture.content))).std() > 10
    problem(client.get(f"{API}/sessions/{session}/frames/none/cam1.png"), 404, "not-found")


def test_pause_holds_the_rig_dark_and_resume_goes_on(client, start_session, wait_for, wait_for_step, simulated_rig):
    session = start_session(LONG_BTF)
    wait_for_step(session)
    assert client.post(f"{API}/sessions/{session}/actions/pause").status_code == 202
    wait_for(session, "paused")
    assert simulated_rig.control("status")["lamps"] == {}
    detail = problem(client.post(f"{API}/sessions/{session}/actions/pause"), 409, "wrong-state")
    assert "resume" in detail
    problem(client.post(f"{API}/sessions", json=SMALL_BTF), 409, "busy")
    problem(client.get(f"{API}/devices/axes/turntable"), 409, "busy")
    assert client.post(f"{API}/sessions/{session}/actions/resume").status_code == 202
    assert wait_for(session, "finished")["done"] == LONG_STEPS


@pytest.mark.parametrize(("action", "state"), [("stop", "interrupted"), ("abort", "aborted")])
def test_a_session_that_was_ended_is_dark_and_can_be_taken_up_again(
    client, start_session, wait_for, wait_for_step, simulated_rig, action, state
):
    session = start_session(LONG_BTF)
    wait_for_step(session)
    assert client.post(f"{API}/sessions/{session}/actions/{action}").status_code == 202
    assert 0 < wait_for(session, state)["done"] < LONG_STEPS
    status = simulated_rig.control("status")
    assert status["lamps"] == {}
    assert not any(axis["moving"] for axis in status["axes"].values())
    assert client.post(f"{API}/sessions/{session}/actions/start").status_code == 202
    assert wait_for(session, "finished")["done"] == LONG_STEPS


def test_a_stop_counts_from_the_first_moment(client, start_session, wait_for):
    """Its process has hardly begun: the stop must wait for it, and not be lost."""
    session = start_session(SMALL_BTF)
    assert client.post(f"{API}/sessions/{session}/actions/stop").status_code == 202
    assert wait_for(session, "interrupted", "finished")["done"] == 0


def test_a_person_acknowledges_what_was_mounted(start_simulators, tmp_path):
    """A rig without a simulated clock has no hands of its own."""
    simulators = start_simulators("--rate", "20")
    toml = tmp_path / "rig.toml"
    toml.write_text(re.sub(r"\[clock\]\naddress = .*\n", "", simulators.toml.read_text()))
    plan = SMALL_BTF | {"turntable_deg": [0], "light_azimuth_deg": [135]}
    with TestClient(create_app(load_config(toml), tmp_path / "sessions"), base_url=ORIGIN) as client:
        session = client.post(f"{API}/sessions", json=plan).json()["id"]
        problem(client.post(f"{API}/sessions/{session}/actions/acknowledge"), 409, "wrong-state")
        with client.websocket_connect(f"{LIVE}/sessions/{session}/events") as socket:
            while (told := socket.receive_json()).get("state") != "waiting":
                pass
            assert client.post(f"{API}/sessions/{session}/actions/stop").status_code == 202  # nobody comes
            while (told := socket.receive_json())["kind"] != "end":
                pass
            assert told["exit_code"] == 0
            assert client.get(f"{API}/sessions/{session}").json()["state"] == "interrupted"

            assert client.post(f"{API}/sessions/{session}/actions/start").status_code == 202
            while (told := socket.receive_json()).get("state") != "waiting":
                pass
            simulators.control("mount", sample="brick")
            # At once, before the runner has asked: it must not be lost.
            assert client.post(f"{API}/sessions/{session}/actions/acknowledge").status_code == 202
            while (told := socket.receive_json())["kind"] != "end":
                pass
        assert client.get(f"{API}/sessions/{session}").json()["state"] == "finished"


def test_a_session_is_taken_up_on_the_rig_that_the_service_has_now(client, wait_for, start_simulators):
    """Simulators that were started again, or a device on another port: what the session remembers is out of date."""
    host = client.app.state.host
    with Session.create(host.folder / "old", parse_plan(SMALL_BTF), load_config(start_simulators().toml)):
        pass
    assert client.post(f"{API}/sessions/old/actions/start").status_code == 202
    assert wait_for("old", "finished", "failed", "idle")["state"] == "finished"


def test_a_service_that_ends_leaves_a_safe_rig_and_a_resumable_session(simulated_rig, tmp_path):
    app = create_app(load_config(simulated_rig.toml), tmp_path / "sessions")
    with TestClient(app, base_url=ORIGIN) as client:
        session = client.post(f"{API}/sessions", json=SMALL_BTF).json()["id"]
        while client.get(f"{API}/sessions/{session}").json()["state"] in ("idle", "preparing"):
            time.sleep(0.02)
    assert simulated_rig.control("status")["lamps"] == {}
    with TestClient(create_app(load_config(simulated_rig.toml), tmp_path / "sessions"), base_url=ORIGIN) as client:
        found = client.get(f"{API}/sessions/{session}").json()
        assert found["state"] in ("interrupted", "finished")


def test_a_session_is_processed_as_a_job_and_its_files_are_served(client, start_session, wait_for):
    session = start_session(CALIBRATE)
    wait_for(session, "finished")
    process(client, session)
    assert "calibration/cameras.json" in client.get(f"{API}/sessions/{session}/products").json()
    cameras = client.get(f"{API}/sessions/{session}/products/calibration/cameras.json").json()
    assert set(cameras["cameras"]) == set(CALIBRATE["cameras"])
    problem(client.get(f"{API}/sessions/{session}/products/nothing.png"), 404, "not-found")
    problem(client.get(f"{API}/sessions/{session}/products/nothing/picture.png"), 404, "not-found")
    problem(client.get(f"{API}/sessions/{session}/products/calibration/picture.png"), 422, "unusable-image")
    for look in ("sise=20", "azimuth_deg=nan", "size=100000"):
        reply = client.get(f"{API}/sessions/{session}/products/calibration/picture.png?{look}")
        problem(reply, 422, "malformed-request")
    (client.app.state.host.folder / session / "products" / "link.json").symlink_to("../session.json")
    for path in ("%2e%2e/session.json", "%2e%2e%2fsession.json", "link.json", "%00", "x" * 300, "%2e%2e/picture.png"):
        problem(client.get(f"{API}/sessions/{session}/products/{path}"), 404, "not-found")
    assert "link.json" not in client.get(f"{API}/sessions/{session}/products").json()


def test_a_measured_sensor_is_named_shown_and_used(client, start_session, wait_for):
    sensor = start_session(SENSOR)
    wait_for(sensor, "finished")
    process(client, sensor)
    assert client.get(f"{API}/sessions/{sensor}").json()["products"] == ["sensors/VC-0004"]
    reply = client.get(f"{API}/sessions/{sensor}/products/sensors/VC-0004/picture.png")
    assert reply.headers["content-type"] == "image/png"
    assert np.asarray(Image.open(io.BytesIO(reply.content))).std() > 10

    board = start_session(CALIBRATE)
    wait_for(board, "finished")
    process(client, board, calibrations=[sensor])
    problem(client.post(f"{API}/sessions/{board}/process", json={"calibrations": ["none"]}), 404, "not-found")


def process(client, session, **body):
    """Run the job that makes a session's products, to its end."""
    job = client.post(f"{API}/sessions/{session}/process", json=body)
    assert job.status_code == 201
    deadline = time.monotonic() + 60
    while (read := client.get(job.headers["location"]).json())["state"] in ("waiting", "running"):
        assert time.monotonic() < deadline
        time.sleep(0.1)
    assert read["state"] == "finished", read


def test_a_product_is_shown_under_any_light(idle_client, tmp_path):
    """The same SRF from two lights gives two pictures of the size that was asked for."""
    folder = tmp_path / "sessions" / "old"
    with Session.create(folder, parse_plan(SMALL_BTF), idle_client.app.state.host.config) as session:
        residual = np.zeros((3, 8, 8, 3), np.float32)
        Srf(residual, BlinnPhong(np.full(3, 0.2), np.full(3, 0.1), 20.0), wrap=True).save(session.products / "srf")
    pictures = []
    for azimuth_deg in (0, 90):
        look = {"shape": "sphere", "size": 64, "azimuth_deg": azimuth_deg}
        reply = idle_client.get(f"{API}/sessions/old/products/srf/picture.png", params=look)
        assert reply.status_code == 200, reply.text
        pictures.append(np.asarray(Image.open(io.BytesIO(reply.content)), float))
    assert pictures[0].shape == (64, 64, 3)
    assert np.abs(pictures[0] - pictures[1]).max() > 50


def test_a_session_with_steps_to_take_is_not_processed(idle_client):
    with Session.create(
        idle_client.app.state.host.folder / "new", parse_plan(CALIBRATE), idle_client.app.state.host.config
    ):
        pass
    job = idle_client.post(f"{API}/sessions/new/process", json={}).headers["location"]
    while (read := idle_client.get(job).json())["state"] in ("waiting", "running"):
        time.sleep(0.01)
    assert read["problem"]["code"] == "wrong-state"
    assert "4 of 4 steps" in read["problem"]["detail"]


def test_a_job_without_its_calibration_fails_with_its_problem(client, start_session, wait_for):
    session = start_session(SMALL_BTF)
    wait_for(session, "finished")
    job = client.post(f"{API}/sessions/{session}/process", json={}).headers["location"]
    while (read := client.get(job).json())["state"] in ("waiting", "running"):
        time.sleep(0.05)
    assert read["state"] == "failed"
    assert read["problem"]["code"] == "cannot-calibrate"


def test_the_start_page_uses_only_what_the_interface_offers(idle_client):
    page = idle_client.get("/").text
    assert "WebSocket" in page
    assert "/api/v1/plans/schema" in page


def test_the_interface_is_the_one_that_is_checked_in(idle_client):
    """A change of the REST interface shows in the diff: regenerate with `python -m service.openapi`."""
    assert idle_client.get(f"{API}/openapi.json").json() == json.loads(ROOT_OPENAPI.read_text())
