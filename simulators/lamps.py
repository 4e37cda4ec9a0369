"""The ENTTEC DMX USB Pro widget and the lamps on its universe.

Messages: 7E, label, length (least significant byte first), data, E7 (DMX USB Pro Widget API Specification 1.44).
DMX itself is one-way: no lamp ever answers.
"""

from enum import IntEnum

from simulators.line import Line
from simulators.world import LampBank

START, END = 0x7E, 0xE7
LENGTH_MAX = 600
FIRMWARE = (44, 1)  # 1.44, least significant byte first
SERIAL_BCD = bytes.fromhex("78563412")
ESTA_ENTTEC = bytes.fromhex("4e45")  # manufacturer 454E, least significant byte first
DMX_USB_PRO = bytes.fromhex("0100")


class Label(IntEnum):
    """What a message is about."""

    GET_PARAMETERS = 3
    SET_PARAMETERS = 4
    OUTPUT = 6
    SERIAL = 10
    MANUFACTURER = 77
    DEVICE = 78


def message(label: int, data: bytes) -> bytes:
    """A framed message."""
    return bytes([START, label, len(data) & 0xFF, len(data) >> 8]) + data + bytes([END])


class Widget:
    """Finds messages in the bytes of the host and obeys them; rubbish between messages is skipped."""

    def __init__(self, line: Line, lamps: LampBank) -> None:
        self._line = line
        self._lamps = lamps
        self._pending = b""
        self._timing = bytes([9, 1, 40])  # break and mark after break in units of 10.67 us, frames per second
        self._user = b""

    def receive(self, data: bytes, _gap_s: float) -> None:
        """Take bytes from the host."""
        self._pending += data
        while (found := self._next()) is not None:
            label, body = found
            fault = self._line.request(len(body) + 5)
            if fault and fault.kind in ("lose", "nak", "busy"):
                continue
            answer = self._answer(label, body)
            if answer is not None or fault:
                self._line.reply(answer or b"", fault)

    def _next(self) -> tuple[int, bytes] | None:
        """Cut the next whole message out of what has come."""
        while True:
            start = self._pending.find(START)
            self._pending = self._pending[start:] if start >= 0 else b""
            if len(self._pending) < 5:
                return None
            length = self._pending[2] | self._pending[3] << 8
            if length <= LENGTH_MAX and len(self._pending) < length + 5:
                return None
            if length <= LENGTH_MAX and self._pending[length + 4] == END:
                label, body = self._pending[1], self._pending[4 : length + 4]
                self._pending = self._pending[length + 5 :]
                return label, body
            self._pending = self._pending[1:]

    def _answer(self, label: int, body: bytes) -> bytes | None:
        match label:
            case Label.GET_PARAMETERS:
                wanted = int.from_bytes(body[:2], "little")
                return message(label, bytes(FIRMWARE) + self._timing + self._user.ljust(wanted, b"\0")[:wanted])
            case Label.SET_PARAMETERS if len(body) >= 5:
                self._timing, self._user = body[2:5], body[5:]
            case Label.OUTPUT if 25 <= len(body) <= 513 and body[0] == 0:
                self._lamps.universe = body[1:]
            case Label.SERIAL:
                return message(label, SERIAL_BCD)
            case Label.MANUFACTURER:
                return message(label, ESTA_ENTTEC + b"ENTTEC\0")
            case Label.DEVICE:
                return message(label, DMX_USB_PRO + b"DMX USB PRO\0")
        return None
