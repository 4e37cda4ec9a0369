"""An `environment` session over the real wire: the phone photographs a known place, and its light comes back."""

import hashlib
import json

import numpy as np
import pytest

from processing.environment.equirectangular import Panorama, cubemap_of
from processing.products import Environment
from processing.products.light_environment import cube_directions
from rig import load_config, open_rig
from rig.errors import FrameCheckError, UnknownDeviceError
from rig.sessions import Runner, Session, State, parse_plan
from service.console import ConsoleProgress
from service.pipeline import process

ROOM = {"kind": "environment", "place": "room", "exposures_s": [0.5, 0.125, 1 / 30, 0.008, 0.002], "texels": 16}
SHORT = {"kind": "environment", "place": "hall", "exposures_s": [0.01, 1 / 2000, 1 / 32_000]}


@pytest.fixture
def lab(shared_simulated_rig):
    """The running simulators, mended and put back afterwards."""
    shared_simulated_rig.control("clear_faults")
    yield shared_simulated_rig
    shared_simulated_rig.control("clear_faults")
    shared_simulated_rig.control("mount", place="room", facing="front")


def captured(lab, folder, data, operator=None):
    """A finished session, open."""
    session = Session.create(folder, parse_plan(data), load_config(lab.toml))
    with open_rig(session.config) as rig:
        run = Runner(session, rig, operator or (lambda mount: lab.control("mount", **mount))).run()
    assert run.state is State.FINISHED
    return session


def errors(session, folder, lab, unit):
    """Light in another place or amount over all light, and of a diffuse sphere lit by it."""
    told = lab.control("truth", what="environment")
    truth = cubemap_of(Panorama(np.load(told["path"])), session.plan.texels)
    found = Environment((Environment.load(folder).radiance * np.array(told[unit])).astype(np.float32))
    weight, normals = truth.solid_angles[..., None], cube_directions(4).reshape(-1, 3)
    misplaced = (weight * np.abs(found.radiance - truth.radiance)).sum() / (weight * truth.radiance).sum()
    ours, true = found.irradiance(normals), truth.irradiance(normals)
    return misplaced, np.sqrt(np.mean((ours - true) ** 2)) / true.mean()


@pytest.mark.parametrize(("files", "unit", "ending"), [("jpeg", "unit", ".jpg"), ("raw", "unit_raw", ".dng")])
def test_the_light_of_a_room_comes_back(lab, tmp_path, files, unit, ending):
    """Of JPEG with a response that no file states, and of raw files: a sphere is lit within 2 %."""
    with captured(lab, tmp_path / "room", {**ROOM, "files": files}) as session:
        assert {record.path.suffix for record in session.frames()} == {ending}
        assert session.verify() == 2 * len(ROOM["exposures_s"])
        (made,) = process(session, [], ConsoleProgress())
        stamp = (made / "product.json").stat().st_mtime_ns
        assert process(session, [], ConsoleProgress()) == [made]
        assert (made / "product.json").stat().st_mtime_ns == stamp, "nothing has changed: not made again"
        misplaced, sphere = errors(session, made, lab, unit)
        assert sphere < 0.02
        assert misplaced < 0.08
        assert session.id in json.loads((made / "product.json").read_text())["provenance"]["frames"]
    assert all((made / name).stat().st_size > 10_000 for name in ("found.png", "environment.png"))


def test_the_operator_is_asked_for_each_facing_and_the_files_say_which(lab, tmp_path):
    asked = []

    def operator(mount):
        asked.append(dict(mount))
        lab.control("mount", **mount)

    with captured(lab, tmp_path / "hall", SHORT, operator):
        assert asked == [{"place": "hall", "facing": "front"}, {"place": "hall", "facing": "back"}]
        notes = (lab.state / "truth" / "frames.jsonl").read_text().splitlines()[-6:]
        taken = [json.loads(line) for line in notes]
        assert [(one["place"], one["facing"]) for one in taken] == [("hall", "front")] * 3 + [("hall", "back")] * 3
        assert [one["exposure_s"] for one in taken] == [0.01, 1 / 2000, 1 / 32_000] * 2
        assert not lab.control("status")["lamps"]


def test_bad_frames_are_taken_again_and_none_is_lost(lab, tmp_path):
    """Another camera's file, a frozen one, a lost one: the session is as without them."""
    digests = []
    for faulty in (False, True):
        if faulty:
            for fault in ({"kind": "wrong_camera", "other": "cam3"}, {"kind": "frozen", "count": 1},
                          {"kind": "no_frame"}):  # fmt: skip
                lab.control("fault", device="phone", **fault)
        with captured(lab, tmp_path / f"{faulty}", SHORT) as session:
            assert session.verify() == 6
            retakes = [event for event in session.events() if event.kind == "retake"]
            assert bool(retakes) == faulty
            digests.append([hashlib.sha256(record.path.read_bytes()).hexdigest() for record in session.frames()])
    assert len(set(digests[0])) == len(set(digests[1])) == 6


def test_a_session_that_is_stopped_goes_on_where_it_was(lab, tmp_path):
    with Session.create(tmp_path / "s", parse_plan(SHORT), load_config(lab.toml)) as session:
        with open_rig(session.config) as rig:
            runner = Runner(session, rig, lambda mount: None, lambda event: stop(event))

            def stop(event):
                if event.kind == "done" and event.done == 2:
                    runner.stop()

            assert runner.run().state is State.INTERRUPTED
        before = {record.path: record.path.read_bytes() for record in session.frames()}
        assert 2 <= len(before) < 6
        with open_rig(session.config) as rig:
            assert Runner(session, rig, lambda mount: lab.control("mount", **mount)).run().state is State.FINISHED
        assert session.verify() == 6
        assert all(path.read_bytes() == data for path, data in before.items())


def test_a_rig_without_a_phone_says_so(lab, tmp_path):
    config = load_config(lab.toml)
    cameras = {name: camera for name, camera in config.cameras.items() if name != "phone"}
    with pytest.raises(UnknownDeviceError, match="no camera named 'phone'"):
        Session.create(tmp_path / "s", parse_plan(SHORT), config.model_copy(update={"cameras": cameras}))


def test_a_phone_that_is_another_ends_the_session(lab, tmp_path):
    lab.control("fault", device="phone", kind="wrong_camera", other="cam3", count=9)
    with (
        Session.create(tmp_path / "s", parse_plan(SHORT), load_config(lab.toml)) as session,
        open_rig(session.config) as rig,
        pytest.raises(FrameCheckError, match="expected serial PH-0001, frame carries VC-0003"),
    ):
        Runner(session, rig, lambda mount: lab.control("mount", **mount)).run()
    with Session.open(tmp_path / "s") as session:
        assert session.state is State.FAILED
        assert not session.frames()
