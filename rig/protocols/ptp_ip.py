"""PTP/IP packets: length, type, fields, all least significant byte first (CIPA DC-005; ISO 15740 annex).

Two TCP connections: commands with their data phases on the first, events on the second.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

from rig.errors import FrameError

VERSION = 0x00010000
LENGTH_MAX = 256 * 2**20  # no camera of the rig sends more in one packet; more is a stream out of step
_HEADER = struct.Struct("<II")
NO_DATA_OUT = 1
DATA_OUT = 2


@dataclass(frozen=True, slots=True)
class InitCommandRequest:
    """Opens the command connection."""

    TYPE: ClassVar[int] = 1
    guid: bytes
    name: str
    version: int = VERSION


@dataclass(frozen=True, slots=True)
class InitCommandAck:
    """Accepts it; `connection` is to be named on the event connection."""

    TYPE: ClassVar[int] = 2
    connection: int
    guid: bytes
    name: str
    version: int = VERSION


@dataclass(frozen=True, slots=True)
class InitEventRequest:
    """Opens the event connection."""

    TYPE: ClassVar[int] = 3
    connection: int


@dataclass(frozen=True, slots=True)
class InitEventAck:
    """Accepts it."""

    TYPE: ClassVar[int] = 4


@dataclass(frozen=True, slots=True)
class InitFail:
    """Refuses either connection: 1 rejected, 2 busy, 3 unspecified."""

    TYPE: ClassVar[int] = 5
    reason: int


@dataclass(frozen=True, slots=True)
class OperationRequest:
    """Starts a transaction; `data_phase` is 2 where data goes out to the camera, else 1."""

    TYPE: ClassVar[int] = 6
    data_phase: int
    code: int
    transaction: int
    parameters: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class OperationResponse:
    """Ends a transaction."""

    TYPE: ClassVar[int] = 7
    code: int
    transaction: int
    parameters: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class EventPacket:
    """Something happened in the camera."""

    TYPE: ClassVar[int] = 8
    code: int
    transaction: int
    parameters: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class StartData:
    """A data phase of `length` bytes begins."""

    TYPE: ClassVar[int] = 9
    transaction: int
    length: int


@dataclass(frozen=True, slots=True)
class Data:
    """A part of a data phase."""

    TYPE: ClassVar[int] = 10
    transaction: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class Cancel:
    """Ends a data phase early."""

    TYPE: ClassVar[int] = 11
    transaction: int


@dataclass(frozen=True, slots=True)
class EndData:
    """The last part of a data phase."""

    TYPE: ClassVar[int] = 12
    transaction: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class Ping:
    """Probe of the event connection; to be answered by a pong."""

    TYPE: ClassVar[int] = 13


@dataclass(frozen=True, slots=True)
class Pong:
    """Answer to a probe."""

    TYPE: ClassVar[int] = 14


Packet: TypeAlias = (
    InitCommandRequest
    | InitCommandAck
    | InitEventRequest
    | InitEventAck
    | InitFail
    | OperationRequest
    | OperationResponse
    | EventPacket
    | StartData
    | Data
    | Cancel
    | EndData
    | Ping
    | Pong
)


def encode(packet: Packet) -> bytes:
    """The bytes of a packet."""
    body = _body(packet)
    return _HEADER.pack(_HEADER.size + len(body), packet.TYPE) + body


def decode(data: bytes) -> Packet:
    """One whole packet. Raises FrameError where the length, the type or a field is wrong."""
    if len(data) < _HEADER.size:
        raise FrameError(f"not a PTP/IP packet: {data.hex(' ')}")
    length, kind = _HEADER.unpack_from(data)
    if length != len(data) or kind not in _DECODERS:
        raise FrameError(f"not a PTP/IP packet: {data[:64].hex(' ')}")
    try:
        return _DECODERS[kind](data[_HEADER.size :])
    except (struct.error, UnicodeDecodeError) as error:
        raise FrameError(f"PTP/IP packet of type {kind} with a wrong field: {data[:64].hex(' ')}") from error


class PacketReader:
    """Packets out of a stream of bytes in any chunking.

    PTP/IP runs over TCP, which neither loses nor inserts bytes, and has no mark to search for: a header that makes no
    sense raises FrameError, and the connection has to be opened anew.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Packet]:
        """The packets that these bytes complete. Raises FrameError where the stream is out of step."""
        self._buffer += data
        packets = []
        while len(self._buffer) >= _HEADER.size:
            length, kind = _HEADER.unpack_from(self._buffer)
            if not _HEADER.size <= length <= LENGTH_MAX or kind not in _DECODERS:
                raise FrameError(f"PTP/IP stream out of step: {bytes(self._buffer[:32]).hex(' ')}")
            if len(self._buffer) < length:
                break
            packets.append(decode(bytes(self._buffer[:length])))
            del self._buffer[:length]
        return packets

    def clear(self) -> None:
        """Forget what has been read of an unfinished packet."""
        self._buffer.clear()


