"""Pseudo-terminals and TCP ports, served by one thread in a fixed order, so that equal requests have equal effects."""

import contextlib
import os
import selectors
import socket
import sys
import time
import tty
from collections.abc import Callable
from pathlib import Path

from simulators.clock import Clock

READ_SIZE = 1 << 16
HEAD_START_S = 0.0005  # in which the kernel hands over what was written to a pseudo-terminal before a TCP request


class Loop:
    """Waits for bytes and for the clock. Of several wires with bytes the one of the lowest rank is served first."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self._selector = selectors.DefaultSelector()
        self._ranks: dict[int, int] = {}
        self._running = True

    def add(self, descriptor: int, rank: int, ready: Callable[[int], None]) -> None:
        """Call `ready` with the selector's event mask when there are bytes."""
        self._selector.register(descriptor, selectors.EVENT_READ, ready)
        self._ranks[descriptor] = rank

    def want_write(self, descriptor: int, wanted: bool) -> None:
        """Also call `ready` when the descriptor takes bytes again."""
        ready = self._selector.get_key(descriptor).data
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if wanted else 0)
        self._selector.modify(descriptor, events, ready)

    def remove(self, descriptor: int) -> None:
        """Forget a descriptor."""
        self._selector.unregister(descriptor)
        del self._ranks[descriptor]

    def stop(self) -> None:
        """Let `run` return."""
        self._running = False

    def run(self) -> None:
        """Serve until stopped."""
        while self._running:
            self.clock.run_due()
            self.serve(self.clock.due_in_s())

    def serve(self, timeout_s: float | None, highest_rank: int = sys.maxsize) -> None:
        """Wait once and serve what is ready, up to a rank."""
        ready = [(self._ranks[key.fd], key.fd, key.data, mask) for key, mask in self._selector.select(timeout_s)]
        for rank, descriptor, handler, mask in sorted(ready, key=lambda entry: entry[:2]):
            if rank <= highest_rank and descriptor in self._ranks:
                handler(mask)


class Pty:
    """A serial port: a pseudo-terminal in raw mode, found by a symbolic link."""

    def __init__(self, loop: Loop, link: Path, rank: int, receive: Callable[[bytes, float], None]) -> None:
        self.link = link
        self._loop = loop
        self._rank = rank
        self._receive = receive
        self._descriptors: tuple[int, int] | None = None
        self._heard_s = 0.0
        self.plug()

    def plug(self) -> None:
        """Make the port appear."""
        if self._descriptors is not None:
            return
        master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(slave))
        # The slave stays open here too: a client that closes it must not hang up the line.
        self._descriptors = (master, slave)
        self._loop.add(master, self._rank, self._ready)

    def unplug(self, seconds: float) -> None:
        """Make it disappear, for that much simulated time or, at 0, for good."""
        self.close()
        if seconds > 0:
            self._loop.clock.after(seconds, self.plug)

    def write(self, data: bytes) -> None:
        """Send; what the host leaves unread beyond the kernel's buffer is lost, as on a wire."""
        if self._descriptors is not None and data:
            with contextlib.suppress(BlockingIOError):
                os.write(self._descriptors[0], data)

    def close(self) -> None:
        """Hang up."""
        if self._descriptors is not None:
            self._loop.remove(self._descriptors[0])
            for descriptor in self._descriptors:
                os.close(descriptor)
            self.link.unlink(missing_ok=True)
        self._descriptors = None

    def _ready(self, _mask: int) -> None:
        if self._descriptors is None:
            return
        with contextlib.suppress(BlockingIOError):
            data = os.read(self._descriptors[0], READ_SIZE)
            now_s = time.monotonic()
            gap_s, self._heard_s = now_s - self._heard_s, now_s
            self._receive(data, gap_s)


class TcpConnection:
    """One accepted connection; what cannot be sent at once waits."""

    def __init__(self, loop: Loop, stream: socket.socket, rank: int, service: "TcpPort") -> None:
        self._loop = loop
        self._stream = stream
        self._service = service
        self._unsent = bytearray()
        self._closing = False
        self._open = True
        stream.setblocking(False)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        loop.add(stream.fileno(), rank, self._ready)

    def write(self, data: bytes) -> None:
        """Send, or keep until it can be sent."""
        if self._open and not self._closing:
            self._unsent += data
            self._flush()

    def close(self) -> None:
        """Close after what was written has gone."""
        self._closing = True
        if not self._unsent:
            self.hang_up()

    def hang_up(self) -> None:
        """Close now."""
        if self._open:
            self._open = False
            self._loop.remove(self._stream.fileno())
            self._stream.close()
            self._service.forget(self)

    def _ready(self, mask: int) -> None:
        if mask & selectors.EVENT_WRITE:
            self._flush()
        if self._open and mask & selectors.EVENT_READ:
            self._read()

    def _read(self) -> None:
        try:
            data = self._stream.recv(READ_SIZE)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self._service.receive(self, data)
        else:
            self.hang_up()

    def _flush(self) -> None:
        try:
            sent = self._stream.send(self._unsent)
        except BlockingIOError:
            sent = 0
        except OSError:
            self.hang_up()
            return
        del self._unsent[:sent]
        if self._closing and not self._unsent:
            self.hang_up()
            return
        self._loop.want_write(self._stream.fileno(), bool(self._unsent))


Receive = Callable[[TcpConnection, bytes], None]
Lost = Callable[[TcpConnection], None]


class TcpPort:
    """A listening port and its connections."""

    def __init__(self, loop: Loop, address: tuple[str, int], rank: int, receive: Receive, lost: Lost) -> None:
        self._loop = loop
        self._wanted = address
        self._rank = rank
        self._lost = lost
        self.receive = receive
        self._connections: list[TcpConnection] = []
        self._listener: socket.socket | None = None
        self.plug()

    @property
    def address(self) -> str:
        """host:port"""
        return f"{self._wanted[0]}:{self._wanted[1]}"

    def plug(self) -> None:
        """Listen. Raises OSError where the port is taken."""
        if self._listener is not None:
            return
        self._listener = socket.create_server(self._wanted)
        self._listener.setblocking(False)
        self._wanted = self._listener.getsockname()
        self._loop.add(self._listener.fileno(), self._rank, self._accept)

    def unplug(self, seconds: float) -> None:
        """Hang up and refuse connections, for that much simulated time or, at 0, for good."""
        self.close()
        if seconds > 0:
            self._loop.clock.after(seconds, self.plug)

    def close(self) -> None:
        """Hang up and listen no more."""
        if self._listener is not None:
            self._loop.remove(self._listener.fileno())
            self._listener.close()
        self._listener = None
        for connection in list(self._connections):
            connection.hang_up()

    def forget(self, connection: TcpConnection) -> None:
        """The connection has ended."""
        self._connections.remove(connection)
        self._lost(connection)

    def _accept(self, _mask: int) -> None:
        if self._listener is None:
            return
        with contextlib.suppress(BlockingIOError):
            stream, _ = self._listener.accept()
            self._connections.append(TcpConnection(self._loop, stream, self._rank, self))
