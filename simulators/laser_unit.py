"""The LEGO RCX of the laser unit behind a serial infrared tower, which echoes what it sends.

Packets: 55 FF 00, each payload byte followed by its complement, the sum of the payload and its complement
(K. Proudfoot, RCX Internals). The reply's opcode is the complement of the request's. Bit 08 of the opcode toggles
between commands: a packet whose opcode equals that of the packet before is a repetition, its reply is given again and
nothing is done.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

from simulators.clock import NS_PER_S, Clock, Event
from simulators.line import Line
from simulators.world import World

HEADER = b"\xff\x00"  # the 55 before it is often lost
ROM_VERSION, FIRMWARE_VERSION = (3, 1), (3, 32)
MOTOR, LASER = 1, 2  # bits of the outputs A and B
ROTATION = 4  # type of a sensor
POWER_DOWN_MIN = 15
BATTERY_MV = 9000
FIXED_LENGTHS = {0xF7: 2, 0xFF: 2}  # opcodes whose low three bits do not count their parameters
TRANSFER = 0x45
TOGGLE = 0x08
INPUTS = 3


class PacketError(Exception):
    """Bytes behind a header that are no packet; the brick ignores them."""


def encode(payload: bytes) -> bytes:
    """A packet from the RCX or to it."""
    body = payload + bytes([sum(payload) & 0xFF])
    return b"\x55" + HEADER + bytes(byte for value in body for byte in (value, value ^ 0xFF))


def expected_length(payload: bytes) -> int | None:
    """How long the payload is that starts like this; None while that cannot be told."""
    opcode = payload[0]
    if opcode & ~TOGGLE == TRANSFER:
        return None if len(payload) < 5 else 6 + int.from_bytes(payload[3:5], "little")
    return FIXED_LENGTHS.get(opcode, 1 + (opcode & 0x07))


@dataclass
class Brick:
    """The RCX itself: outputs, one rotation sensor on input 1, program memory, power switch."""

    clock: Clock
    world: World
    powered: bool = True
    power_down_min: int = POWER_DOWN_MIN
    outputs: dict[int, int] = field(default_factory=lambda: dict.fromkeys((1, 2, 4), 0x08 | 7))
    types: list[int] = field(default_factory=lambda: [0] * INPUTS)
    modes: list[int] = field(default_factory=lambda: [0] * INPUTS)
    message: int = 0
    program: int = 0
    tasks: dict[int, bytes] = field(default_factory=dict)
    running: set[int] = field(default_factory=set)
    _zero_ticks: float = 0.0
    _last_opcode: int | None = None
    _last_reply: bytes | None = None
    _power_down: Event | None = None
    _loading: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        self._await_power_down()

    def switch(self, on: bool) -> None:
        """Press the power button, or let the brick switch itself off; off, it forgets its toggle bit and sensor."""
        self.powered = on
        self._last_opcode = self._last_reply = None
        if not on:
            self.running.clear()
            for bit in self.outputs:
                self._output(bit, 0x40)
        self.types, self.modes, self._zero_ticks = [0] * INPUTS, [0] * INPUTS, self._ticks()
        self.power_down_min = POWER_DOWN_MIN
        self._await_power_down()

    def answer(self, payload: bytes) -> bytes | None:
        """The reply's payload; None where the brick stays silent."""
        if not self.powered:
            return None
        self._await_power_down()
        opcode = payload[0]
        if opcode in FIXED_LENGTHS:
            self.message = payload[1]
            return None
        if opcode == self._last_opcode:
            return self._last_reply
        handler = self._opcodes.get(opcode & ~TOGGLE)
        if handler is None:
            return None
        data = handler(self, payload[1:])
        self._last_opcode = opcode
        self._last_reply = None if data is None else bytes([opcode ^ 0xFF]) + data
        return self._last_reply

    def status(self) -> dict[str, Any]:
        """The brick's state for people and tests."""
        return {
            "powered": self.powered,
            "power_down_min": self.power_down_min,
            "message": self.message,
            "program": self.program,
            "tasks": {str(task): len(code) for task, code in self.tasks.items()},
            "running": sorted(self.running),
        }

    def _await_power_down(self) -> None:
        """Count the time until the brick switches itself off from now on."""
        if self._power_down is not None:
            self._power_down.cancel()
        self._power_down = None
        if self.powered and self.power_down_min:
            self._power_down = self.clock.after(60.0 * self.power_down_min, lambda: self.switch(on=False))

    def _ticks(self) -> float:
        return self.world.laser.motor.ticks(self.clock.now_ns())

    def _alive(self, _: bytes) -> bytes:
        return b""

    def _versions(self, key: bytes) -> bytes | None:
        if key != bytes([1, 3, 5, 7, 11]):
            return None
        return b"".join(part.to_bytes(2, "big") for part in (*ROM_VERSION, *FIRMWARE_VERSION))

    def _battery(self, _: bytes) -> bytes:
        return (BATTERY_MV - self.clock.now_ns() // (50 * NS_PER_S) % 1500).to_bytes(2, "little")

    def _value(self, argument: bytes) -> bytes:
        source, number = argument
        value = 0
        match source:
            case 2:
                value = number
            case 3 if 1 << number in self.outputs:
                value = self.outputs[1 << number]
            case 8:
                value = self.program
            case 9 | 12 if number < INPUTS:
                value = self._rotation(number)
            case 10 if number < INPUTS:
                value = self.types[number]
            case 11 if number < INPUTS:
                value = self.modes[number]
            case 15:
                value = self.message
        return (value & 0xFFFF).to_bytes(2, "little")

    def _rotation(self, number: int) -> int:
        """Sixteenths of a turn since the sensor was cleared; an input without a sensor reads open, 1023."""
        if number != 0 or self.types[0] != ROTATION:
            return 1023
        counted = self._ticks() - self._zero_ticks
        return int(counted // 1)

    def _set_type(self, argument: bytes) -> bytes:
        if argument[0] < INPUTS:
            self.types[argument[0]] = argument[1]
            self._zero_ticks = self._ticks() if argument[0] == 0 else self._zero_ticks
        return b""

    def _set_mode(self, argument: bytes) -> bytes:
        if argument[0] < INPUTS:
            self.modes[argument[0]] = argument[1]
        return b""

    def _clear(self, argument: bytes) -> bytes:
        if argument[0] == 0:
            self._zero_ticks = self._ticks()
        return b""

    def _power_down_delay(self, argument: bytes) -> bytes:
        self.power_down_min = argument[0]
        self._await_power_down()
        return b""

    def _power_off(self, _: bytes) -> bytes:
        self.clock.after(0.1, lambda: self.switch(on=False))
        return b""

    def _on_off(self, argument: bytes) -> bytes:
        for bit in self.outputs:
            if argument[0] & bit:
                self._output(bit, argument[0] & 0xC0)
        return b""

    def _direction(self, argument: bytes) -> bytes:
        for bit, state in self.outputs.items():
            if argument[0] & bit:
                forward = {0x80: 0x08, 0x00: 0x00}.get(argument[0] & 0xC0, ~state & 0x08)
                self.outputs[bit] = state & ~0x08 | forward
                self._drive(bit)
        return b""

    def _power(self, argument: bytes) -> bytes:
        motors, source, value = argument
        level = value if source == 2 else 7
        for bit, state in self.outputs.items():
            if motors & bit:
                self.outputs[bit] = state & ~0x07 | level & 0x07
                self._drive(bit)
        return b""

    def _output(self, bit: int, state: int) -> None:
        self.outputs[bit] = self.outputs[bit] & 0x0F | state
        self._drive(bit)

    def _drive(self, bit: int) -> None:
        """Let the world follow an output."""
        state = self.outputs[bit]
        on = bool(state & 0x80)
        if bit == MOTOR:
            self.world.turn_laser((1 if state & 0x08 else -1) if on else 0, state & 0x07)
        elif bit == LASER:
            self.world.laser.on = on

    def _stop_tasks(self, _: bytes) -> bytes:
        self.running.clear()
        return b""

    def _start_task(self, argument: bytes) -> bytes:
        self.running.add(argument[0])
        return b""

    def _stop_task(self, argument: bytes) -> bytes:
        self.running.discard(argument[0])
        return b""

    def _delete_tasks(self, _: bytes) -> bytes:
        self.tasks.clear()
        return b""

    def _nothing(self, _: bytes) -> bytes:
        return b""

    def _select_program(self, argument: bytes) -> bytes:
        self.program = argument[0]
        self.running.clear()
        return b""

    def _start_download(self, argument: bytes) -> bytes:
        """A task's number and length; reply 0 = there is room."""
        self._loading = (argument[1], int.from_bytes(argument[3:5], "little"))
        self.tasks[argument[1]] = b""
        return b"\x00"

    def _transfer(self, argument: bytes) -> bytes:
        """A block with its own checksum; reply 0 = taken, 3 = checksum wrong, 6 = no download active."""
        block, checksum = argument[4:-1], argument[-1]
        if self._loading is None:
            return b"\x06"
        if sum(block) & 0xFF != checksum:
            return b"\x03"
        task, length = self._loading
        self.tasks[task] += block
        if len(self.tasks[task]) >= length:
            self._loading = None
        return b"\x00"

    def _set_datalog_size(self, _: bytes) -> bytes:
        """Reply 0 = there is room."""
        return b"\x00"

    def _memory_map(self, _: bytes) -> bytes:
        return b"".join((0x8000 + 2 * i).to_bytes(2, "big") for i in range(94))

    _opcodes: ClassVar[dict[int, Callable[["Brick", bytes], bytes | None]]] = {
        0x10: _alive, 0x15: _versions, 0x30: _battery, 0x12: _value, 0x32: _set_type,
        0x42: _set_mode, 0xD1: _clear, 0x31: _nothing, 0xB1: _power_down_delay,
        0x60: _power_off, 0x13: _power, 0x21: _on_off, 0xE1: _direction,
        0x50: _stop_tasks, 0x71: _start_task, 0x81: _stop_task, 0x40: _delete_tasks,
        0x70: _nothing, 0x51: _nothing, 0x22: _nothing, 0x91: _select_program,
        0x25: _start_download, TRANSFER: _transfer, 0x20: _memory_map, 0x52: _set_datalog_size,
    }  # fmt: skip


class Tower:
    """The serial tower: echoes, finds packets, hands them to the brick."""

    def __init__(self, line: Line, brick: Brick) -> None:
        self._line = line
        self._brick = brick
        self._pending = b""

    def receive(self, data: bytes, gap_s: float) -> None:
        """Take bytes that came that long after those before."""
        self._line.write(data)
        self._pending = data if gap_s > 0.2 else self._pending + data
        while (found := self._next()) is not None:
            payload, length = found
            fault = self._line.request(length)
            answer = None if fault and fault.kind in ("lose", "nak", "busy") else self._brick.answer(payload)
            if answer is not None or fault:
                self._line.reply(encode(answer) if answer else b"", fault)

    def _next(self) -> tuple[bytes, int] | None:
        """Cut the next whole packet out of what has come: payload, and bytes on the wire."""
        while (start := self._pending.find(HEADER)) >= 0:
            body = self._pending[start + len(HEADER) :]
            try:
                payload = decode_body(body)
            except PacketError:
                self._pending = body
                continue
            if payload is None:
                return None
            length = start + len(HEADER) + 2 * (len(payload) + 1)
            self._pending = self._pending[length:]
            return payload, length
        self._pending = self._pending[-1:]
        return None


def decode_body(body: bytes) -> bytes | None:
    """The payload behind a header; None while bytes are missing. Raises PacketError."""
    if len(body) % 2:
        body = body[:-1]
    values, complements = body[::2], body[1::2]
    length = expected_length(values) if values else None
    wanted = len(values) if length is None else min(length + 1, len(values))
    if any(value ^ complement != 0xFF for value, complement in zip(values[:wanted], complements, strict=False)):
        raise PacketError("a complement is wrong")
    if length is None or len(values) < length + 1:
        return None
    if sum(values[:length]) & 0xFF != values[length]:
        raise PacketError("the checksum is wrong")
    return values[:length]
