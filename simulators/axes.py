"""Three TMCM-1110 stepper modules on one serial bus, speaking TMCL.

Nine-byte datagrams with the value's most significant byte first and the 8-bit sum of the first eight bytes behind them
(TMCM-1110 TMCL firmware manual V1.09, sections 3.1, 3.2). Speeds and accelerations are the TMC429's internal units
(section "Velocity and Acceleration Calculation"): v = 16 MHz value / (2^pulse_div 2048 32) microsteps per second,
a = (16 MHz)^2 value / 2^(pulse_div + ramp_div + 29).
"""

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from simulators.line import Line
from simulators.stage import Stage

CLOCK_HZ = 16e6
PULSE_DIVISOR, RAMP_DIVISOR = 6, 9
GAP_S = 0.05  # silence after which a module takes the next byte as the start of a datagram
OK, WRONG_CHECKSUM, INVALID_COMMAND, WRONG_TYPE, INVALID_VALUE = 100, 1, 2, 3, 4
MODULE_NUMBER, VERSION = 1110, (1, 9)

TARGET, ACTUAL, TARGET_SPEED, SPEED, MAX_SPEED, MAX_ACCELERATION, REACHED = 0, 1, 2, 3, 4, 5, 8
HOME_SWITCH, RIGHT_SWITCH, LEFT_SWITCH, ACTUAL_ACCELERATION = 9, 10, 11, 135
RAMP_DIV, PULSE_DIV, SEARCH_SPEED, SWITCH_SPEED, ERROR_FLAGS = 153, 154, 194, 195, 207
SETTINGS = {  # axis parameters that are kept and handed back: highest value
    6: 255, 7: 255, 12: 1, 13: 1, 130: 2047, 138: 2, 140: 8, 141: 4095, 149: 1, 162: 3, 204: 65535,
    193: 8, 205: 2047, 209: 2**31 - 1, 210: 65535, 214: 65535,
    MAX_SPEED: 2047, MAX_ACCELERATION: 2047, RAMP_DIV: 13, PULSE_DIV: 13, SEARCH_SPEED: 2047, SWITCH_SPEED: 2047,
}  # fmt: skip
FACTORY = {6: 128, 7: 8, 140: 4, 149: 1, 193: 7, 204: 2000, 214: 200}
POSITION_MAX = 2**23 - 1


class RefusalError(Exception):
    """A request that the module answers with this status."""

    def __init__(self, status: int) -> None:
        super().__init__(f"status {status}")
        self.status = status


@dataclass(frozen=True, slots=True)
class Request:
    """A TMCL datagram from the host; `bank` is the motor or the bank."""

    module: int
    command: int
    type: int
    bank: int
    value: int


def speed_unit(pulse_divisor: int) -> float:
    """Microsteps per second of one unit of speed."""
    return CLOCK_HZ / float((1 << pulse_divisor) * 2048 * 32)


def acceleration_unit(pulse_divisor: int, ramp_divisor: int) -> float:
    """Microsteps per second squared of one unit of acceleration."""
    return CLOCK_HZ * CLOCK_HZ / float(1 << (pulse_divisor + ramp_divisor + 29))


