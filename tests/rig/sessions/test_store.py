"""The session folder: durable, verifiable, and refused with one message where it is not what it should be."""

import errno
import json
import os
import re
import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest
import zarr

from rig.errors import BusyError, DiskFullError, MissingFrameError, PlanError, RigError, StoreError
from rig.sessions import Runner, Session, State, hold_rig, parse_plan
from rig.sessions import store as frame_store
from rig.sessions.journal import Journal
from rig.sessions.plan import content_sha256
from tests.rig.sessions.fake_rig import MDF, PLANS, config, fake_rig
from tests.rig.sessions.test_plan import changed

CONFIG = config()


def tree(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


def finished(folder, data):
    """A session folder with everything in it."""
    rig, _ = fake_rig(CONFIG)
    with Session.create(folder, parse_plan(data), CONFIG) as session:
        Runner(session, rig).run()
    return folder


@pytest.fixture(scope="module")
def srf_folder(tmp_path_factory):
    return finished(tmp_path_factory.mktemp("srf") / "session", PLANS["srf"])


@pytest.fixture
def folder(srf_folder, tmp_path):
    """A finished session that a test may spoil."""
    return shutil.copytree(srf_folder, tmp_path / "session")


def test_a_session_tells_what_it_is(srf_folder):
    about = json.loads((srf_folder / "session.json").read_text())
    assert set(about) == {"schema", "id", "kind", "plan", "plan_sha256", "rig", "versions", "created_utc", "clock"}
    assert about["created_utc"].endswith("+00:00")
    with Session.open(srf_folder) as session:
        assert session.plan == parse_plan(PLANS["srf"])
        assert session.config == CONFIG
        assert session.state is State.FINISHED
        assert session.done() == {step.id for step in session.steps}
        assert session.remaining() == ()
        assert session.forecast().time_s == 0
        assert any(event.kind == "skip" for event in session.events())


def test_frames_carry_commanded_and_reported_angles_and_both_times(srf_folder):
    with Session.open(srf_folder) as session:
        records = session.frames()
        assert [(r.step.id, r.camera) for r in records] == [(s.id, c) for s in session.steps for c in s.cameras]
        for record in records:
            assert record.commanded_rad == record.step.axes_rad
            assert record.reported_rad.keys() == CONFIG.axes.keys()
            assert record.utc.endswith("+00:00")
            assert record.taken_s > 0
            assert record.path.suffix == ".dng"
            assert record.path.stat().st_size == record.bytes


def test_a_copied_session_is_whole(srf_folder, tmp_path):
    copy = shutil.copytree(srf_folder, tmp_path / "elsewhere")
    with Session.open(copy) as session:
        assert session.verify() == len(session.frames())
        assert all(record.path.is_relative_to(copy) for record in session.frames())


def test_a_burst_is_one_array_per_camera(tmp_path):
    with Session.open(finished(tmp_path / "mdf", MDF)) as session:
        records = session.frames()
        assert {record.path.name for record in records} == {"cam0.zarr", "cam1.zarr"}
        for record in records:
            array = zarr.open_array(record.path, mode="r")
            assert array.metadata.zarr_format == 3
            assert array.shape == (record.step.frames, 24, 32)
            assert array.dtype == np.uint16
            about = array.attrs.asdict()
            assert about["serial"] == CONFIG.cameras[record.camera].serial
            assert (about["black_dn"], about["white_dn"], about["cfa"]) == (256, 4095, [[0, 1], [1, 2]])
            assert about["exposure_s"] == 0.02
            assert about["interval_s"] == pytest.approx(0.1)
            assert about["times_s"] == pytest.approx(np.arange(record.step.frames) * 0.1)
            assert about["noise_profile"][0] == pytest.approx(1e-4)
        assert session.verify() == len(records)


def test_burst_and_pixel_read_few_files_and_chunks(tmp_path):
    """A sweep at full size lies in tens of files; a pixel over time touches a 64 x 64 column of chunks, not all."""
    raw = np.random.default_rng(1).integers(0, 4096, (20, 300, 520), dtype=np.uint16)
    stored = frame_store.write_burst(tmp_path / "cam.zarr", raw, {"exposure_s": 0.1})
    array = zarr.open_array(tmp_path / "cam.zarr", mode="r")
    assert np.array_equal(array[:], raw)
    assert np.array_equal(array[7], raw[7])
    assert np.array_equal(array[:, 150, 260], raw[:, 150, 260])
    assert array.chunks == (8, 64, 64)
    assert sum(path.is_file() for path in (tmp_path / "cam.zarr").rglob("*")) <= 1 + 2 * 3
    frame_store.check_content(tmp_path / "cam.zarr", stored.sha256)


def first_frame(folder):
    return next(folder.glob("frames/*/*.dng"))


def corrupt(path):
    data = bytearray(path.read_bytes())
    data[-5] ^= 1
    path.write_bytes(data)


def test_a_missing_frame_is_named(folder):
    path = first_frame(folder)
    path.unlink()
    with Session.open(folder) as session, pytest.raises(MissingFrameError, match=re.escape(str(path))):
        session.frames()


def test_a_truncated_frame_is_named(folder):
    path = first_frame(folder)
    path.write_bytes(path.read_bytes()[:100])
    with Session.open(folder) as session, pytest.raises(MissingFrameError, match="truncated"):
        session.frames()


def test_a_changed_frame_is_found_by_its_checksum(folder):
    corrupt(first_frame(folder))
    with Session.open(folder) as session:
        session.frames()
        with pytest.raises(MissingFrameError, match="checksum"):
            session.verify()


@pytest.mark.parametrize("how", ["corrupt", "delete", "truncate"])
def test_a_damaged_burst_is_found(tmp_path, how):
    folder = finished(tmp_path / "mdf", changed("mdf", laser_azimuth_deg=[45], laser_elevations_deg=[35]))
    shard = next(path for path in folder.glob("frames/*/cam0.zarr/c/**/*") if path.is_file())
    {"corrupt": corrupt, "delete": Path.unlink, "truncate": lambda path: os.truncate(path, 40)}[how](shard)
    with Session.open(folder) as session, pytest.raises(MissingFrameError, match=r"cam0\.zarr"):
        session.verify()


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda folder: (folder / "session.json").unlink(), "not a session folder"),
        (lambda folder: (folder / "session.json").write_text("{"), "JSON"),
        (lambda folder: (folder / "session.json").write_text("[]"), "fields are missing"),
        (lambda folder: (folder / "session.json").write_text('{"id": 1}'), "fields are missing"),
        (lambda folder: (folder / "session.json").write_bytes(b"\x80\x81"), "JSON"),
        (lambda folder: edit(folder, schema=99), "schema 99"),
        (lambda folder: edit(folder, plan_sha256="0" * 64), "hash"),
        (lambda folder: edit(folder, plan={"kind": "srf"}), "malformed"),
        (lambda folder: edit(folder, rig={}), "malformed"),
        (lambda folder: (folder / "journal.sqlite").unlink(), "journal is missing"),
        (lambda folder: (folder / "journal.sqlite").write_bytes(b"no database at all" * 100), "not a readable journal"),
        (lambda folder: (folder / "journal.sqlite").write_bytes(b""), "not a readable journal"),
        (lambda folder: run_sql(folder, "UPDATE steps SET content = '{}'"), "step cannot be read"),
        (lambda folder: run_sql(folder, "UPDATE steps SET content = 'x'"), "step cannot be read"),
    ],
)
def test_a_malformed_folder_is_refused_with_one_message(folder, spoil, says):
    spoil(folder)
    with pytest.raises(StoreError, match=says) as caught:
        Session.open(folder)
    assert str(folder) in str(caught.value)