def _body(packet: Packet) -> bytes:
    match packet:
        case InitCommandRequest(guid, name, version):
            return guid + _name(name) + struct.pack("<I", version)
        case InitCommandAck(connection, guid, name, version):
            return struct.pack("<I", connection) + guid + _name(name) + struct.pack("<I", version)
        case InitEventRequest(number) | InitFail(number) | Cancel(number):
            return struct.pack("<I", number)
        case OperationRequest(data_phase, code, transaction, parameters):
            return struct.pack(f"<IHI{len(parameters)}I", data_phase, code, transaction, *parameters)
        case OperationResponse(code, transaction, parameters) | EventPacket(code, transaction, parameters):
            return struct.pack(f"<HI{len(parameters)}I", code, transaction, *parameters)
        case StartData(transaction, length):
            return struct.pack("<IQ", transaction, length)
        case Data(transaction, payload) | EndData(transaction, payload):
            return struct.pack("<I", transaction) + payload
        case InitEventAck() | Ping() | Pong():
            return b""


def _name(text: str) -> bytes:
    return text.encode("utf-16-le") + b"\0\0"


def _named(body: bytes) -> tuple[bytes, str, int]:
    """GUID, name and version; a version that is missing counts as 1.0, as the cameras that leave it out mean it."""
    end = next((at for at in range(16, len(body) - 1, 2) if body[at : at + 2] == b"\0\0"), None)
    if len(body) < 18 or end is None:
        raise struct.error("the name does not end")
    rest = body[end + 2 :]
    return body[:16], body[16:end].decode("utf-16-le"), struct.unpack("<I", rest)[0] if rest else VERSION


def _u32(body: bytes) -> int:
    return int(struct.unpack("<I", body)[0])


def _parameters(body: bytes) -> tuple[int, ...]:
    return struct.unpack(f"<{len(body) // 4}I", body)


def _operation(body: bytes) -> OperationRequest:
    data_phase, code, transaction = struct.unpack_from("<IHI", body)
    return OperationRequest(data_phase, code, transaction, _parameters(body[10:]))


def _response(body: bytes) -> OperationResponse:
    code, transaction = struct.unpack_from("<HI", body)
    return OperationResponse(code, transaction, _parameters(body[6:]))


def _event(body: bytes) -> EventPacket:
    code, transaction = struct.unpack_from("<HI", body)
    return EventPacket(code, transaction, _parameters(body[6:]))


_DECODERS: dict[int, Callable[[bytes], Packet]] = {
    InitCommandRequest.TYPE: lambda body: InitCommandRequest(*_named(body)),
    InitCommandAck.TYPE: lambda body: InitCommandAck(_u32(body[:4]), *_named(body[4:])),
    InitEventRequest.TYPE: lambda body: InitEventRequest(_u32(body)),
    InitEventAck.TYPE: lambda body: InitEventAck(),
    InitFail.TYPE: lambda body: InitFail(_u32(body)),
    OperationRequest.TYPE: _operation,
    OperationResponse.TYPE: _response,
    EventPacket.TYPE: _event,
    StartData.TYPE: lambda body: StartData(_u32(body[:4]), int(struct.unpack("<Q", body[4:])[0])),
    Data.TYPE: lambda body: Data(_u32(body[:4]), body[4:]),
    Cancel.TYPE: lambda body: Cancel(_u32(body)),
    EndData.TYPE: lambda body: EndData(_u32(body[:4]), body[4:]),
    Ping.TYPE: lambda body: Ping(),
    Pong.TYPE: lambda body: Pong(),
}
