"""Relighting sessions of the service, driven as a client would."""

import io
import json
import threading
import time

import numpy as np
import pytest
from fastapi.testclient import TestClient
from PIL import Image
from starlette.testclient import WebSocketDenialResponse
from typer.testing import CliRunner

from processing.products import BlinnPhong, Environment, Srf
from rig.config import load_config
from rig.sessions import Session, parse_plan
from service.app import create_app
from service.cli import app as cli
from service.relightings import MOST, Relightings
from tests.service.conftest import API, LIVE, ORIGIN, SMALL_BTF
from tests.service.relit_scenes import COARSE, write_scene

NIGHT = {"kind": "environment", "name": "night"}


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    return tmp_path_factory.mktemp("kept")


@pytest.fixture
def client(shared_simulated_rig, tmp_path, kept):
    write_scene(tmp_path / "scenes")
    (tmp_path / "sessions").mkdir()
    (tmp_path / "sessions" / ".precomputed").symlink_to(kept)
    app = create_app(load_config(shared_simulated_rig.toml), tmp_path / "sessions", tmp_path / "scenes")
    with TestClient(app, base_url=ORIGIN) as client:
        yield client
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("relighting")]


class Socket:
    """A client's end of a relighting's WebSocket."""

    def __init__(self, socket) -> None:
        self._socket = socket

    def say(self, **change) -> None:
        self._socket.send_text(json.dumps(change))

    def hear(self, kind):
        """The next message of a kind, its picture beside it where it has one."""
        while True:
            message = self._socket.receive_json()
            picture = self._socket.receive_bytes() if message["kind"] == "frame" else None
            if message["kind"] == kind:
                return message, picture

    def frame(self, *, rough=False):
        """The next frame that is as fine as asked for, as codes."""
        while True:
            message, content = self.hear("frame")
            if message["rough"] == rough:
                picture = Image.open(io.BytesIO(content))
                assert picture.format == ("JPEG" if rough else "PNG")
                assert picture.size == (message["width_px"], message["height_px"])
                return message, np.asarray(picture).astype(int)


def open_scene(client, **wanted):
    reply = client.post(f"{API}/relightings", json=wanted or {"scene": "coarse.toml"})
    assert reply.status_code == 201, reply.text
    return reply.headers["location"].rsplit("/", 1)[1]


@pytest.fixture
def socket(client):
    with client.websocket_connect(f"{LIVE}/relightings/{open_scene(client)}/frames") as socket:
        yield Socket(socket)


def test_changes_are_made_and_shown_and_only_they_are_computed(socket):
    """The order of what is counted: moving, cached, kept."""
    assert socket.hear("ready")[0]["bodies"] == ["floor", "box", "brick"]
    first, picture = socket.frame()
    assert first["moving"] > 0
    assert 0 < first["visible_share"] < 1
    socket.say(kind="window", width_px=720, height_px=480)
    same, again = socket.frame()
    assert (same["moving"], same["cached"]) == (0, 0)
    assert np.array_equal(again, picture)

    socket.say(kind="light", azimuth_deg=120)
    turned, lit = socket.frame()
    assert turned["moving"] == turned["kept"] == 0
    assert turned["standing"]["light_azimuth_deg"] == pytest.approx(120)
    socket.say(kind="move", body="brick", place_mm=[150, -200, 51])
    moved, there = socket.frame()
    assert moved["moving"] > 0
    socket.say(kind="paint", body="brick", material="red")
    painted, red = socket.frame()
    assert painted["moving"] == 0
    assert 0 < painted["cached"] < painted["kept"]
    socket.say(kind="eye", azimuth_deg=-20, elevation_deg=50, distance_mm=1500)
    looked, elsewhere = socket.frame()
    assert looked["moving"] == 0
    socket.say(**NIGHT)
    night, dark = socket.frame()
    assert night["standing"]["environment"] == "night"
    for one, two in ((picture, lit), (lit, there), (there, red), (red, elsewhere), (elsewhere, dark)):
        assert (np.abs(one - two).max(axis=2) > 8).mean() > 0.001


