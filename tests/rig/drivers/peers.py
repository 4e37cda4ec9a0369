"""Scripted devices at the other end of real wires, serial ports and TCP. They know bytes, not our codecs."""

import os
import select
import socket
import threading
import tty
from collections.abc import Callable
from pathlib import Path


class VirtualClock:
    """A rig clock that only sleeps move; `at` runs an action when its time has come."""

    def __init__(self) -> None:
        self.time_s = 0.0
        self._due: list[tuple[float, Callable[[], None]]] = []

    def now_s(self) -> float:
        return self.time_s

    def at(self, time_s: float, action: Callable[[], None]) -> None:
        self._due.append((time_s, action))

    def sleep(self, seconds: float) -> None:
        assert seconds >= 0
        self.time_s += seconds
        for time_s, action in sorted(self._due, key=lambda due: due[0]):
            if time_s <= self.time_s:
                self._due.remove((time_s, action))
                action()

    def has_waited(self, seconds: float) -> None:
        self.sleep(seconds)

    def close(self) -> None:
        pass


def cut_fixed(length: int) -> Callable[[bytearray], bytes | None]:
    """Requests of that many bytes each."""

    def cut(pending: bytearray) -> bytes | None:
        return bytes(pending[:length]) if len(pending) >= length else None

    return cut


def cut_enttec(pending: bytearray) -> bytes | None:
    """7E, label, length, data, E7."""
    size = 5 + int.from_bytes(pending[2:4], "little") if len(pending) >= 4 else 5
    return bytes(pending[:size]) if len(pending) >= size else None


def cut_rcx(pending: bytearray) -> bytes | None:
    """55 FF 00 and pairs, up to the first fitting checksum: the driver's requests are unambiguous."""
    plain = pending[3::2]
    for length in range(1, len(plain)):
        if sum(plain[:length]) & 0xFF == plain[length] and len(pending) >= 3 + 2 * (length + 1):
            return bytes(pending[: 3 + 2 * (length + 1)])
    return None


class PtyPeer:
    """A device behind a serial port, which a symbolic link names as an adapter's device file would.

    `answer` gets each request and returns the bytes to send back (b"": stay silent). `requests` keeps what came.
    """

    def __init__(
        self,
        link: Path,
        cut: Callable[[bytearray], bytes | None],
        answer: Callable[[bytes], bytes],
        *,
        echo: bool = False,
    ) -> None:
        self.link = link
        self.requests: list[bytes] = []
        self._cut, self._answer, self._echo = cut, answer, echo
        self.plug()

    @property
    def port(self) -> str:
        return str(self.link)

    def plug(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(self._slave))
        self._wake, self._woken = os.pipe()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def unplug(self) -> None:
        """The adapter is gone: the far end of the line is closed. Twice is allowed."""
        if self._thread.is_alive() or self._master >= 0:
            os.write(self._woken, b"x")
            self._thread.join()
            for descriptor in (self._master, self._slave, self._wake, self._woken):
                os.close(descriptor)
            self._master = -1

    def send(self, data: bytes) -> None:
        """Bytes that nobody asked for just now: noise, or a late reply. Returns when the port has them."""
        os.write(self._master, data)
        assert select.select([self._slave], [], [], 5.0)[0], "the pseudo-terminal did not pass the bytes on"

    def _serve(self) -> None:
        pending = bytearray()
        while True:
            ready, _, _ = select.select([self._master, self._wake], [], [])
            if self._wake in ready:
                return
            data = os.read(self._master, 4096)
            if self._echo:
                os.write(self._master, data)
            pending += data
            while (request := self._cut(pending)) is not None:
                del pending[: len(request)]
                self.requests.append(request)
                os.write(self._master, self._answer(request))


class TcpPeer:
    """A TCP server on the loopback; `serve` gets each connection in a thread of its own."""

    def __init__(self, serve: Callable[[socket.socket], None]) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._serve = serve
        self._connections: list[socket.socket] = []
        self._threads: list[threading.Thread] = []
        self._taken = threading.Event()
        self._thread = threading.Thread(target=self._accept)
        self._thread.start()

    @property
    def address(self) -> str:
        host, port = self._listener.getsockname()
        return f"{host}:{port}"

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._listener.close()
        self._drop()

    def hang_up(self) -> None:
        """Break every connection, of which there is at least one; new ones are taken."""
        assert self._taken.wait(5.0), "nobody connected"
        self._drop()

    def _drop(self) -> None:
        for connection in self._connections:
            try:
                connection.shutdown(socket.SHUT_RDWR)
            except OSError:  # the other end was faster
                continue
        for thread in self._threads:
            thread.join()
        for connection in self._connections:
            connection.close()
        self._connections, self._threads = [], []

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            thread = threading.Thread(target=self._run, args=(connection,))
            self._connections.append(connection)
            self._threads.append(thread)
            thread.start()
            self._taken.set()

    def _run(self, connection: socket.socket) -> None:
        try:
            self._serve(connection)
        except OSError:
            return


def read_exactly(connection: socket.socket, count: int) -> bytes:
    """Raises ConnectionError at the end of the stream."""
    data = b""
    while len(data) < count:
        part = connection.recv(count - len(data))
        if not part:
            raise ConnectionError("end of the stream")
        data += part
    return data
