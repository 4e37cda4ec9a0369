"""Who may ask, what may be asked, and how a refusal reads; no device is touched."""

import json
import threading
from concurrent.futures import CancelledError

import pytest
from fastapi.testclient import TestClient
from starlette.testclient import WebSocketDenialResponse
from starlette.websockets import WebSocketDisconnect

from rig.config import load_config
from rig.errors import DiskFullError
from service.app import create_app
from service.guard import MOST_BYTES
from service.host import SessionHost
from service.jobs import Job, Jobs
from service.messages import MOST_KEPT, Messages
from service.problems import NotFoundError
from tests.service.conftest import API, LIVE, ORIGIN, SMALL_BTF

ACTION = f"{API}/sessions/none/actions/stop"


@pytest.fixture
def client(shared_simulated_rig, tmp_path):
    app = create_app(load_config(shared_simulated_rig.toml), tmp_path / "sessions")
    with TestClient(app, base_url=ORIGIN, raise_server_exceptions=False) as client:
        yield client


def refused(reply, status, code):
    assert (reply.status_code, reply.headers["content-type"]) == (status, "application/problem+json"), reply.text
    body = reply.json()
    assert (body["status"], body["code"], body["type"]) == (status, code, f"/problems/{code}")
    assert body["title"]
    assert body["detail"]
    return body["detail"]


@pytest.mark.parametrize("host", ["rig.example", "127.0.0.1.rig.example", "rig.example:80", ""])
def test_a_name_that_was_pointed_at_this_machine_is_refused(client, host):
    refused(client.get(f"{API}/devices", headers={"host": host}), 400, "bad-request")


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost:8100", "[::1]:8100"])
def test_names_of_this_machine_are_served(client, host):
    assert client.get(f"{API}/plans/schema", headers={"host": host}).status_code == 200


@pytest.mark.parametrize("origin", ["http://rig.example", "http://127.0.0.1:9999", "null"])
def test_a_page_of_another_site_can_neither_act_nor_listen(client, origin):
    """Its browser sends a POST without a body, or opens a WebSocket, without asking first."""
    refused(client.post(ACTION, headers={"origin": origin}), 403, "forbidden")
    events = f"{LIVE}/sessions/none/events"
    with pytest.raises(WebSocketDenialResponse) as denied, client.websocket_connect(events, headers={"origin": origin}):
        pass
    refused(denied.value, 403, "forbidden")


def test_the_start_page_may_act(client):
    refused(client.post(ACTION, headers={"origin": ORIGIN}), 404, "not-found")


def test_the_start_page_cannot_be_framed_by_another(client):
    assert "frame-ancestors 'none'" in client.get("/").headers["content-security-policy"]


def test_a_body_has_a_bound_told_or_not(client):
    plan = json.dumps(SMALL_BTF | {"padding": "x" * MOST_BYTES})
    refused(client.post(f"{API}/plans/validate", content=plan), 413, "content-too-large")
    pieces = iter([plan[:1000].encode(), plan[1000:].encode()])
    reply = client.post(f"{API}/plans/validate", content=pieces, headers={"content-type": "application/json"})
    refused(reply, 413, "content-too-large")


@pytest.mark.parametrize(
    ("body", "status", "code"),
    [
        ("{", 400, "malformed-request"),
        ("[" * 100_000, 400, "bad-request"),
        ("[]", 422, "malformed-request"),
        ("7", 422, "malformed-request"),
        ('{"kind": "btf"}', 422, "impossible-plan"),
        (json.dumps(SMALL_BTF | {"exposures_s": [float("nan")]}), 422, "impossible-plan"),
        (json.dumps(SMALL_BTF | {"turntable_deg": [float("inf")]}), 422, "impossible-plan"),
        (json.dumps(SMALL_BTF | {"turntable_deg": [1e400]}), 422, "impossible-plan"),
    ],
    ids=["cut", "deep", "list", "number", "missing", "nan", "infinite", "huge"],
)
def test_what_is_not_json_is_a_bad_request_and_what_is_no_plan_is_told(client, body, status, code):
    for path in ("plans/validate", "sessions"):
        reply = client.post(f"{API}/{path}", content=body, headers={"content-type": "application/json"})
        refused(reply, status, code)
    assert client.get(f"{API}/sessions").json() == []


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("GET", "/nowhere"),
        ("GET", f"{API}/sessions/none"),
        ("GET", f"{API}/sessions/none/frames"),
        ("GET", f"{API}/sessions/none/frames/step/cam1.png"),
        ("GET", f"{API}/sessions/none/products"),
        ("GET", f"{API}/sessions/none/products/srf/picture.png"),
        ("GET", f"{API}/sessions/%00"),
        ("GET", f"{API}/sessions/{'x' * 300}"),
        ("GET", f"{API}/sessions/%2e%2e"),
        ("POST", f"{API}/sessions/none/process"),
        ("POST", ACTION),
        ("POST", f"{API}/sessions/none/actions/dance"),
        ("GET", f"{API}/jobs/1"),
        ("GET", f"{API}/jobs/first"),
        ("DELETE", f"{API}/jobs/1"),
    ],
)
def test_an_address_of_nothing_is_not_found(client, method, path):
    refused(client.request(method, path, json={} if method == "POST" else None), 404, "not-found")


