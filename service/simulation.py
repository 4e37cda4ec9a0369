"""The simulators as a child process, and the operator's hands in a simulated rig."""

import json
import os
import socket
import subprocess
import sys
import tomllib
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from rig.errors import ConnectError, DeviceError

START_TIMEOUT_S = 60.0


class Simulation:
    """Runs `python -m simulators` as long as the context lasts; the child ends with this process, whatever ends it."""

    def __init__(self, state: Path, *, seed: int = 1, rate: float = 0.0) -> None:
        self._command = [
            sys.executable, "-m", "simulators", "--state", str(state), "--seed", str(seed), "--rate", str(rate),
        ]  # fmt: skip
        self._state = state

    @property
    def rig_toml(self) -> Path:
        """The rig.toml that reaches the simulated devices."""
        return self._state / "rig.toml"

    @property
    def truth(self) -> Path:
        """Folder of the ground truth: for reports and benchmarks only."""
        return self._state / "truth"

    def __enter__(self) -> Self:
        self._state.mkdir(parents=True, exist_ok=True)
        log = (self._state / "simulators.log").open("w")
        with log:
            self._child = subprocess.Popen(
                self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True,
                start_new_session=True,  # a Ctrl-C is for the rig, which still has to make its devices safe
            )  # fmt: skip
        assert self._child.stdout is not None
        line = self._child.stdout.readline()
        if not line.startswith("ready"):
            self._stop()
            raise ConnectError(f"the simulators did not start; their log is {self._state / 'simulators.log'}")
        address = tomllib.loads(self.rig_toml.read_text())["clock"]["address"]
        self._control = ControlPort(address)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._control.close()
        self._stop()

    def _stop(self) -> None:
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        self._child.stdin.close()  # the simulators end when nobody holds their standard input
        try:
            self._child.wait(10)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
        self._child.stdout.close()

    def request(self, op: str, **arguments: object) -> dict[str, Any]:
        """One request to the control port."""
        return self._control.request(op, **arguments)

    def mount(self, instruction: Mapping[str, object]) -> None:
        """Do by program what an operator does by hand."""
        self._control.mount(instruction)


class ControlPort:
    """The simulators' own control port: one JSON object a line."""

    def __init__(self, address: str) -> None:
        host, port = address.rsplit(":", 1)
        try:
            self._socket = socket.create_connection((host, int(port)), timeout=START_TIMEOUT_S)
        except OSError as error:
            raise ConnectError(
                f"simulators' control port {address}: {error}. Is `rig serve --simulated` running?"
            ) from error
        self._lines = self._socket.makefile("r")

    def request(self, op: str, **arguments: object) -> dict[str, Any]:
        """Send one request and return its reply. Raises DeviceError with the simulators' own words."""
        self._socket.sendall((json.dumps({"op": op, **arguments}) + os.linesep).encode())
        reply: dict[str, Any] = json.loads(self._lines.readline() or '{"ok": false, "error": "connection closed"}')
        if not reply.pop("ok"):
            raise DeviceError(f"simulators: {op}: {reply.get('error')}")
        return reply

    def mount(self, instruction: Mapping[str, object]) -> None:
        """Do by program what an operator does by hand."""
        self.request("mount", **instruction)

    def close(self) -> None:
        """Close the connection."""
        self._lines.close()
        self._socket.close()


def mount_at(address: str) -> Callable[[Mapping[str, object]], None]:
    """An operator of simulators that run elsewhere: connects to their control port each time it is asked."""

    def mount(instruction: Mapping[str, object]) -> None:
        with closing(ControlPort(address)) as control:
            control.mount(instruction)

    return mount