def test_a_session_of_before_a_plan_had_a_field_still_opens(folder):
    """Its plan is what was written then; the field has its default."""
    plan = json.loads((folder / "session.json").read_text())["plan"]
    assert plan.pop("camera") == "front"
    edit(folder, plan=plan, plan_sha256=content_sha256(plan))
    with Session.open(folder) as session:
        assert session.plan == parse_plan(PLANS["srf"])


def edit(folder, **fields):
    path = folder / "session.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **fields}))


def run_sql(folder, statement):
    with sqlite3.connect(folder / "journal.sqlite") as db:
        db.execute(statement)
    db.close()


def test_a_journal_cannot_point_outside_of_its_folder(folder):
    run_sql(folder, "UPDATE frames SET path = '../../outside.dng'")
    with Session.open(folder) as session, pytest.raises(StoreError, match="outside"):
        session.frames()


def test_a_missing_folder_is_refused(tmp_path):
    with pytest.raises(StoreError, match="no such session"):
        Session.open(tmp_path / "absent")


def test_nothing_is_overwritten(tmp_path):
    (tmp_path / "notes.txt").write_text("keep me")
    with pytest.raises(StoreError, match="not empty"):
        Session.create(tmp_path, parse_plan(PLANS["srf"]), CONFIG)
    assert tree(tmp_path) == ["notes.txt"]
    with pytest.raises(StoreError, match="not empty"):
        Session.create(tmp_path / "notes.txt", parse_plan(PLANS["srf"]), CONFIG)
    (tmp_path / "empty").mkdir()
    Session.create(tmp_path / "empty", parse_plan(PLANS["srf"]), CONFIG).close()


