"""The command line as its users have it: a process of its own, its exit code and what it says."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
RIG = [sys.executable, "-c", "from service.cli import main; main()"]
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "200", "NO_COLOR": "1", "PYTHONWARNINGS": "error"}
TIMEOUT_S = 100.0

BTF = """
kind = "btf"
turntable_deg = [0, 90]
light_azimuth_deg = [45, 135]
lamps = ["lamp3", "lamp6"]
cameras = ["cam4", "cam7"]
exposures_s = [0.02]
texels = 8
"""
CALIBRATE = """
kind = "calibrate"
board_poses = 4
lamp = "lamp6"
light_arc_deg = 60
cameras = ["cam4", "cam7"]
exposure_s = 0.05
"""


@dataclass(frozen=True)
class Said:
    """How a command ended."""

    code: int
    out: str
    err: str

    @property
    def error(self) -> str:
        """The one line on standard error; more than one is a failure."""
        lines = self.err.splitlines()
        assert len(lines) == 1, self.err
        return lines[0]


def rig(*arguments: object, cwd: Path, **options: object) -> Said:
    """Run `rig ARGUMENTS` to its end in a folder."""
    command = [*RIG, *map(str, arguments)]
    done = subprocess.run(
        command, cwd=cwd, env=ENVIRONMENT, capture_output=True, text=True, check=False, timeout=TIMEOUT_S,
        **({} if "input" in options else {"stdin": subprocess.DEVNULL}) | options,
    )  # fmt: skip
    return Said(done.returncode, done.stdout, done.stderr)


@contextmanager
def running_rig(*arguments: object, cwd: Path) -> Iterator[subprocess.Popen[str]]:
    """`rig ARGUMENTS` under way; killed on leaving if it still runs."""
    process = subprocess.Popen(
        [*RIG, *map(str, arguments)], cwd=cwd, env=ENVIRONMENT, text=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    with process:
        try:
            yield process
        finally:
            process.kill()


def ended(process: subprocess.Popen[str]) -> Said:
    """Wait for a running command."""
    out, err = process.communicate(timeout=TIMEOUT_S)
    return Said(process.returncode, out, err)


def wait_until(true: Callable[[], object], process: subprocess.Popen[str]) -> None:
    """Wait for something to become true while the process runs."""
    deadline_s = time.monotonic() + TIMEOUT_S
    while not true():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


@contextmanager
def stopped(process: subprocess.Popen[str]) -> Iterator[None]:
    """The process holds its breath, so that a test can look around or change something."""
    process.send_signal(signal.SIGSTOP)
    try:
        yield
    finally:
        process.send_signal(signal.SIGCONT)