def test_a_picture_is_that_of_the_command(socket, client, tmp_path):
    _, picture = socket.frame()
    arguments = ["relight", str(tmp_path / "scenes" / "coarse.toml"), "-o", str(tmp_path / "own.png"),
                 "--precomputed", str(tmp_path / "sessions" / ".precomputed")]  # fmt: skip
    told = CliRunner().invoke(cli, arguments)
    assert told.exit_code == 0, told.output
    assert np.array_equal(np.asarray(Image.open(tmp_path / "own.png")), picture)


def test_while_more_is_to_come_pictures_are_rough_and_then_one_is_fine(socket):
    _, picture = socket.frame()
    for k in range(40):
        socket.say(kind="eye", azimuth_deg=-50 - k, rough=True)
    socket.say(kind="eye", elevation_deg=31, rough=True)
    _, small = socket.frame(rough=True)
    assert 2 * np.array(small.shape[:2]).max() == picture.shape[1]
    while (eye := socket.frame()[0]["standing"]["eye"])["elevation_deg"] < 30.9:
        pass  # a busy machine may pause for long enough to draw one in between
    assert eye["azimuth_deg"] == pytest.approx(-89)


def test_rough_pictures_are_fewer_than_the_changes_that_came_meanwhile(socket):
    socket.frame()
    for k in range(60):
        socket.say(kind="light", azimuth_deg=k, rough=True)
    count = 1
    while (told := socket.hear("frame")[0])["rough"] or told["standing"]["light_azimuth_deg"] < 58.9:
        count += 1
    assert count < 60


REFUSED = [
    ({"kind": "move", "body": "sofa", "place_mm": [0, 0, 0]}, "not-found", "floor, box, brick"),
    ({"kind": "paint", "body": "box", "material": "blue"}, "not-found", "red, lacquer"),
    ({"kind": "environment", "name": "../day"}, "not-found", "day, night"),
    ({"kind": "paint", "body": "box", "material": {"product": "/etc"}}, "malformed-config", "[materials]"),
    ({"kind": "paint", "body": "box", "material": {"kind": "ggx"}}, "malformed-config", "diffuse"),
    ({"kind": "eye", "elevation_deg": 95}, "malformed-config", "elevation_deg"),
    ({"kind": "move", "body": "box", "place_mm": [1e9, 0, 0]}, "malformed-config", "place_mm"),
    ({"kind": "dance"}, "malformed-config", "dance"),
    ({"kind": "light", "azimuth_deg": 0, "name": 5000 * "x"}, "malformed-config", "4096"),
]


def test_what_cannot_be_is_told_and_changes_nothing(socket):
    before, picture = socket.frame()
    for change, code, named in REFUSED:
        socket.say(**change)
        told, _ = socket.hear("problem")
        assert told["code"] == code, change
        assert named in told["detail"]
    socket.say(kind="window", width_px=720, height_px=480)
    after, same = socket.frame()
    assert after["standing"] == before["standing"]
    assert np.array_equal(same, picture)


def problem(reply, status, code):
    assert (reply.status_code, reply.json()["code"]) == (status, code), reply.text
    return reply.json()["detail"]


def test_scenes_that_are_not_there_or_not_right_are_refused(client, tmp_path):
    assert client.get(f"{API}/scenes").json() == {"scenes": ["coarse.toml"], "environments": ["day", "night"]}
    assert "coarse.toml" in problem(client.post(f"{API}/relightings", json={"scene": "../x.toml"}), 404, "not-found")
    write_scene(tmp_path / "scenes", COARSE.replace('mesh = "box"', 'mesh = "bx"', 1), "bad.toml")
    assert "bx" in problem(client.post(f"{API}/relightings", json={"scene": "bad.toml"}), 422, "malformed-config")
    problem(client.post(f"{API}/relightings", json={"scen": 1}), 422, "malformed-request")
    for reply in (client.get(f"{API}/relightings/1"), client.delete(f"{API}/relightings/1")):
        problem(reply, 404, "not-found")
    with client.websocket_connect(f"{LIVE}/relightings/1/frames") as socket:
        assert socket.receive()["code"] == 4004
    assert client.get(f"{API}/relightings").json() == []