def test_a_method_that_an_address_does_not_have_names_those_that_it_has(client):
    reply = client.put(f"{API}/devices")
    refused(reply, 405, "method-not-allowed")
    assert reply.headers["allow"] == "GET"


def test_a_damaged_session_hides_no_other(client):
    for name, text in (("broken", "{"), (".part-of-one", "{}")):
        folder = client.app.state.host.folder / name
        folder.mkdir()
        (folder / "session.json").write_text(text)
    (entry,) = client.get(f"{API}/sessions").json()
    assert (entry["id"], entry["state"]) == ("broken", "unreadable")
    assert "session.json" in entry["problem"]
    refused(client.get(f"{API}/sessions/broken"), 500, "session-unreadable")
    refused(client.post(f"{API}/sessions/broken/actions/start"), 500, "session-unreadable")


def test_a_defect_is_a_problem_that_tells_nothing_of_the_inside(client, monkeypatch):
    def fails(self):
        raise ZeroDivisionError("secret")

    monkeypatch.setattr(SessionHost, "running", fails)
    assert "secret" not in refused(client.get(f"{API}/devices"), 500, "defect")


def test_what_the_system_refuses_is_a_problem(client, monkeypatch):
    def fails(self):
        raise PermissionError(13, "Permission denied", "sessions")

    monkeypatch.setattr(SessionHost, "ids", fails)
    assert "Permission denied" in refused(client.get(f"{API}/sessions"), 500, "unusable-file")


def test_events_of_no_session_end_with_a_code_of_their_own(client):
    with client.websocket_connect(f"{LIVE}/sessions/none/events") as socket, pytest.raises(WebSocketDisconnect) as end:
        socket.receive_json()
    assert end.value.code == 4004


def test_messages_are_numbered_and_told_once():
    messages = Messages()
    for step in range(5):
        messages.add({"step": step})
    assert [(message["sequence"], message["step"]) for message in messages.after(3)] == [(4, 3), (5, 4)]
    assert messages.after(5) == []
    assert len(messages.after(0)) == 5
    assert messages.after(99) == messages.after(0)  # a number of an earlier life of the service


def test_only_the_newest_messages_are_kept():
    messages = Messages()
    for _ in range(MOST_KEPT + 3):
        messages.add({})
    assert [messages.after(0)[place]["sequence"] for place in (0, -1)] == [4, MOST_KEPT + 3]
    assert [message["sequence"] for message in messages.after(MOST_KEPT)] == [MOST_KEPT + n for n in (1, 2, 3)]


@pytest.fixture
def jobs():
    jobs = Jobs()
    yield jobs
    jobs.close()


def test_a_job_that_waits_is_cancelled_without_being_started(jobs):
    go, started = threading.Event(), threading.Event()
    first = jobs.submit("first", lambda job: go.wait(30))
    second = jobs.submit("second", lambda job: started.set())
    assert jobs.read(second)["state"] == "waiting"
    jobs.cancel(second)
    go.set()
    jobs.close()
    assert [jobs.read(number)["state"] for number in (first, second)] == ["finished", "cancelled"]
    assert not started.is_set()


def test_a_job_that_runs_is_cancelled_at_its_next_part(jobs):
    seen = []

    def work(job: Job) -> None:
        for item in job.track(range(3), "parts"):
            seen.append(item)
            jobs.cancel(job.number)

    number = jobs.submit("work", work)
    jobs.close()
    assert seen == [0]
    assert (jobs.read(number)["state"], jobs.read(number)["total"]) == ("cancelled", 3)


@pytest.mark.parametrize(
    ("error", "code"), [(DiskFullError("no room"), "disk-full"), (ZeroDivisionError("no room"), "defect")]
)
def test_a_job_that_fails_says_why(jobs, error, code, caplog):
    def work(job: Job) -> None:
        raise error

    number = jobs.submit("work", work)
    jobs.close()
    assert jobs.read(number)["state"] == "failed"
    assert jobs.read(number)["problem"] == {"code": code, "detail": "no room"}
    assert ("Traceback" in caplog.text) == (code == "defect")  # of what nobody expected the log has more


def test_a_cancelled_part_ends_the_work():
    job = Job(1, "work")
    job.cancelled.set()
    with pytest.raises(CancelledError):
        next(job.track([1], "parts"))


def test_there_is_no_job_that_was_not_submitted(jobs):
    with pytest.raises(NotFoundError, match="no job 1"):
        jobs.read(1)
