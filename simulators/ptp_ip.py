"""PTP over TCP: packets, the two connections of a host, data phases.

Source: CIPA DC-005 (PTP/IP), section 2.3: length u32, type u32, body, all little-endian.
"""

import hashlib
import struct
from dataclasses import dataclass
from typing import Protocol

from simulators.camera import BUSY, GENERAL_ERROR, Camera, strike
from simulators.line import Line

INIT_COMMAND, INIT_COMMAND_ACK, INIT_EVENT, INIT_EVENT_ACK, INIT_FAIL = 1, 2, 3, 4, 5
OPERATION, RESPONSE, EVENT, START_DATA, DATA, CANCEL, END_DATA, PING, PONG = 6, 7, 8, 9, 10, 11, 12, 13, 14
REJECTED, IN_USE = 1, 2
CHUNK = 1 << 16
PACKET_MAX = 1 << 26
DATA_OUT = 2


class Connection(Protocol):
    """A TCP connection as the simulators' server hands it over."""

    def write(self, data: bytes) -> None:
        """Send, or keep until it can be sent."""
        ...

    def close(self) -> None:
        """Close after what was written has gone."""
        ...


@dataclass
class Pending:
    """An operation whose data phase from the host is still coming."""

    code: int
    transaction: int
    parameters: tuple[int, ...]
    data: bytes = b""


def packet(kind: int, body: bytes) -> bytes:
    """A framed packet."""
    return struct.pack("<II", len(body) + 8, kind) + body


class Responder:
    """One camera's side of PTP/IP: one host at a time, with a command and an event connection."""

    def __init__(self, camera: Camera, line: Line) -> None:
        self._camera = camera
        self._line = line
        self._buffers: dict[Connection, bytes] = {}
        self._command: Connection | None = None
        self._event: Connection | None = None
        self._number = 0
        self._pending: Pending | None = None
        camera.notify = self._notify
        line.write = self._write

    def receive(self, connection: Connection, data: bytes) -> None:
        """Take bytes of a connection; several packets or parts of one."""
        buffered = self._buffers[connection] = self._buffers.get(connection, b"") + data
        while len(buffered) >= 8:
            length, kind = struct.unpack_from("<II", buffered)
            if not 8 <= length <= PACKET_MAX:
                connection.close()
                self.lost(connection)
                return
            if len(buffered) < length:
                return
            body, buffered = buffered[8:length], buffered[length:]
            self._buffers[connection] = buffered
            self._handle(connection, kind, body)
            if connection not in self._buffers:  # closed by what it asked for
                return

    def lost(self, connection: Connection) -> None:
        """The connection is gone; without its command connection a host is gone and its exposures are dropped."""
        self._buffers.pop(connection, None)
        if connection is self._event:
            self._event = None
        if connection is self._command:
            self._command = self._pending = None
            self._camera.close()
            if self._event is not None:
                self._event.close()
            self._event = None

    def _handle(self, connection: Connection, kind: int, body: bytes) -> None:
        if kind == INIT_COMMAND:
            self._init_command(connection)
        elif kind == INIT_EVENT:
            self._init_event(connection, body)
        elif kind == PING:
            connection.write(packet(PONG, b""))
        elif connection is self._command:
            self._command_packet(kind, body)

    def _init_command(self, connection: Connection) -> None:
        if self._command is not None:
            connection.write(packet(INIT_FAIL, struct.pack("<I", IN_USE)))
            connection.close()
            return
        self._command = connection
        self._number += 1
        layout = self._camera.layout
        guid = hashlib.blake2b(layout.serial.encode(), digest_size=16).digest()
        name = f"{layout.model} {layout.name}".encode("utf-16-le") + b"\0\0"
        body = struct.pack("<I", self._number) + guid + name + struct.pack("<I", 0x10000)
        connection.write(packet(INIT_COMMAND_ACK, body))

    def _init_event(self, connection: Connection, body: bytes) -> None:
        if self._command is None or body[:4] != struct.pack("<I", self._number):
            connection.write(packet(INIT_FAIL, struct.pack("<I", REJECTED)))
            connection.close()
            return
        self._event = connection
        connection.write(packet(INIT_EVENT_ACK, b""))

    def _command_packet(self, kind: int, body: bytes) -> None:
        if kind == OPERATION and len(body) >= 10:
            phase, code, transaction = struct.unpack_from("<IHI", body)
            parameters = struct.unpack_from(f"<{(len(body) - 10) // 4}I", body, 10)
            self._pending = Pending(code, transaction, parameters)
            if phase != DATA_OUT:
                self._execute()
        elif kind in (DATA, END_DATA) and self._pending is not None:
            self._pending.data += body[4:]
            if kind == END_DATA:
                self._execute()
        elif kind == CANCEL:
            self._pending = None
            self._camera.shutter.abort()

    def _execute(self) -> None:
        pending, self._pending = self._pending, None
        if pending is None:
            return
        fault = self._line.request(len(pending.data) + 18)
        kind = fault.kind if fault else None
        if kind == "lose":
            return
        if kind in ("nak", "busy"):
            refusal = BUSY if kind == "busy" else GENERAL_ERROR
            self._line.reply(_response(refusal, pending.transaction, ()), None)
            return
        code, parameters, data = self._camera.operate(
            pending.code, pending.transaction, pending.parameters, pending.data
        )
        response = _response(code, pending.transaction, parameters)
        if not data:
            self._line.reply(response, fault)
            return
        if fault is not None and kind in ("truncate", "corrupt"):
            data, fault = strike(fault, data), None
        self._line.reply(_data_phase(pending.transaction, data) + response, fault)

    def _notify(self, code: int, transaction: int, parameters: tuple[int, ...]) -> None:
        if self._event is not None:
            body = struct.pack(f"<HI{len(parameters)}I", code, transaction, *parameters)
            self._event.write(packet(EVENT, body))

    def _write(self, data: bytes) -> None:
        if self._command is not None:
            self._command.write(data)


def _response(code: int, transaction: int, parameters: tuple[int, ...]) -> bytes:
    return packet(RESPONSE, struct.pack(f"<HI{len(parameters)}I", code, transaction, *parameters))


def _data_phase(transaction: int, data: bytes) -> bytes:
    head = struct.pack("<I", transaction)
    starts = range(0, max(len(data), 1), CHUNK)
    parts = [packet(START_DATA, head + struct.pack("<Q", len(data)))]
    parts += [packet(DATA, head + data[start : start + CHUNK]) for start in starts[:-1]]
    parts.append(packet(END_DATA, head + data[starts[-1] :]))
    return b"".join(parts)