def test_so_many_are_open_at_once_and_one_that_is_closed_makes_room(client):
    numbers = [open_scene(client) for _ in range(MOST)]
    wanted = {"scene": "coarse.toml"}
    assert "close one" in problem(client.post(f"{API}/relightings", json=wanted), 409, "busy")
    with client.websocket_connect(f"{LIVE}/relightings/{numbers[0]}/frames") as socket:
        assert client.delete(f"{API}/relightings/{numbers[0]}").status_code == 204
        assert Socket(socket).hear("end")[0]["reason"] == "it was closed"
    problem(client.get(f"{API}/relightings/{numbers[0]}"), 404, "not-found")
    assert [one["id"] for one in client.get(f"{API}/relightings").json()] == [int(one) for one in numbers[1:]]
    open_scene(client)


def test_one_that_nobody_talks_to_ends_by_itself(client):
    client.app.state.relightings._idle_s = 0.3
    with client.websocket_connect(f"{LIVE}/relightings/{open_scene(client)}/frames") as socket:
        assert "nobody" in Socket(socket).hear("end")[0]["reason"]
    assert client.get(f"{API}/relightings/1").json()["state"] == "ended"


def test_a_job_that_is_cancelled_or_fails_ends_its_relighting(client, tmp_path):
    sessions = tmp_path / "sessions"
    (sessions / ".precomputed").unlink()
    (sessions / ".precomputed").write_text("a file where the folder is to be")
    number = open_scene(client)
    with client.websocket_connect(f"{LIVE}/relightings/{number}/frames") as socket:
        assert Socket(socket).hear("end")[0]["reason"] == "it failed"
    told = client.get(f"{API}/relightings/{number}").json()
    assert (told["state"], told["problem"]["code"]) == ("failed", "unusable-file")
    (sessions / ".precomputed").unlink()

    held = threading.Event()
    client.app.state.jobs.submit("before", lambda job: held.wait(20))
    number = open_scene(client)
    job = client.get(f"{API}/relightings/{number}").json()["job"]["id"]
    client.delete(f"{API}/jobs/{job}")
    held.set()
    while (told := client.get(f"{API}/relightings/{number}").json())["state"] == "precomputing":
        time.sleep(0.02)
    assert (told["state"], told["problem"]) == ("ended", None)


def test_a_captured_material_stands_on_a_shape_under_any_environment(client, tmp_path):
    host = client.app.state.host
    with Session.create(host.folder / "stone", parse_plan(SMALL_BTF), host.config) as session:
        lobe = BlinnPhong(np.array([0.4, 0.1, 0.1]), np.array([0.2, 0.2, 0.2]), 20.0)
        Srf(np.zeros((3, 4, 4, 3), np.float32), lobe, wrap=True).save(session.products / "srf")
        Environment(np.ones((6, 4, 4, 3), np.float32)).save(session.products / "environment")
    assert client.get(f"{API}/scenes").json()["environments"] == ["day", "night", "stone"]
    wanted = {"session": "stone", "product": "srf", "environment": "stone", "shape": "sphere"}
    number = open_scene(client, **wanted)
    told = client.get(f"{API}/relightings/{number}").json()
    assert (told["title"], told["bodies"], told["materials"]) == (
        "srf of stone",
        ["floor", "sphere"],
        ["srf", "of floor"],
    )
    assert told["environments"] == ["stone", "day", "night"]
    lowest = client.app.state.relightings.session(int(number)).scene.bodies[1]
    assert (lowest.mesh.positions + lowest.place.place_m)[:, 2].min() == pytest.approx(1e-3)
    assert client.delete(f"{API}/relightings/{number}").status_code == 204  # while it is precomputed
    problem(client.post(f"{API}/relightings", json=wanted | {"environment": "noon"}), 404, "not-found")
    problem(client.post(f"{API}/relightings", json=wanted | {"product": "../.."}), 404, "not-found")


def test_frames_are_for_pages_of_this_machine(client):
    number = open_scene(client)
    frames, elsewhere = f"{LIVE}/relightings/{number}/frames", {"origin": "http://elsewhere.example"}
    with pytest.raises(WebSocketDenialResponse) as denied, client.websocket_connect(frames, headers=elsewhere):
        pass
    assert denied.value.status_code == 403


def test_no_relighting_opens_once_the_service_ends(client):
    relightings: Relightings = client.app.state.relightings
    relightings.close()
    problem(client.post(f"{API}/relightings", json={"scene": "coarse.toml"}), 409, "busy")
