"""A session that is killed at any point, or whose disk fills up, loses nothing, doubles nothing, corrupts nothing."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
MEMORY_DISK = Path("/dev/shm")  # a killed process leaves its pages to the system: no disk is needed to test that


@pytest.fixture
def fast_folder(tmp_path):
    if not os.access(MEMORY_DISK, os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(dir=MEMORY_DISK) as folder:
        yield Path(folder)


def python(module, *arguments):
    return [sys.executable, "-m", f"tests.rig.sessions.{module}", *map(str, arguments)]


def test_a_session_survives_being_killed_anywhere(fast_folder):
    """At every durable operation of four small plans, and at random instants of a longer one."""
    command = python("crash_lab", fast_folder)
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=110, check=False)
    assert ran.returncode == 0, ran.stderr
    found = json.loads(ran.stdout)
    operations = 2 + 1 + 1  # of one step at least: two transactions, one synchronisation, one rename
    assert found["photographs"] >= 2 * operations  # two steps
    assert found["place"] >= 6 * operations  # three exposures to the front, three to the back
    assert found["sweeps"] >= operations
    assert found["tested"] >= found["sweeps"] + 2  # one step more, of which only the journal knows
    assert found["random"] >= 1


def on_small_disk(folder, command):
    """The command in a mount name space of its own, where the folder is a file system of 24 MB."""
    mount = 'mount -t tmpfs -o size=24m none "$0" && exec "$@"'
    return ["unshare", "--mount", "--map-root-user", "sh", "-c", mount, str(folder), *command]


def can_mount(folder):
    if shutil.which("unshare") is None:
        return False
    return subprocess.run(on_small_disk(folder, ["true"]), capture_output=True, check=False).returncode == 0


def test_a_session_survives_a_full_disk(tmp_path):
    """A real file system without room, with more and less of it left when the session starts."""
    if not can_mount(tmp_path):
        pytest.skip("this system lets no one mount a small file system; the same errors are raised in test_ends.py")
    command = on_small_disk(tmp_path, python("full_disk_lab", tmp_path))
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=110, check=False)
    assert ran.returncode == 0, ran.stderr + ran.stdout
    durable = [int(line.split(": ")[1].split(" ")[0]) for line in ran.stdout.splitlines()]
    assert min(durable) == 0 < max(durable)
