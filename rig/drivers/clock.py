"""The one place that waits: the rig's clock, and deadlines of the wires."""

import json
import socket
import time
from contextlib import suppress
from io import BufferedRWPair
from typing import Protocol

from rig.errors import ConnectError, TransportError

_CONNECT_TIMEOUT_S = 5.0
_ADVANCE_TIMEOUT_S = 600.0  # of wall time: the simulators render every frame that falls due before they answer


class Deadline:
    """Wall time left for an answer. A wire lives in wall time, also where the rig's time is simulated."""

    def __init__(self, seconds: float) -> None:
        self._end_s = time.monotonic() + seconds

    def left_s(self) -> float:
        """Seconds left; 0 once it has passed."""
        return max(0.0, self._end_s - time.monotonic())


class RigClock(Protocol):
    """The rig's clock as the drivers see it."""

    def now_s(self) -> float:
        """Seconds since some fixed moment; never goes back."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let that much of the rig's time pass."""
        ...

    def has_waited(self, seconds: float) -> None:
        """Take into account that so much wall time was spent waiting for a wire that stayed silent."""
        ...

    def close(self) -> None:
        """Let go of it; closing twice is allowed."""
        ...


class MonotonicClock:
    """Wall time, for hardware."""

    def now_s(self) -> float:
        """Seconds since some fixed moment."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait."""
        time.sleep(max(0.0, seconds))

    def has_waited(self, seconds: float) -> None:
        """Nothing to do: the time has passed."""

    def close(self) -> None:
        """Nothing to close."""


class SimulatedClock:
    """The simulators' shared clock, moved over their control port: one JSON object per line, one reply per line.

    All that falls due in the time slept has happened before `sleep` returns.
    """

    def __init__(self, address: str) -> None:
        """Connect to host:port. Raises ConnectError where nobody answers there."""
        self._address = address
        self._stream: BufferedRWPair | None = self._connect()

    def now_s(self) -> float:
        """The simulated time. Raises TransportError where the simulators are gone."""
        return self._ask({"op": "now"})

    def sleep(self, seconds: float) -> None:
        """Let the simulated time advance. Raises TransportError where the simulators are gone."""
        if seconds > 0:
            self._ask({"op": "advance", "seconds": seconds})

    def has_waited(self, seconds: float) -> None:
        """Let the simulated time follow: a late reply comes out only when its time has come."""
        self.sleep(seconds)

    def close(self) -> None:
        """Hang up; closing twice is allowed."""
        stream, self._stream = self._stream, None
        if stream is not None:
            with suppress(OSError):  # what could not be sent any more
                stream.close()

    def _connect(self) -> BufferedRWPair:
        host, _, port = self._address.rpartition(":")
        try:
            connection = socket.create_connection((host, int(port)), _CONNECT_TIMEOUT_S)
        except (OSError, ValueError) as error:
            raise ConnectError(
                f"clock: cannot reach the simulators at {self._address} ({error}). Are they running? rig.toml, [clock]."
            ) from error
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.settimeout(_ADVANCE_TIMEOUT_S)
        with connection:  # the stream keeps it open
            return connection.makefile("rwb")

    def _ask(self, request: dict[str, object]) -> float:
        """The time in the reply. A question that is broken off, by Ctrl-C for one, ends the connection with it.

        Otherwise its reply would be taken for that of the next question, and so on for ever.
        """
        if self._stream is None:
            self._stream = self._connect()
        try:
            self._stream.write(json.dumps(request).encode() + b"\n")
            self._stream.flush()
            reply = json.loads(self._stream.readline())
        except (OSError, ValueError) as error:
            self.close()
            raise TransportError(f"clock: the simulators at {self._address} are gone ({error}).") from error
        except BaseException:
            self.close()
            raise
        if not reply["ok"]:
            raise TransportError(f"clock: the simulators at {self._address} refuse {request}: {reply.get('error')}")
        return float(reply["time_s"])
