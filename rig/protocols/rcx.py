"""LEGO RCX packets: 55 FF 00, payload bytes each with its complement, checksum with its complement.

Source: K. Proudfoot, RCX Internals ("RCX serial protocol", "RCX opcode reference"); the vectors were taken from nqc.
"""

import struct
from enum import IntEnum

from rig.errors import FrameError

TOGGLE = 0x08
_HEADER = b"\x55\xff\x00"
_MARK = b"\xff\x00"  # the first 55 is often lost


class Opcode(IntEnum):
    """Requests, toggle bit clear."""

    ALIVE = 0x10
    GET_VALUE = 0x12
    MOTOR_POWER = 0x13
    MOTOR_STATE = 0x21
    SENSOR_TYPE = 0x32
    SENSOR_MODE = 0x42
    POWER_DOWN_DELAY = 0xB1
    CLEAR_SENSOR = 0xD1
    MOTOR_DIRECTION = 0xE1


_REQUEST_LENGTH = {
    Opcode.ALIVE: 1,
    Opcode.GET_VALUE: 3,
    Opcode.MOTOR_POWER: 4,
    Opcode.MOTOR_STATE: 2,
    Opcode.SENSOR_TYPE: 3,
    Opcode.SENSOR_MODE: 3,
    Opcode.POWER_DOWN_DELAY: 2,
    Opcode.CLEAR_SENSOR: 2,
    Opcode.MOTOR_DIRECTION: 2,
}
_REPLY_LENGTH = {~opcode & 0xFF & ~TOGGLE: 3 if opcode is Opcode.GET_VALUE else 1 for opcode in _REQUEST_LENGTH}
_PAYLOAD_LENGTH: dict[int, int] = _REQUEST_LENGTH | _REPLY_LENGTH


class Source(IntEnum):
    """Sources of the get-value request."""

    IMMEDIATE = 2
    MOTOR_STATE = 3
    SENSOR_VALUE = 9
    SENSOR_TYPE = 10
    SENSOR_MODE = 11


class Motor(IntEnum):
    """Bits of the motor outputs."""

    A = 1
    B = 2
    C = 4


MOTOR_ON = 0x80
MOTOR_OFF = 0x40
DIRECTION_FORWARD = 0x80
DIRECTION_REVERSE = 0x00
SENSOR_TYPE_ROTATION = 4
SENSOR_MODE_ANGLE = 0xE0  # counts of 1/16 turn, signed
SENSOR_MODE_MASK = 0xE0  # the low bits are the slope, which this mode does not use


def encode(payload: bytes) -> bytes:
    """The packet that carries a payload."""
    body = payload + bytes([sum(payload) & 0xFF])
    return _HEADER + b"".join(bytes([byte, byte ^ 0xFF]) for byte in body)


def decode(packet: bytes) -> bytes:
    """Payload of one whole packet, with or without the first 55.

    Raises FrameError where the header, a complement or the checksum is wrong.
    """
    body = packet.removeprefix(b"\x55").removeprefix(_MARK)
    if len(packet) - len(body) < len(_MARK) or len(body) < 4 or len(body) % 2:
        raise FrameError(f"not an RCX packet: {packet.hex(' ')}")
    plain = body[0::2]
    if any(byte ^ other != 0xFF for byte, other in zip(plain, body[1::2], strict=True)):
        raise FrameError(f"RCX packet with a wrong complement: {packet.hex(' ')}")
    if sum(plain[:-1]) & 0xFF != plain[-1]:
        raise FrameError(f"RCX packet with a wrong checksum: {packet.hex(' ')}")
    return plain[:-1]


def reply_opcode(request: bytes) -> int:
    """The opcode that answers a request: its complement."""
    return request[0] ^ 0xFF


def toggled(payload: bytes, toggle: bool) -> bytes:
    """The payload with the opcode's toggle bit set or not.

    The RCX takes an opcode byte equal to the last one for a repetition: it repeats its reply and executes nothing.
    """
    opcode = payload[0] | TOGGLE if toggle else payload[0] & ~TOGGLE
    return bytes([opcode]) + payload[1:]


def alive() -> bytes:
    """Ask whether it is there."""
    return bytes([Opcode.ALIVE])


def power_down_delay(minutes: int) -> bytes:
    """Switch off by itself after so long without use; 0 means never."""
    return bytes([Opcode.POWER_DOWN_DELAY, minutes])


def sensor_type(sensor: int, kind: int) -> bytes:
    """What is plugged into an input (0 to 2)."""
    return bytes([Opcode.SENSOR_TYPE, sensor, kind])


def sensor_mode(sensor: int, mode: int) -> bytes:
    """How an input (0 to 2) is read."""
    return bytes([Opcode.SENSOR_MODE, sensor, mode])


def clear_sensor(sensor: int) -> bytes:
    """Set an input's count to zero."""
    return bytes([Opcode.CLEAR_SENSOR, sensor])


def get_value(source: Source, argument: int) -> bytes:
    """Ask for a value; `value` reads the reply."""
    return bytes([Opcode.GET_VALUE, source, argument])


def motor_power(motors: int, power: int) -> bytes:
    """Power 0 to 7 of the outputs in the bit mask."""
    return bytes([Opcode.MOTOR_POWER, motors, Source.IMMEDIATE, power])


def motor_direction(motors: int, direction: int) -> bytes:
    """Direction of the outputs in the bit mask."""
    return bytes([Opcode.MOTOR_DIRECTION, motors | direction])


def motor_state(motors: int, state: int) -> bytes:
    """Outputs in the bit mask on or off (braked)."""
    return bytes([Opcode.MOTOR_STATE, motors | state])


def value(reply: bytes) -> int:
    """The signed short in the reply to get-value. Raises FrameError where the reply is not three bytes long."""
    if len(reply) != 3:
        raise FrameError(f"not the reply to an RCX get-value: {reply.hex(' ')}")
    return int(struct.unpack("<h", reply[1:])[0])


class PacketReader:
    """Payloads out of a stream of bytes in any chunking; requests (echoes) come out like replies.

    A packet does not say how long it is, and a payload may hold bytes that look like its own checksum: the length
    follows from the opcode. Opcodes that the driver does not speak are skipped like garbage.
    """

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[bytes]:
        """The payloads that these bytes complete."""
        self._buffer += data
        payloads: list[bytes] = []
        while (start := self._buffer.find(_MARK)) >= 0:
            self._buffer = self._buffer[start:]
            size = self._candidate()
            if len(self._buffer) < size:
                return payloads
            try:
                payloads.append(decode(self._buffer[:size]))
                self._buffer = self._buffer[size:]
            except FrameError:
                self._buffer = self._buffer[1:]
        self._buffer = self._buffer[-1:]  # may be the first byte of a mark
        return payloads

    def clear(self) -> None:
        """Forget what has been read of an unfinished packet."""
        self._buffer = b""

    def _candidate(self) -> int:
        """Size that the packet at the buffer's start must have; that of the mark where it cannot be one."""
        body = self._buffer[len(_MARK) :]
        if not body:
            return len(_MARK) + 1
        length = _PAYLOAD_LENGTH.get(body[0] & ~TOGGLE)
        pairs = zip(body[0::2], body[1::2], strict=False)
        if length is None or any(byte ^ other != 0xFF for byte, other in list(pairs)[: length + 1]):
            return len(_MARK)
        return len(_MARK) + 2 * (length + 1)