def test_an_impossible_plan_leaves_no_folder(tmp_path):
    for data in (changed("btf", cameras=["cam9"]), changed("srf", arm_deg=[120])):
        with pytest.raises(RigError):
            Session.create(tmp_path / "new", parse_plan(data), CONFIG)
    assert tree(tmp_path) == []


def test_a_plan_that_does_not_fit_on_the_disk_is_refused(tmp_path):
    cameras = {name: {**camera, "frame_megabytes": 1e9} for name, camera in CONFIG.model_dump()["cameras"].items()}
    with pytest.raises(PlanError, match="MB free"):
        Session.create(tmp_path / "new", parse_plan(PLANS["btf"]), config(cameras=cameras))
    assert tree(tmp_path) == []


def test_a_disk_that_fills_up_while_a_session_is_created_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(DiskFullError):
        Session.create(tmp_path / "new", parse_plan(PLANS["btf"]), CONFIG)
    assert tree(tmp_path) == []


def refuse(handle):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("write", ["file", "burst"])
def test_what_cannot_be_written_leaves_nothing_and_what_was_there(tmp_path, monkeypatch, write):
    path = tmp_path / "step" / "cam0"
    first, second = (np.full((2, 8, 8), value, np.uint16) for value in (1, 2))

    def store(raw):
        if write == "file":
            return frame_store.write_file(path, raw.tobytes())
        return frame_store.write_burst(path, raw, {})

    kept = store(first)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", refuse)
        with pytest.raises(DiskFullError, match="stays open"):
            store(second)
    assert [entry.name for entry in path.parent.iterdir()] == ["cam0"]
    frame_store.check_content(path, kept.sha256)
    assert store(second).sha256 != kept.sha256


def test_other_refusals_of_the_disk_are_store_errors(tmp_path):
    (tmp_path / "step").write_text("a file where a folder should be")
    with pytest.raises(StoreError, match="cannot be written"):
        frame_store.write_file(tmp_path / "step" / "cam0.dng", b"data")


def test_a_file_is_synchronised_before_it_gets_its_name(tmp_path, monkeypatch):
    """Contents first, then the name, then the directory: otherwise a power cut may leave an empty file."""
    calls = []
    fsync, rename = os.fsync, Path.rename

    def noted_fsync(handle):
        calls.append(str(Path(f"/proc/self/fd/{handle}").readlink()))
        fsync(handle)

    def noted_rename(part, target):
        calls.append(f"rename {target}")
        return rename(part, target)

    monkeypatch.setattr(os, "fsync", noted_fsync)
    monkeypatch.setattr(Path, "rename", noted_rename)
    path = tmp_path / "step" / "cam0.dng"
    frame_store.write_file(path, b"data")
    assert calls[:3] == [str(path.with_name(".part-cam0.dng")), f"rename {path}", str(path.parent)]


def test_the_journal_is_synchronous(tmp_path):
    journal = Journal.create(tmp_path / "journal.sqlite", ())
    assert journal._rows("PRAGMA journal_mode") == [("wal",)]
    assert journal._rows("PRAGMA synchronous") == [(2,)]
    journal.close()


def test_events_are_numbered_and_can_be_asked_for_from_a_number(srf_folder):
    with Session.open(srf_folder) as session:
        numbers = [event.number for event in session.events()]
        assert numbers == list(range(1, len(numbers) + 1))
        assert [event.number for event in session.events(after=5)] == numbers[5:]


def test_one_rig_one_session(tmp_path):
    held = config(bus={"port": str(tmp_path / "bus")})
    with hold_rig(held), pytest.raises(BusyError, match="process"), hold_rig(held):
        pass
    with hold_rig(held):
        pass
    with hold_rig(held), hold_rig(config(bus={"port": str(tmp_path / "other")})):
        pass


def test_one_session_one_run(tmp_path):
    session = Session.create(tmp_path / "s", parse_plan(PLANS["srf"]), CONFIG)
    rig, world = fake_rig(CONFIG)
    with session, Session.open(tmp_path / "s") as again, again.exclusive():
        with pytest.raises(BusyError, match="in use"):
            Runner(session, rig).run()
        assert world.commands == []
