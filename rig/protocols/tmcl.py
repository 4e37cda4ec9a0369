"""TMCL datagrams: nine bytes, big-endian value, checksum of the first eight (TMCM-1110 firmware manual, 3.1, 3.2)."""

import struct
from dataclasses import dataclass
from enum import IntEnum

from rig.errors import FrameError

LENGTH = 9
_FIELDS = struct.Struct(">BBBBi")


class Command(IntEnum):
    """Command numbers (TMCM-1110 firmware manual, 3.4)."""

    MOTOR_STOP = 3
    MOVE_TO_POSITION = 4
    SET_AXIS_PARAMETER = 5
    GET_AXIS_PARAMETER = 6
    REFERENCE_SEARCH = 13
    FIRMWARE_VERSION = 136


class Parameter(IntEnum):
    """Axis parameters (TMCM-1110 firmware manual, "Axis Parameters"): positions in microsteps, the rest as below."""

    TARGET_POSITION = 0
    ACTUAL_POSITION = 1
    ACTUAL_SPEED = 3
    MAXIMUM_SPEED = 4
    MAXIMUM_ACCELERATION = 5
    POSITION_REACHED = 8
    RAMP_DIVISOR = 153
    PULSE_DIVISOR = 154
    SEARCH_SPEED = 194
    SWITCH_SPEED = 195


INTERNAL_MAX = 2047
"""Largest speed and acceleration in the motion controller's own units."""
DIVISOR_MAX = 13
_OSCILLATOR_HZ = 16e6


def speed_unit(pulse_divisor: int) -> float:
    """Microsteps per second of one unit of speed (TMCM-1110 firmware manual, "Velocity and Acceleration")."""
    return float(_OSCILLATOR_HZ / (2**pulse_divisor * 2048 * 32))


def acceleration_unit(pulse_divisor: int, ramp_divisor: int) -> float:
    """Microsteps per second squared of one unit of acceleration (same section)."""
    return float(_OSCILLATOR_HZ**2 / 2 ** (pulse_divisor + ramp_divisor + 29))


class Search(IntEnum):
    """Types of the reference search command; STATUS answers 0 once no search is under way."""

    START = 0
    STOP = 1
    STATUS = 2


STATUS_OK = 100
STATUS_WRONG_CHECKSUM = 1
STATUS_MEANING = {
    100: "executed",
    101: "loaded into the program memory",
    1: "wrong checksum",
    2: "invalid command",
    3: "wrong type",
    4: "invalid value",
    5: "configuration memory locked",
    6: "command not available",
}
"""Status codes (TMCM-1110 firmware manual, 3.2.1)."""


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked of a module."""

    module: int
    command: int
    type: int
    motor: int
    value: int


@dataclass(frozen=True, slots=True)
class Reply:
    """What a module answers; `module` and `command` echo the request."""

    host: int
    module: int
    status: int
    command: int
    value: int


def encode_request(request: Request) -> bytes:
    """The nine bytes of a request."""
    return _sealed(_FIELDS.pack(request.module, request.command, request.type, request.motor, request.value))


def decode_request(datagram: bytes) -> Request:
    """Raises FrameError where the length or the checksum is wrong."""
    return Request(*_opened(datagram, "request"))


def encode_reply(reply: Reply) -> bytes:
    """The nine bytes of a reply."""
    return _sealed(_FIELDS.pack(reply.host, reply.module, reply.status, reply.command, reply.value))


def decode_reply(datagram: bytes) -> Reply:
    """Raises FrameError where the length or the checksum is wrong."""
    return Reply(*_opened(datagram, "reply"))


def move_absolute(module: int, motor: int, position_steps: int) -> Request:
    """MVP ABS: start moving to the position."""
    return Request(module, Command.MOVE_TO_POSITION, 0, motor, position_steps)


def motor_stop(module: int, motor: int) -> Request:
    """MST: decelerate to a stand."""
    return Request(module, Command.MOTOR_STOP, 0, motor, 0)


def get_parameter(module: int, motor: int, parameter: Parameter) -> Request:
    """GAP: read an axis parameter."""
    return Request(module, Command.GET_AXIS_PARAMETER, parameter, motor, 0)


def set_parameter(module: int, motor: int, parameter: Parameter, value: int) -> Request:
    """SAP: write an axis parameter until power goes."""
    return Request(module, Command.SET_AXIS_PARAMETER, parameter, motor, value)


def reference_search(module: int, motor: int, search: Search) -> Request:
    """RFS: start, stop or ask after the reference search."""
    return Request(module, Command.REFERENCE_SEARCH, search, motor, 0)


def firmware_version(module: int) -> Request:
    """Version in binary form: harmless, and its reply carries a checksum, which that of the text form lacks."""
    return Request(module, Command.FIRMWARE_VERSION, 1, 0, 0)


class ReplyReader:
    """Replies out of a stream of bytes in any chunking.

    TMCL marks neither start nor end, so a window of nine bytes slides until checksum and status fit. Where noise
    fits by accident, it swallows the reply behind it: who asked sees another module or command, and asks again.
    """

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[Reply]:
        """The replies that these bytes complete."""
        self._buffer += data
        replies = []
        while len(self._buffer) >= LENGTH:
            window = self._buffer[:LENGTH]
            if _checksum(window) == window[8] and window[2] in STATUS_MEANING:
                replies.append(decode_reply(window))
                self._buffer = self._buffer[LENGTH:]
            else:
                self._buffer = self._buffer[1:]
        return replies

    def clear(self) -> None:
        """Forget what has been read of an unfinished reply."""
        self._buffer = b""


def _checksum(datagram: bytes) -> int:
    return sum(datagram[:8]) & 0xFF


def _sealed(fields: bytes) -> bytes:
    return fields + bytes([_checksum(fields)])


def _opened(datagram: bytes, what: str) -> tuple[int, int, int, int, int]:
    if len(datagram) != LENGTH or _checksum(datagram) != datagram[8]:
        raise FrameError(f"not a TMCL {what}: {datagram.hex(' ')}")
    first, second, third, fourth, value = _FIELDS.unpack(datagram[:8])
    return first, second, third, fourth, value
