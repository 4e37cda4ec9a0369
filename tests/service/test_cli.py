"""The command line through real processes: what it makes, what it says, how it ends."""

import json
import re
import shutil
import signal
import socket
import urllib.request
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from processing.formats.raw import read_raw
from rig.sessions import Event, Session, State
from service.console import ConsoleProgress
from service.problems import EXIT_CODES
from tests.command import BTF, CALIBRATE, Said, ended, rig, running_rig, wait_until

LONG_BTF = BTF.replace("[0, 90]", "[0, 90, 180]").replace("[0.02]", "[0.01, 0.02]")
LONG_STEPS = 3 * 2 * 2 * 2
ONE_STEP = BTF.replace("[0, 90]", "[0]").replace("[45, 135]", "[135]").replace('"lamp3", ', "")


@pytest.fixture(scope="module")
def captured(tmp_path_factory):
    """A folder with a captured calibration `cal` and a captured btf `btf`, as two commands made them."""
    folder = tmp_path_factory.mktemp("captured")
    for name, plan in (("cal", CALIBRATE), ("btf", BTF)):
        (folder / f"{name}.toml").write_text(plan)
        said = rig("capture", f"{name}.toml", "--out", name, "--simulated", cwd=folder)
        assert said.code == 0, said.err
        assert "finished" in said.out
    return folder


@pytest.fixture
def long_plan(tmp_path):
    (tmp_path / "long.toml").write_text(LONG_BTF)
    return tmp_path


def frames_on_disk(session):
    return sorted(path.relative_to(session).as_posix() for path in (session / "frames").glob("*/*"))


def dark_and_still(status):
    return not status["lamps"] and not status["laser"] and not any(axis["moving"] for axis in status["axes"].values())


def test_help_names_every_exit_code(tmp_path):
    said = rig("--help", cwd=tmp_path)
    assert said.code == 0
    told = " ".join(said.out.split())
    for code, meaning in EXIT_CODES.items():
        assert f"{code} {meaning}" in told
    assert {"demo", "plan", "capture", "resume", "verify", "process", "preview", "merge", "serve", "bench"} <= set(
        re.findall(r"^│ (\w+)", said.out, re.MULTILINE)
    )


def test_a_plan_is_forecast_and_listed_step_by_step_and_nothing_moves(tmp_path, shared_simulated_rig):
    (tmp_path / "plan.toml").write_text(BTF)
    before = shared_simulated_rig.control("status")
    said = rig("plan", "plan.toml", "--rig", shared_simulated_rig.toml, "--steps", cwd=tmp_path)
    assert said.code == 0, said.err
    *steps, summary = said.out.splitlines()
    assert len(steps) == 8
    assert "8 steps, 16 frames" in summary
    told = json.loads(
        rig("plan", "plan.toml", "--rig", shared_simulated_rig.toml, "--steps", "--json", cwd=tmp_path).out
    )
    assert told["steps"] == len(told["dry_run"]) == 8
    assert told["frames"] == 16
    assert told["dry_run"] == steps
    assert told["time_s"] >= told["lower_bound_s"] > 0
    assert shared_simulated_rig.control("status") == before


def test_what_the_rig_cannot_use_is_named_with_its_reason(tmp_path, shared_simulated_rig):
    (tmp_path / "plan.toml").write_text(BTF.replace('["cam4", "cam7"]', '["cam4", "front"]'))
    said = rig("plan", "plan.toml", "--rig", shared_simulated_rig.toml, cwd=tmp_path)
    assert "8 frames" in said.out
    assert re.search(r"^skipped camera front: .*flat sample", said.out, re.MULTILINE)


def test_a_captured_session_is_whole(captured):
    said = rig("verify", "btf", cwd=captured)
    assert said.code == 0, said.err
    assert said.out == "btf: 16 files, all whole; 8 of 8 steps done.\n"
    told = json.loads(rig("verify", "btf", "--json", cwd=captured).out)
    assert told == {"files": 16, "done": 8, "total": 8}
    assert len(frames_on_disk(captured / "btf")) == 16


def test_a_finished_session_is_not_taken_again(captured):
    before = {
        name: sha256((captured / "btf" / name).read_bytes()).digest() for name in frames_on_disk(captured / "btf")
    }
    said = rig("resume", "btf", "--simulated", cwd=captured)
    assert said.code == 4
    assert said.error.startswith("wrong-state: ")
    assert before == {
        name: sha256((captured / "btf" / name).read_bytes()).digest() for name in frames_on_disk(captured / "btf")
    }


