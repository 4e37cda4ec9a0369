"""ENTTEC DMX USB Pro messages: 7E, label, length, data, E7 (DMX USB Pro Widget API Specification 1.44)."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from rig.errors import FrameError

START = 0x7E
END = 0xE7
DATA_MAX = 600
CHANNELS_MIN = 24
CHANNELS_MAX = 512
_DIMMER_START_CODE = b"\x00"
_HEADER = struct.Struct("<BBH")


class Label(IntEnum):
    """Message labels (API 1.44)."""

    OUTPUT = 6
    SERIAL_NUMBER = 10


@dataclass(frozen=True, slots=True)
class Message:
    """One message, either way."""

    label: int
    data: bytes


def encode(message: Message) -> bytes:
    """Raises FrameError where the data exceeds 600 bytes."""
    if len(message.data) > DATA_MAX:
        raise FrameError(f"label {message.label}: {len(message.data)} bytes are more than the {DATA_MAX} of a message")
    return _HEADER.pack(START, message.label, len(message.data)) + message.data + bytes([END])


def decode(datagram: bytes) -> Message:
    """Raises FrameError where a mark or the length is wrong."""
    if len(datagram) < _HEADER.size + 1:
        raise FrameError(f"not a whole ENTTEC message: {datagram.hex(' ')}")
    start, label, length = _HEADER.unpack_from(datagram)
    if start != START or length > DATA_MAX or len(datagram) != _HEADER.size + length + 1 or datagram[-1] != END:
        raise FrameError(f"not an ENTTEC message: {datagram.hex(' ')}")
    return Message(label, datagram[_HEADER.size : -1])


def output(levels: Sequence[int]) -> Message:
    """Label 6: levels of the channels 1 to len(levels), behind the start code 00 of dimmer data.

    A universe has 24 channels at least: shorter ones are filled with 0. Raises FrameError above 512 channels and
    for levels outside 0 to 255.
    """
    if len(levels) > CHANNELS_MAX or any(not 0 <= level <= 255 for level in levels):
        raise FrameError(f"a universe has at most {CHANNELS_MAX} channels of 0 to 255")
    return Message(Label.OUTPUT, _DIMMER_START_CODE + bytes(levels).ljust(CHANNELS_MIN, b"\0"))


def serial_request() -> Message:
    """Label 10: ask for the widget's serial number."""
    return Message(Label.SERIAL_NUMBER, b"")


def serial_number(reply: Message) -> int:
    """The number in a label 10 reply: four bytes of binary-coded decimals, least significant first.

    Raises FrameError where it is another message.
    """
    digits = reply.data[::-1].hex()
    if reply.label != Label.SERIAL_NUMBER or len(reply.data) != 4 or not digits.isdecimal():
        raise FrameError(f"not a serial number: label {reply.label}, {reply.data.hex(' ')}")
    return int(digits)


class MessageReader:
    """Messages out of a stream of bytes in any chunking.

    Where the end mark is not at its place, the search goes on one byte behind the start mark, so that a message
    behind garbage that looks like a start is found. A start mark in garbage can claim up to 600 bytes: the message
    behind it comes out once these have come, or at once after `clear`.
    """

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[Message]:
        """The messages that these bytes complete."""
        self._buffer += data
        messages = []
        while (size := self._size()) is not None:
            if self._buffer[size - 1] == END:
                messages.append(decode(self._buffer[:size]))
                self._buffer = self._buffer[size:]
            else:
                self._buffer = self._buffer[1:]
        return messages

    def clear(self) -> None:
        """Forget what has been read of an unfinished message."""
        self._buffer = b""

    def _size(self) -> int | None:
        """Length of the candidate at the buffer's start; None where more bytes are needed."""
        while (start := self._buffer.find(START)) >= 0:
            self._buffer = self._buffer[start:]
            if len(self._buffer) < _HEADER.size:
                return None
            length = _HEADER.unpack_from(self._buffer)[2]
            if length <= DATA_MAX:
                size = _HEADER.size + length + 1
                return size if len(self._buffer) >= size else None
            self._buffer = self._buffer[1:]
        self._buffer = b""
        return None
