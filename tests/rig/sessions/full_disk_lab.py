"""Fills a small disk under a running session, again and again with less room; argument: a folder on that disk."""

import sys
from pathlib import Path

import pytest

from rig.errors import DiskFullError
from rig.sessions import Runner, Session, State, parse_plan
from tests.rig.sessions.fake_rig import BTF, MDF, config, fake_rig, is_safe


def leave_free(ballast, free_bytes):
    """Let a file take the whole disk but for so many bytes."""
    with ballast.open("wb", buffering=0) as file:
        try:
            while file.write(bytes(4096)) == 4096:
                pass
        except OSError:
            pass
        file.truncate(max(file.tell() - free_bytes, 0))


def run_until_full(folder, data, free_bytes):
    """Frames that were durable when the disk was full, and steps that were open."""
    rig, world = fake_rig(config())
    with Session.create(folder / "session", parse_plan(data), config()) as session:
        leave_free(folder / "ballast", free_bytes)
        with pytest.raises(DiskFullError, match="Make room and resume"):
            Runner(session, rig).run()
        assert is_safe(rig, world)
        assert not list(folder.rglob(".part-*"))
    (folder / "ballast").unlink()
    with Session.open(folder / "session") as session:
        assert session.state in (State.FAILED, State.INTERRUPTED, State.IDLE)
        frames = session.verify()
        assert frames == 2 * len(session.done())
        open_steps = len(session.remaining())
        Runner(session, fake_rig(config())[0]).run()
        assert session.verify() == 2 * len(session.steps)
    return frames, open_steps


def main(folder):
    for free_bytes in (0, 60_000, 150_000, 300_000):
        for data in (BTF, MDF):
            place = folder / f"{data['kind']}-{free_bytes}"
            place.mkdir()
            frames, open_steps = run_until_full(place, data, free_bytes)
            sys.stdout.write(f"{data['kind']} {free_bytes}: {frames} frames durable, {open_steps} steps open\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
