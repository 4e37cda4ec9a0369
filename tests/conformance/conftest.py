"""Conformance: clients that know nothing of us drive the simulators, whose clock follows the wall here."""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

RATE = "20"  # simulated seconds per second: moves of seconds are over soon


@pytest.fixture
def live_rig(start_simulators):
    """Simulators whose time goes on by itself."""
    return start_simulators("--rate", RATE)


@pytest.fixture
def command(tmp_path: Path) -> Callable[..., subprocess.CompletedProcess]:
    """Run a stock program in a home of its own; skips where it is not installed."""

    def run(program: str, *arguments: str) -> subprocess.CompletedProcess:
        path = shutil.which(program)
        if path is None:
            pytest.skip(f"{program} is not installed (Debian package {program})")
        environment = {"HOME": str(tmp_path), "PATH": "/usr/bin:/bin", "LANG": "C"}
        return subprocess.run(
            [path, *arguments], capture_output=True, text=True, timeout=60, cwd=tmp_path, env=environment, check=False
        )

    return run
