"""Fixtures of the whole suite: simulated rigs, each a process of its own."""

import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest

# Threads that wait for work sleep instead of spinning, which on a busy machine makes small loops ten times slower.
# OpenMP reads it once, when the first compiled kernel is loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

# A suite that runs in the background may have these ignored, and so would all that it starts.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

ROOT = Path(__file__).parents[1]
READY_S = 60.0


class ControlError(Exception):
    """The control port refused."""


class ControlPort:
    """Client of the simulators' control port: `port("advance", seconds=1.0)` returns the reply."""

    def __init__(self, address: str) -> None:
        host, port = address.rsplit(":", 1)
        self.address = address
        self._stream = socket.create_connection((host, int(port)), timeout=60)
        self._lines = self._stream.makefile("rb")

    def __call__(self, op: str, **arguments: object) -> dict:
        self._stream.sendall(json.dumps({"op": op, **arguments}).encode() + b"\n")
        reply = json.loads(self._lines.readline())
        if not reply.pop("ok"):
            raise ControlError(reply["error"])
        return reply

    def close(self) -> None:
        self._lines.close()
        self._stream.close()


@dataclass
class SimulatedRig:
    """A running simulators process: its folder, its rig.toml, its control port."""

    state: Path
    process: subprocess.Popen
    control: ControlPort = field(init=False)

    def __post_init__(self) -> None:
        self.control = ControlPort(re.search(r'\[clock\]\naddress = "(.+)"', self.toml.read_text())[1])

    @property
    def toml(self) -> Path:
        return self.state / "rig.toml"

    def camera_address(self, name: str) -> str:
        return re.search(rf'\[cameras\.{name}\]\naddress = "(.+)"', self.toml.read_text())[1]

    def end(self) -> int:
        """Close its standard input, as a parent that dies does; its exit status."""
        self.control.close()
        self.process.stdin.close()
        try:
            return self.process.wait(timeout=20)
        finally:
            self.process.kill()
            self.process.stdout.close()


def _read_line(stream: object, deadline_s: float) -> str:
    line = b""
    while not line.endswith(b"\n"):
        ready, _, _ = select.select([stream], [], [], max(0.0, deadline_s - time.monotonic()))
        byte = os.read(stream.fileno(), 1) if ready else b""
        if not byte:
            raise AssertionError(f"the simulators did not get ready (said {line!r})")
        line += byte
    return line.decode()


@contextmanager
def running_simulators(state: Path, *options: str) -> Iterator[SimulatedRig]:
    """`python -m simulators` with its state in this folder, ended on leaving."""
    command = [sys.executable, "-m", "simulators", "--state", str(state), *options]
    process = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)
    try:
        line = _read_line(process.stdout, time.monotonic() + READY_S)
        assert line == f"ready {state / 'rig.toml'}\n"
        rig = SimulatedRig(state, process)
    except BaseException:
        process.kill()
        process.stdin.close()
        process.stdout.close()
        process.wait()
        raise
    try:
        yield rig
    finally:
        rig.end()


@pytest.fixture
def start_simulators(tmp_path: Path) -> Iterator[Callable[..., SimulatedRig]]:
    """Start as many rigs as a test needs: `start_simulators("--rate", "1")`."""
    contexts = []

    def start(*options: str) -> SimulatedRig:
        context = running_simulators((tmp_path / f"rig{len(contexts)}").resolve(), *options)
        rig = context.__enter__()
        contexts.append(context)
        return rig

    yield start
    for context in reversed(contexts):
        context.__exit__(None, None, None)


@pytest.fixture
def simulated_rig(start_simulators: Callable[..., SimulatedRig]) -> SimulatedRig:
    """A rig of the test's own at rate 0: time moves only by `control("advance", seconds=...)` and by wire pacing."""
    return start_simulators()


@pytest.fixture(scope="module")
def shared_simulated_rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimulatedRig]:
    """One rig at rate 0 for the tests of a file; of more, the order of files would count."""
    with running_simulators(tmp_path_factory.mktemp("shared").resolve() / "rig") as rig:
        yield rig
