"""Bad input at the command line: one clear line, the documented exit code, nothing moved, nothing lost."""

import contextlib
import re
import shutil
import subprocess
import tomllib
from hashlib import sha256

import numpy as np
import pytest
from PIL import Image

from processing.products import BlinnPhong, Srf
from rig.config import load_config
from rig.sessions import Session, hold_rig, parse_plan
from tests.command import BTF, CALIBRATE, ended, rig, running_rig, stopped, wait_until

SRF = """
kind = "srf"
arm_deg = [100]
exposures_s = [0.1]
sphere_radius_mm = 50
card = { y_mm = 0, z_mm = -59, width_mm = 40, height_mm = 11, reflectance = 0.9 }
"""
SMALL_BTF = BTF.replace("[0, 90]", "[0]").replace("[0.02]", "[0.01, 0.02]")
CANNOT_FIT_MB, FITS_MB = 12, 24  # a session wants 16 MB beside its frames


def state_of(simulators):
    """Everything of the rig that somebody could see from outside."""
    status = simulators.control("status")
    return {key: status[key] for key in ("axes", "lamps", "laser", "motor", "sample")}


def content(folder):
    """Digest of every file in a folder."""
    return {
        path.relative_to(folder).as_posix(): sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture
def untouched(shared_simulated_rig):
    """The shared rig; it must look afterwards as it did before."""
    before = state_of(shared_simulated_rig)
    yield shared_simulated_rig
    assert state_of(shared_simulated_rig) == before


@pytest.fixture(scope="module")
def captured(tmp_path_factory, shared_simulated_rig):
    """A captured calibration `cal` and a bracketed `btf`."""
    folder = tmp_path_factory.mktemp("captured")
    for name, plan in (("cal", CALIBRATE.replace("4", "3", 1)), ("btf", SMALL_BTF)):
        (folder / f"{name}.toml").write_text(plan)
        said = rig("capture", f"{name}.toml", "-o", name, "--rig", shared_simulated_rig.toml, cwd=folder)
        assert said.code == 0, said.err
    return folder


@pytest.fixture
def session(captured, tmp_path):
    """A copy of the captured calibration that a test may damage."""
    return shutil.copytree(captured / "cal", tmp_path / "cal")


@pytest.fixture(scope="module")
def bracket(captured):
    """Two exposures of one camera, and one of another."""
    with Session.open(captured / "btf") as opened:
        first = opened.steps[0]
        alike = [r for r in opened.frames() if (r.step.pose, r.step.lamps) == (first.pose, first.lamps)]
    frames = {(record.camera, record.exposure_s): record.path for record in alike}
    return frames["cam4", 0.01], frames["cam4", 0.02], frames["cam7", 0.01]


@pytest.mark.parametrize(
    ("plan", "code", "told"),
    [
        (BTF.replace("lamp3", "sun"), "unknown-device", r"no lamp named 'sun'.*known: lamp0, .*led"),
        (BTF.replace("cam4", "cam99"), "unknown-device", r"no camera named 'cam99'.*known: cam0"),
        (SRF, "out-of-range", r"arm.*100.*-90 to 90 deg.*rig\.toml"),
        (CALIBRATE.replace("60", "5"), "interlock", r"light_arc.*5.*-12 to 12"),
        (BTF.replace("texels", "texel"), "impossible-plan", r"plan\.toml: field texels: Field required"),
        (BTF.replace("[0.02]", "[-1.0]"), "impossible-plan", r"plan\.toml: field exposures_s.*greater than"),
        ("kind = [", "impossible-plan", r"plan\.toml: not TOML"),
        ("kind = 'video'", "impossible-plan", r"plan\.toml: .*'srf', 'btf', 'mdf', 'calibrate'"),
    ],
    ids=["lamp", "camera", "range", "forbidden", "missing field", "exposure", "not TOML", "kind"],
)
def test_an_impossible_plan_never_starts(tmp_path, untouched, plan, code, told):
    (tmp_path / "plan.toml").write_text(plan)
    said = rig("capture", "plan.toml", "-o", "session", "--rig", untouched.toml, cwd=tmp_path)
    assert said.code == 2
    assert said.error.startswith(f"{code}: ")
    assert re.search(told, said.error), said.error
    assert not (tmp_path / "session").exists()


def test_a_plan_that_is_not_there_is_named(tmp_path, untouched):
    said = rig("plan", "nowhere.toml", "--rig", untouched.toml, cwd=tmp_path)
    assert said.code == 2
    assert "nowhere.toml: cannot be read: No such file" in said.error


def test_a_rig_toml_that_is_wrong_is_told_by_its_field(tmp_path, untouched):
    (tmp_path / "plan.toml").write_text(BTF)
    said = rig("capture", "plan.toml", "-o", "session", cwd=tmp_path)
    assert said.code == 2
    assert re.search(r"malformed-config: rig\.toml: no such file.*--rig", said.error)
    text = untouched.toml.read_text()
    (tmp_path / "rig.toml").write_text(re.sub(r"steps_per_deg = .*", "steps_per_deg = 0", text, count=1))
    said = rig("capture", "plan.toml", "-o", "session", cwd=tmp_path)
    assert said.code == 2
    assert re.search(r"malformed-config: rig\.toml: \[axes\.\w+\.steps_per_deg\].*greater than 0", said.error)
    assert not (tmp_path / "session").exists()


@pytest.mark.parametrize(
    ("pattern", "device", "where"),
    [
        (r'(?<=\[bus\]\nport = ").*(?=")', "bus", "/dev/nowhere"),
        (r'(?<=\[lamps\]\nport = ").*(?=")', "lamps", "/dev/nowhere"),
        (r'(?<=\[cameras\.cam4\]\naddress = ").*(?=")', "cam4", "127.0.0.1:9"),
    ],
    ids=["bus", "lamps", "camera"],
)
def test_a_port_that_cannot_be_opened_moves_nothing_and_leaves_no_session(tmp_path, untouched, pattern, device, where):
    text, count = re.subn(pattern, where, untouched.toml.read_text())
    assert count == 1
    (tmp_path / "rig.toml").write_text(text)
    (tmp_path / "plan.toml").write_text(BTF)
    said = rig("capture", "plan.toml", "-o", "session", cwd=tmp_path)
    assert said.code == 3
    assert said.error.startswith(f"cannot-connect: {device}: cannot ")
    assert where in said.error
    assert "rig.toml" in said.error
    assert not (tmp_path / "session").exists()


def test_a_busy_rig_is_left_to_who_holds_it(tmp_path, untouched):
    (tmp_path / "plan.toml").write_text(BTF)
    with hold_rig(load_config(untouched.toml)):
        said = rig("capture", "plan.toml", "-o", "session", "--rig", untouched.toml, cwd=tmp_path)
    assert said.code == 4
    assert re.search(r"busy: the rig .* is in use by process \d+\. Wait for it to end, or stop it\.", said.error)
    assert not (tmp_path / "session").exists()


def test_a_session_folder_is_never_overwritten(captured, untouched):
    before = content(captured / "cal")
    said = rig("capture", "btf.toml", "-o", "cal", "--rig", untouched.toml, cwd=captured)
    assert said.code == 5
    assert "cal: exists and is not empty; nothing was overwritten" in said.error
    assert content(captured / "cal") == before


@pytest.mark.parametrize("command", ["verify", "process", "resume"])
def test_what_is_no_session_is_told(tmp_path, command):
    said = rig(command, "nowhere", cwd=tmp_path)
    assert said.code == 5
    assert re.search(r"session-unreadable: .*nowhere: no such session folder", said.error)


def test_a_session_with_steps_to_take_is_not_processed(tmp_path, untouched):
    """What came of some of its steps would look like what comes of all."""
    with Session.create(tmp_path / "new", parse_plan(tomllib.loads(CALIBRATE)), load_config(untouched.toml)):
        pass
    said = rig("process", "new", cwd=tmp_path)
    assert said.code == 4
    assert re.search(r"wrong-state: .*4 of 4 steps are still to be taken; `rig resume", said.error)
    assert list((tmp_path / "new" / "products").iterdir()) == []


@pytest.mark.parametrize("damage", ["gone", "cut"])
def test_a_missing_or_truncated_frame_stops_processing_and_nothing_else_is_lost(session, damage):
    victim = sorted(session.glob("frames/*/cam7.dng"))[1]
    if damage == "gone":
        victim.unlink()
    else:
        victim.write_bytes(victim.read_bytes()[:1000])
    before = content(session / "frames")
    for command in ("process", "verify"):
        said = rig(command, session, cwd=session.parent)
        assert said.code == 5
        assert re.match(rf"missing-frame: \S*{re.escape(victim.name)}: ", said.error)
        assert victim.parent.name in said.error
    assert content(session / "frames") == before
    assert list((session / "products").iterdir()) == []


def test_a_frame_that_is_no_image_is_named(session):
    """Of the right size, so that only reading it tells."""
    victim = sorted(session.glob("frames/*/cam4.dng"))[0]
    victim.write_bytes(b"text" * (victim.stat().st_size // 4))
    said = rig("process", session, cwd=session.parent)
    assert said.code == 2
    assert said.error.startswith("unusable-image: ")
    assert victim.parent.name in said.error
    assert list((session / "products").iterdir()) == []


def test_a_file_that_cannot_be_merged_is_named_and_nothing_is_written(tmp_path, bracket):
    short, long, other = bracket
    (tmp_path / "cut.dng").write_bytes(long.read_bytes()[:60_000])
    (tmp_path / "notes.jpg").write_text("not an image")
    Image.new("RGB", (320, 240)).save(tmp_path / "photo.jpg")
    bad = {
        (short, "cut.dng"): r"cut\.dng: truncated",
        ("notes.jpg",): r"notes\.jpg: not a picture",
        (short, other): r"different cameras: .*cam4\.dng has .*VC-0004, .*cam7\.dng has .*VC-0007",
        (short, "photo.jpg"): r"cam4\.dng is RAW and photo\.jpg is not",
    }
    before = content(tmp_path)
    for files, told in bad.items():
        said = rig("merge", *files, "-o", "out.exr", cwd=tmp_path)
        assert said.code == 2, said
        assert re.search(f"unusable-image: .*{told}", said.error)
    assert content(tmp_path) == before


def test_mixed_exposures_are_not_one_bracket(tmp_path, bracket):
    """Two frames of one time and different lamps would merge to a picture of neither."""
    short, *_ = bracket
    lamps = ("lamp3", "lamp6") if "lamp3" in short.parent.name else ("lamp6", "lamp3")
    twin = short.parent.parent / short.parent.name.replace(*lamps) / short.name
    assert twin.is_file()
    said = rig("merge", short, twin, "-o", "out.exr", cwd=tmp_path)
    assert said.code == 2
    assert "have the same exposure time, 0.01 s" in said.error
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_under_a_result_is_told_as_such_and_the_earlier_result_stays(tmp_path, bracket):
    with small_disk(tmp_path / "disk", megabytes=1) as disk:
        for name in ("full.exr", "full.png"):
            (disk / name).write_text("an earlier result")
        said = rig("merge", *bracket[:2], "-o", "full.exr", cwd=disk)
        assert said.code == 5
        assert said.error.startswith("disk-full: ")
        assert "full.exr" in said.error
        assert {path.name: path.read_text() for path in disk.iterdir()} == {
            "full.exr": "an earlier result",
            "full.png": "an earlier result",
        }


def test_a_picture_that_cannot_be_written_is_told(tmp_path):
    Srf(np.zeros((3, 4, 4, 3), np.float32), BlinnPhong(np.ones(3), np.ones(3), 9.0), wrap=True).save(tmp_path / "srf")
    said = rig("preview", "srf", "-o", "picture.xyz", "--size", "16", cwd=tmp_path)
    assert said.code == 2
    assert re.search(r"picture\.xyz: a picture is \.png", said.error)
    said = rig("preview", "srf", "-o", "nowhere/picture.png", "--size", "16", cwd=tmp_path)
    assert said.code == 5
    assert re.search(r"unusable-file: .*nowhere/picture\.png", said.error)
    said = rig("preview", "nothing", "-o", "picture.png", cwd=tmp_path)
    assert said.code == 2
    assert "nothing: not a product; `rig process SESSION` makes" in said.error
    (tmp_path / "mdf").mkdir()
    (tmp_path / "mdf" / "product.json").write_text('{"kind": "mdf"}')
    for arguments in (("preview", "mdf"), ("displacement", "srf")):
        said = rig(*arguments, "-o", "picture.gif", cwd=tmp_path)
        assert said.code == 2
        assert re.search(r"unusable-image: picture\.gif: a picture is one of \.png", said.error)


@contextlib.contextmanager
def small_disk(folder, megabytes):
    """A file system of its own of this size; skips the test where mounting is not allowed."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "none", str(folder)]
    if shutil.which("mount") is None or subprocess.run(mount, check=False, capture_output=True).returncode:
        pytest.skip("a small file system cannot be mounted here; only root may")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def fill(folder):
    """Take all that is left of a small disk."""
    with contextlib.suppress(OSError), (folder / "ballast").open("wb", buffering=0) as file:
        while file.write(b"\0" * 4096):
            pass
    assert shutil.disk_usage(folder).free == 0


def test_a_disk_that_is_too_small_is_told_before_anything_moves(tmp_path, untouched):
    (tmp_path / "plan.toml").write_text(BTF)
    with small_disk(tmp_path / "disk", CANNOT_FIT_MB) as disk:
        said = rig("capture", "plan.toml", "-o", disk / "session", "--rig", untouched.toml, cwd=tmp_path)
        assert said.code == 2
        assert re.search(r"impossible-plan: 16 frames need \d+ MB and .* has 1\d MB free", said.error)
        assert list(disk.iterdir()) == []


def test_a_disk_that_fills_up_during_a_capture_costs_no_frame(tmp_path, simulated_rig):
    (tmp_path / "plan.toml").write_text(BTF.replace("[0, 90]", "[0, 45, 90, 135]"))
    with small_disk(tmp_path / "disk", FITS_MB) as disk:
        session = disk / "session"
        with running_rig("capture", "plan.toml", "-o", session, "--rig", simulated_rig.toml, cwd=tmp_path) as process:
            wait_until(lambda: len(list(session.glob("frames/*/*.dng"))) > 4, process)
            with stopped(process):
                fill(disk)
            said = ended(process)
        assert said.code == 5
        assert re.search(r"^disk-full: .*: the disk is full; .*Make room and resume\.$", said.err, re.MULTILINE)
        status = simulated_rig.control("status")
        assert status["lamps"] == {}
        assert not any(axis["moving"] for axis in status["axes"].values())

        (disk / "ballast").unlink()
        with Session.open(session) as opened:
            assert opened.verify() >= 4
            assert len(opened.done()) < 16
        assert rig("resume", session, cwd=tmp_path).code == 0
        said = rig("verify", session, cwd=tmp_path)
        assert said.out.endswith("32 files, all whole; 16 of 16 steps done.\n")
        assert len(list(session.glob("frames/*/*"))) == 32
