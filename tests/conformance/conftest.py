"""Conformance: clients that know nothing of us drive the simulators, whose clock follows the wall here."""

import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.conftest import SimulatedRig, running_simulators

RATE = "20"  # simulated seconds per second: moves of seconds are over soon


@pytest.fixture(scope="module")
def live_rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimulatedRig]:
    """Simulators whose time goes on by itself, for all tests of one client."""
    with running_simulators(tmp_path_factory.mktemp("live").resolve() / "rig", "--rate", RATE) as rig:
        yield rig


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