@dataclass
class Module:
    """The firmware of one module; its one motor is an axis of the world."""

    address: int
    axis: Stage
    host: int = 2
    parameters: dict[int, int] = field(default_factory=dict)
    globals: dict[tuple[int, int], int] = field(default_factory=dict)
    outputs: dict[int, int] = field(default_factory=lambda: dict.fromkeys(range(8), 0))

    def __post_init__(self) -> None:
        speed = round(self.axis.speed_steps_s / speed_unit(PULSE_DIVISOR))
        acceleration = round(self.axis.acceleration_steps_s2 / acceleration_unit(PULSE_DIVISOR, RAMP_DIVISOR))
        factory = dict.fromkeys(SETTINGS, 0) | FACTORY
        stored = {MAX_SPEED: speed, MAX_ACCELERATION: acceleration, PULSE_DIV: PULSE_DIVISOR, RAMP_DIV: RAMP_DIVISOR}
        search = {SEARCH_SPEED: speed // 2, SWITCH_SPEED: speed // 20}
        self.parameters = factory | stored | search | self.parameters
        self.globals = {(65, 0): 0, (66, 0): self.address, (75, 0): 0, (76, 0): self.host, (77, 0): 0, (84, 0): 0}
        self.globals |= {(number, 2): 0 for number in range(56)}

    def answer(self, datagram: bytes) -> bytes:
        """The reply to a datagram addressed to this module."""
        request = Request(*struct.unpack(">BBBBi", datagram[:8]))
        if sum(datagram[:8]) & 0xFF != datagram[8]:
            return self.reply(WRONG_CHECKSUM, request.command, 0)
        if request.command == 136 and request.type == 0:
            text = f"{MODULE_NUMBER}V{VERSION[0]}{VERSION[1]:02d}"
            return bytes([self.host]) + text.encode()
        try:
            return self.reply(OK, request.command, self._obey(request))
        except RefusalError as refusal:
            return self.reply(refusal.status, request.command, 0)

    def reply(self, status: int, command: int, value: int) -> bytes:
        """A reply datagram."""
        body = struct.pack(">BBBBI", self.host, self.address, status, command, value & 0xFFFFFFFF)
        return body + bytes([sum(body) & 0xFF])

    def _obey(self, request: Request) -> int:
        handler = self._commands.get(request.command)
        if handler is None:
            raise RefusalError(INVALID_COMMAND)
        return handler(self, request)

    def _acceleration(self) -> float:
        unit = acceleration_unit(self.parameters[PULSE_DIV], self.parameters[RAMP_DIV])
        return max(1, self.parameters[MAX_ACCELERATION]) * unit

    def _speed(self, parameter: int) -> float:
        return max(1, self.parameters[parameter]) * speed_unit(self.parameters[PULSE_DIV])

    def _rotate(self, request: Request) -> int:
        _require_motor(request)
        if abs(request.value) > 2047:
            raise RefusalError(INVALID_VALUE)
        velocity = request.value * speed_unit(self.parameters[PULSE_DIV])
        self.axis.rotate(velocity if request.command == 1 else -velocity, self._acceleration())
        return request.value

    def _stop(self, request: Request) -> int:
        _require_motor(request)
        self.axis.stop(self._acceleration())
        return 0

    def _move(self, request: Request) -> int:
        _require_motor(request)
        match request.type:
            case 0:
                target = request.value
            case 1:
                target = self.axis.counter() + request.value
            case _:
                raise RefusalError(WRONG_TYPE)
        self._position(target)
        return target

    def _position(self, target: int) -> None:
        if abs(target) > POSITION_MAX:
            raise RefusalError(INVALID_VALUE)
        self.axis.move(target, self._speed(MAX_SPEED), self._acceleration())

    def _set_parameter(self, request: Request) -> int:
        _require_motor(request)
        match request.type:
            case parameter if parameter in SETTINGS:
                if not 0 <= request.value <= SETTINGS[parameter]:
                    raise RefusalError(INVALID_VALUE)
                self.parameters[parameter] = request.value
            case 0:
                self._position(request.value)
            case 1:
                self.axis.redefine(request.value)
            case 2:
                self._rotate(Request(self.address, 1, 0, 0, request.value))
            case _:
                raise RefusalError(WRONG_TYPE)
        return request.value

    def _get_parameter(self, request: Request) -> int:
        _require_motor(request)
        if request.type in self.parameters:
            return self.parameters[request.type]
        readings: dict[int, Callable[[], int]] = {
            TARGET: self.axis.target,
            ACTUAL: self.axis.counter,
            TARGET_SPEED: lambda: round(self.axis.target_velocity() / speed_unit(self.parameters[PULSE_DIV])),
            SPEED: lambda: round(self.axis.velocity() / speed_unit(self.parameters[PULSE_DIV])),
            REACHED: lambda: int(self.axis.reached()),
            HOME_SWITCH: lambda: int(self.axis.at_home()),
            RIGHT_SWITCH: lambda: int(self.axis.at_end(1)),
            LEFT_SWITCH: lambda: int(self.axis.at_end(-1)),
            ACTUAL_ACCELERATION: lambda: self.parameters[MAX_ACCELERATION],
            206: lambda: 0 if self.axis.stalled() else 512,
            ERROR_FLAGS: lambda: int(self.axis.stalled()),
            208: lambda: int(self.axis.stalled()),
        }
        if request.type not in readings:
            raise RefusalError(WRONG_TYPE)
        return readings[request.type]()

    def _set_global(self, request: Request) -> int:
        if (request.type, request.bank) not in self.globals:
            raise RefusalError(WRONG_TYPE)
        self.globals[request.type, request.bank] = request.value
        return request.value

    def _get_global(self, request: Request) -> int:
        if (request.type, request.bank) not in self.globals:
            raise RefusalError(WRONG_TYPE)
        return self.globals[request.type, request.bank]

    def _search(self, request: Request) -> int:
        _require_motor(request)
        match request.type:
            case 0:
                self.axis.search(self._speed(SEARCH_SPEED), self._speed(SWITCH_SPEED), self._acceleration())
            case 1:
                self.axis.stop(self._acceleration())
            case 2:
                return int(self.axis.searching())
            case _:
                raise RefusalError(WRONG_TYPE)
        return 0

    def _set_output(self, request: Request) -> int:
        if request.bank != 2 or request.type not in self.outputs:
            raise RefusalError(WRONG_TYPE)
        if request.value not in (0, 1):
            raise RefusalError(INVALID_VALUE)
        self.outputs[request.type] = request.value
        return request.value

    def _get_input(self, request: Request) -> int:
        match request.bank, request.type:
            case 0, 0 | 1 | 2 | 3:
                return 0
            case 1, 8:
                return 240  # supply in tenths of a volt
            case 1, 9:
                return 31  # board temperature in degrees Celsius
            case 2, pin if pin in self.outputs:
                return self.outputs[pin]
        raise RefusalError(WRONG_TYPE)

    def _version(self, request: Request) -> int:
        if request.type != 1:
            raise RefusalError(WRONG_TYPE)
        return MODULE_NUMBER << 16 | VERSION[0] << 8 | VERSION[1]

    _commands: ClassVar[dict[int, Callable[["Module", Request], int]]] = {
        1: _rotate, 2: _rotate, 3: _stop, 4: _move, 5: _set_parameter,
        6: _get_parameter, 9: _set_global, 10: _get_global, 13: _search,
        14: _set_output, 15: _get_input, 136: _version,
    }  # fmt: skip


def _require_motor(request: Request) -> None:
    if request.bank != 0:
        raise RefusalError(INVALID_VALUE)


class Bus:
    """The serial bus: finds datagrams, hands them to the module addressed; the others stay silent."""

    def __init__(self, line: Line, modules: Mapping[int, Module]) -> None:
        self._line = line
        self._modules = modules
        self._pending = b""

    def receive(self, data: bytes, gap_s: float) -> None:
        """Take bytes that came that long after those before."""
        self._pending = data if gap_s > GAP_S else self._pending + data
        while len(self._pending) >= 9:
            datagram, self._pending = self._pending[:9], self._pending[9:]
            self._handle(datagram)

    def _handle(self, datagram: bytes) -> None:
        module = self._modules.get(datagram[0])
        fault = self._line.request(len(datagram), module.axis.name if module else None)
        if module is None or (fault and fault.kind == "lose"):
            return
        refused = fault is not None and fault.kind in ("nak", "busy")
        answer = module.reply(INVALID_VALUE, datagram[1], 0) if refused else module.answer(datagram)
        self._line.reply(answer, fault)