def test_frames_become_products_and_a_picture(captured):
    said = rig("process", "cal", cwd=captured)
    assert (said.code, said.out) == (0, f"{captured}/cal/products/calibration\n"), said.err
    cameras = captured / "cal/products/calibration/cameras.json"
    made_ns = cameras.stat().st_mtime_ns
    again = rig("process", "cal", "--json", cwd=captured)
    assert json.loads(again.out) == {"products": [f"{captured}/cal/products/calibration"]}
    assert cameras.stat().st_mtime_ns == made_ns  # nothing had changed, so nothing was made again

    said = rig("process", "btf", "--calibration", "cal", "--rank", "2", cwd=captured)
    products = captured / "btf/products"
    made = "".join(f"{products}/{name}\n" for name in ("btf", "factored_btf"))
    assert (said.code, said.out) == (0, made), said.err
    assert "no SBRDF+: 4 lights x 4 views are too few" in said.err
    said = rig("preview", "btf/products/factored_btf", "-o", "plane.png", "--size", "48", cwd=captured)
    assert said.code == 0, said.err
    assert said.out.startswith("plane.png (drawn by ")
    picture = np.asarray(Image.open(captured / "plane.png").convert("RGB"))
    assert picture.shape == (48, 48, 3)
    assert picture.std() > 10  # something is there and it is not flat


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupted_capture_is_dark_and_still_and_is_resumed_to_its_end(how, long_plan, simulated_rig):
    session = long_plan / "session"
    with running_rig("capture", "long.toml", "-o", session, "--rig", simulated_rig.toml, cwd=long_plan) as process:
        wait_until(lambda: len(list(session.glob("frames/*/*.dng"))) > 4, process)
        wait_until(lambda: simulated_rig.control("status")["lamps"], process)
        process.send_signal(how)
        said = ended(process)
    assert said.code == 130
    assert "rig resume" in said.err
    assert "Traceback" not in said.err
    assert dark_and_still(simulated_rig.control("status"))
    with Session.open(session) as opened:
        opened.verify()
        assert 0 < len(opened.done()) < LONG_STEPS
        taken = {record.path: record.path.stat().st_mtime_ns for record in opened.frames()}

    said = rig("resume", session, "--json", cwd=long_plan)
    assert said.code == 0, said.err
    report = json.loads(said.out)
    assert (report["state"], report["done"], report["total"]) == ("finished", LONG_STEPS, LONG_STEPS)
    assert dark_and_still(simulated_rig.control("status"))
    assert taken == {path: path.stat().st_mtime_ns for path in taken}  # what was done is not taken again
    said = rig("verify", session, cwd=long_plan)
    assert f"{2 * LONG_STEPS} files, all whole; {LONG_STEPS} of {LONG_STEPS}" in said.out


def test_a_killed_capture_is_taken_up_with_no_frame_missing_and_none_twice(long_plan, simulated_rig):
    session = long_plan / "session"
    with running_rig("capture", "long.toml", "-o", session, "--rig", simulated_rig.toml, cwd=long_plan) as process:
        wait_until(lambda: len(list(session.glob("frames/*/*.dng"))) > 4, process)
        process.kill()
        process.wait()
    shutil.copytree(session, long_plan / "copy")
    with Session.open(long_plan / "copy") as copy:
        durable = copy.verify()  # what the journal calls done is whole, before anything is mended
        assert durable < 2 * LONG_STEPS

    assert rig("resume", session, cwd=long_plan).code == 0
    assert dark_and_still(simulated_rig.control("status"))
    said = rig("verify", session, cwd=long_plan)
    assert f"{2 * LONG_STEPS} files, all whole; {LONG_STEPS} of {LONG_STEPS}" in said.out
    assert len(frames_on_disk(session)) == 2 * LONG_STEPS  # none missing, no leftovers
    ids = {read_raw(session / name).unique_id for name in frames_on_disk(session)}
    assert len(ids) == 2 * LONG_STEPS  # none twice


def test_a_person_is_asked_to_mount_and_without_one_nothing_is_taken(tmp_path, start_simulators):
    """A rig without a simulated clock has no control port: a script without a person must not photograph air."""
    simulators = start_simulators("--rate", "10")
    (tmp_path / "rig.toml").write_text(re.sub(r"\[clock\]\naddress = .*\n", "", simulators.toml.read_text()))
    (tmp_path / "plan.toml").write_text(ONE_STEP)
    said = rig("capture", "plan.toml", "-o", "session", cwd=tmp_path)
    assert said.code == 4
    assert "Please mount: sample = brick" in said.err
    assert "wrong-state: nobody answers" in said.err
    assert dark_and_still(simulators.control("status"))
    assert frames_on_disk(tmp_path / "session") == []

    simulators.control("mount", sample="brick")
    said = rig("resume", "session", cwd=tmp_path, input="\n")
    assert said.code == 0, said.err
    assert "finished, 1 of 1 steps" in said.out
    assert dark_and_still(simulators.control("status"))


def test_the_service_starts_once_and_ends_with_its_simulators(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
        said = rig("serve", "--simulated", "--port", port, cwd=tmp_path)
        assert said.code == 4
        assert said.error == f"busy: 127.0.0.1:{port}: Address already in use. Name another port with --port."
    with running_rig("serve", "--simulated", "--port", port, cwd=tmp_path) as process:
        assert f"http://127.0.0.1:{port}/" in process.stdout.readline()
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/v1/devices", timeout=60) as reply:
            state = Path(json.load(reply)["bus"]["port"]).parent
        assert state.is_dir()
        process.send_signal(signal.SIGTERM)
        said = ended(process)
    assert said == Said(0, "", "")
    assert not state.exists()


def test_what_an_operator_should_know_is_told(capsys):
    """Of a step that is done only what a test sweep chose."""
    with ConsoleProgress() as progress:
        tell = progress.follow("mdf")
        for kind, message in (("done", ""), ("done", "exposure 0.0123 s chosen from a test sweep"), ("state", "ready")):
            tell(Event(1, kind, State.RUNNING, 1, 2, None, "step", message, 0.0))
    said = capsys.readouterr().err.split()
    assert said == "done: step exposure 0.0123 s chosen from a test sweep".split()
