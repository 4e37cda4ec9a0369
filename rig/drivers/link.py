"""Request and reply over a byte stream: matching, deadlines, bounded retries, and a trace for messages."""

import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Generic, Protocol, TypeVar

from rig.drivers.clock import Deadline, RigClock
from rig.drivers.transport import Transport
from rig.errors import FrameError, ReadTimeoutError, TransportError

FrameT = TypeVar("FrameT")

_TRACE_LENGTH = 8
_TRACE_BYTES = 24  # shown of one chunk
_QUIET_S = 0.25  # of silence behind bytes that are no reply: over a serial wire a reply comes in one piece


class Reader(Protocol[FrameT]):
    """Incremental framing of a protocol."""

    def feed(self, data: bytes) -> list[FrameT]:
        """The frames that these bytes complete."""
        ...

    def clear(self) -> None:
        """Forget what has been read of an unfinished frame."""
        ...


class Echo:
    """Strips what a serial infrared tower echoes of every byte sent; a tower that does not echo passes unchanged."""

    def __init__(self) -> None:
        self._expected = b""
        self._held = b""

    def sent(self, data: bytes) -> None:
        """An echo of this may follow; what was held of the one before is forgotten."""
        self._expected, self._held = data, b""

    def strip(self, data: bytes) -> bytes:
        """The bytes that are not echo. What may still become one is held back."""
        self._held += data
        if self._held.startswith(self._expected):
            rest, self._held = self._held[len(self._expected) :], b""
            self._expected = b""
            return rest
        if self._expected.startswith(self._held):
            return b""
        rest, self._held, self._expected = self._held, b"", b""
        return rest


class Link(Generic[FrameT]):
    """One wire with one conversation at a time.

    `request` sends and returns the first frame that the caller accepts; all others are dropped: late replies, noise,
    echoes. What came before a request can never answer it: it is drained first.
    """

    def __init__(
        self,
        device: str,
        transport: Transport,
        reader: Reader[FrameT],
        clock: RigClock,
        *,
        echo: Echo | None = None,
        quiet_s: float = _QUIET_S,
    ) -> None:
        """Nothing is opened yet. After rubbish, a silence of `quiet_s` ends the waiting before its time."""
        self.device = device
        self._transport = transport
        self._reader = reader
        self._clock = clock
        self._echo = echo
        self._quiet_s = quiet_s
        self._lock = threading.RLock()
        self._trace: deque[tuple[str, bytes]] = deque(maxlen=_TRACE_LENGTH)
        self._queue: deque[FrameT] = deque()

    def open(self) -> None:
        """Open the wire; what came over it before is forgotten. Raises ConnectError."""
        with self._lock:
            self._transport.open()
            self._reader.clear()
            self._queue.clear()

    @property
    def is_open(self) -> bool:
        """Whether the wire is open, as far as is known."""
        return self._transport.is_open

    def request(
        self, data: bytes, accept: Callable[[FrameT], bool], *, what: str, timeout_s: float, attempts: int = 1
    ) -> FrameT:
        """Send, and return the first frame that `accept` takes.

        `attempts` above 1 only for requests that are safe to repeat. A wire that was lost is opened anew first. Raises
        ReadTimeoutError where nothing came in time, FrameError where only rubbish came, TransportError when unplugged;
        messages hold the latest bytes both ways.
        """
        with self._lock:
            if not self._transport.is_open:
                self.open()
            for _ in range(attempts - 1):
                with suppress(ReadTimeoutError, FrameError):
                    return self._exchange(data, accept, what, timeout_s)
            return self._exchange(data, accept, what, timeout_s)

    def send(self, data: bytes) -> None:
        """Send without waiting for anything. Raises TransportError."""
        with self._lock:
            self._trace.append((">", data))
            if self._echo is not None:
                self._echo.sent(data)
            self._transport.write(data)

    def receive(self, accept: Callable[[FrameT], bool], *, what: str, timeout_s: float) -> FrameT:
        """The next frame that `accept` takes; others are dropped. Raises as `request` does."""
        with self._lock:
            deadline = Deadline(timeout_s)
            rubbish = False
            while True:
                while self._queue:
                    frame = self._queue.popleft()
                    if accept(frame):
                        return frame
                try:
                    left_s = deadline.left_s()
                    came = self._take(self._transport.read(min(left_s, self._quiet_s) if rubbish else left_s))
                    rubbish = not self._queue and (came or rubbish)
                except ReadTimeoutError as error:
                    self._clock.has_waited(timeout_s - deadline.left_s())
                    raise self._no_answer(what, timeout_s, rubbish=rubbish) from error

    def poll(self) -> list[FrameT]:
        """The frames that have come by now; does not wait. Raises TransportError when unplugged."""
        with self._lock:
            self._take(self._transport.drain())
            frames = list(self._queue)
            self._queue.clear()
            return frames

    def discard(self) -> None:
        """Drop all that has come by now. Raises TransportError when unplugged."""
        with self._lock:
            stale = self._transport.drain()
            if stale:
                self._trace.append(("<", stale))
            self._reader.clear()
            self._queue.clear()

    def trace(self) -> str:
        """The latest bytes both ways, in hex."""
        return ", ".join(f"{way} {_shown(data)}" for way, data in self._trace) or "no bytes yet"

    def close(self) -> None:
        """Close the wire; closing twice is allowed."""
        with self._lock:
            self._transport.close()

    def _exchange(self, data: bytes, accept: Callable[[FrameT], bool], what: str, timeout_s: float) -> FrameT:
        self.discard()
        self.send(data)
        return self.receive(accept, what=what, timeout_s=timeout_s)

    def _take(self, data: bytes) -> bool:
        """Whether there were other bytes than echo."""
        if data:
            self._trace.append(("<", data))
            data = data if self._echo is None else self._echo.strip(data)
            try:
                self._queue.extend(self._reader.feed(data))
            except FrameError as error:
                self._transport.close()
                raise TransportError(
                    f"{self.device}: {error}. The connection was closed; the next use opens it anew."
                ) from error
        return bool(data)

    def _no_answer(self, what: str, timeout_s: float, *, rubbish: bool) -> ReadTimeoutError | FrameError:
        if rubbish:
            return FrameError(f"{self.device}: what came is no reply to {what}. Last bytes: {self.trace()}")
        return ReadTimeoutError(
            f"{self.device}: no reply to {what} within {timeout_s:.3g} s. Is it switched on? Last bytes: {self.trace()}"
        )


def _shown(data: bytes) -> str:
    return data.hex(" ") if len(data) <= _TRACE_BYTES else f"{data[:_TRACE_BYTES].hex(' ')} ... ({len(data)} bytes)"
