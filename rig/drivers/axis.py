"""Stepper axes on a TMCL bus: radians above, microsteps below."""

from dataclasses import dataclass
from math import degrees, radians

from rig.config import AxisConfig
from rig.drivers.bus import TmclBus
from rig.drivers.clock import RigClock
from rig.drivers.ramp import Ramp
from rig.errors import DeviceError, FrameError, InterlockError, LimitError, ReadTimeoutError, StateError
from rig.protocols import tmcl
from rig.protocols.tmcl import Parameter, Request, Search

_POLL_S = 0.02
_SEARCH_POLL_S = 0.1
_SEARCH_SILENCES = 3  # a module may miss replies while it searches its switch
_SEARCH_SHARE, _SWITCH_SHARE = 2, 20  # the search runs at half speed, onto the switch at a twentieth
_MARGIN_S = 2.0  # of waiting, beyond what the ramps take
_DUST_DEG = 1e-6  # sums of angles in binary fractions; far below any axis' step


@dataclass(slots=True)
class _Move:
    """A move under way."""

    target_steps: int
    due_s: float
    deadline_s: float


class StepperAxis:
    """One axis. After construction `open` finds its module; before the first move the axis has to be homed."""

    def __init__(self, name: str, config: AxisConfig, bus: TmclBus, clock: RigClock) -> None:
        """Raises ConfigError where the motion controller cannot move as rig.toml asks."""
        self._name = name
        self._config = config
        self._bus = bus
        self._clock = clock
        scale = config.steps_per_deg
        self._ramp = Ramp.choose(name, config.speed_deg_s * scale, config.acceleration_deg_s2 * scale)
        self._homed_at_opening: int | None = None
        self._searching = True  # another process may have left a search running
        self._move: _Move | None = None
        self._rest_steps: int | None = None  # where it stands, as far as no question is needed

    @property
    def name(self) -> str:
        """Key in rig.toml, [axes.NAME]."""
        return self._name

    def open(self) -> None:
        """Find the module, stop it, and set its speeds. Raises what the bus raises."""
        self._ask(tmcl.firmware_version(self._config.module), "version")
        self.stop()
        for parameter, value in (
            (Parameter.PULSE_DIVISOR, self._ramp.pulse_divisor),
            (Parameter.RAMP_DIVISOR, self._ramp.ramp_divisor),
            (Parameter.MAXIMUM_SPEED, self._ramp.speed),
            (Parameter.MAXIMUM_ACCELERATION, self._ramp.acceleration),
            (Parameter.SEARCH_SPEED, max(1, self._ramp.speed // _SEARCH_SHARE)),
            (Parameter.SWITCH_SPEED, max(1, self._ramp.speed // _SWITCH_SHARE)),
        ):
            request = tmcl.set_parameter(self._config.module, self._config.motor, parameter, value)
            self._ask(request, f"{parameter.name.lower()} = {value}")

    def home(self) -> None:
        """Search the reference switch and wait for it; the switch becomes 0.

        Raises DeviceError where the search does not end in the time that the whole range takes.
        """
        self._homed_at_opening = self._move = self._rest_steps = None
        self._searching = True
        self._ask(self._search(Search.START), "reference search")
        self._await_search()
        self._searching = False
        self._homed_at_opening = self._bus.openings

    def check(self, angle_rad: float) -> None:
        """Raises LimitError or InterlockError where `move_to` would; moves nothing.

        The way to the angle is checked too, once the axis is homed: zones that must not be passed are never crossed.
        """
        angle_deg = degrees(angle_rad)
        config = self._config
        if not config.min_deg - _DUST_DEG <= angle_deg <= config.max_deg + _DUST_DEG:
            raise LimitError(
                f"{self._name}: {angle_deg:.6g} deg is outside {config.min_deg:g} to {config.max_deg:g} deg; nothing "
                f"was moved. Limits are set in rig.toml, [axes.{self._name}]."
            )
        self._check_zones(angle_deg, angle_deg, (*config.forbidden_deg, *config.collision_deg))
        if config.collision_deg and self._is_homed():
            self._check_zones(degrees(self.angle_rad()), angle_deg, config.collision_deg)

    def move_to(self, angle_rad: float) -> None:
        """Start the move and return; `wait` ends it.

        Raises LimitError or InterlockError before anything moves, StateError if not homed.
        """
        if not self._is_homed():
            raise StateError(
                f"{self._name}: not homed since it was switched on, stalled, or its wire was lost; nothing was moved. "
                "Home it first."
            )
        self.check(angle_rad)
        target_steps = self._steps(angle_rad)
        from_steps = self._position_steps() if self._rest_steps is None else self._rest_steps
        ramp_s = self._ramp.time_s(target_steps - from_steps)
        self._rest_steps = None
        request = tmcl.move_absolute(self._config.module, self._config.motor, target_steps)
        self._ask(request, f"move to {degrees(angle_rad):.6g} deg")
        due_s = self._clock.now_s() + ramp_s
        self._move = _Move(target_steps, due_s, due_s + 0.5 * ramp_s + _MARGIN_S)

    def wait(self) -> None:
        """Return once the axis stands at its target and has settled. Raises DeviceError on a stall."""
        move = self._move
        if move is None:
            return
        self._sleep_until(move.due_s)
        arrived_s = move.due_s
        while not self._read(Parameter.POSITION_REACHED):
            if self._clock.now_s() > move.deadline_s:
                raise self._stalled(move)
            self._clock.sleep(_POLL_S)
            arrived_s = self._clock.now_s()
        self._move, self._rest_steps = None, move.target_steps
        self._sleep_until(arrived_s + self._config.settle_s)

    def angle_rad(self) -> float:
        """The angle that the axis reports."""
        return radians(self._position_steps() / self._config.steps_per_deg)

    def stop(self) -> None:
        """Stop at once; returns when the speed reads 0. Raises DeviceError where it does not within the ramp's time."""
        self._move = self._rest_steps = None
        if self._searching:
            self._ask(self._search(Search.STOP), "stop of the reference search")
            self._searching = False
        self._ask(tmcl.motor_stop(self._config.module, self._config.motor), "stop")
        deadline_s = self._clock.now_s() + self._ramp.speed_steps_s / self._ramp.acceleration_steps_s2 + _MARGIN_S
        while speed := self._read(Parameter.ACTUAL_SPEED):
            if self._clock.now_s() > deadline_s:
                raise DeviceError(
                    f"{self._name}: still turns (speed {speed}) after the stop command. Switch off the motor's supply."
                )
            self._clock.sleep(_POLL_S)

    def move_time_s(self, from_rad: float, to_rad: float) -> float:
        """Time of the move by its ramps, settling included."""
        return self._ramp.time_s(self._steps(to_rad) - self._steps(from_rad)) + self._config.settle_s

    def _await_search(self) -> None:
        config = self._config
        range_s = (config.max_deg - config.min_deg) / config.speed_deg_s
        deadline_s = self._clock.now_s() + 2 * _SEARCH_SHARE * range_s + _SWITCH_SHARE * _MARGIN_S
        silences = 0
        while True:
            self._clock.sleep(_SEARCH_POLL_S)
            try:
                if not self._ask(self._search(Search.STATUS), "state of the reference search", attempts=1):
                    return
                silences = 0
            except (ReadTimeoutError, FrameError):
                silences += 1
                if silences > _SEARCH_SILENCES:
                    raise
            if self._clock.now_s() > deadline_s:
                self.stop()
                raise DeviceError(f"{self._name}: the reference switch was not found. Check the switch and its cable.")

    def _stalled(self, move: _Move) -> DeviceError:
        """Stop, and the error of a move that does not end; the position cannot be trusted any longer."""
        self._homed_at_opening = None
        self.stop()
        at_steps = self._position_steps()
        scale = self._config.steps_per_deg
        return DeviceError(
            f"{self._name}: stalled at {at_steps / scale:.6g} deg on the way to {move.target_steps / scale:.6g} deg; "
            "it was stopped. Free it, then home it again."
        )

    def _check_zones(self, from_deg: float, to_deg: float, zones: tuple[tuple[float, float], ...]) -> None:
        low, high = min(from_deg, to_deg), max(from_deg, to_deg)
        for start, end in zones:
            if high >= start - _DUST_DEG and low <= end + _DUST_DEG:
                way = f"{to_deg:.6g} deg is" if from_deg == to_deg else f"from {from_deg:.6g} to {to_deg:.6g} deg leads"
                raise InterlockError(
                    f"{self._name}: {way} into the zone {start:g} to {end:g} deg, where it would block the view or "
                    f"touch another part; nothing was moved. Zones are set in rig.toml, [axes.{self._name}]."
                )

    def _is_homed(self) -> bool:
        return self._homed_at_opening is not None and self._homed_at_opening == self._bus.openings

    def _steps(self, angle_rad: float) -> int:
        return round(degrees(angle_rad) * self._config.steps_per_deg)

    def _position_steps(self) -> int:
        return self._read(Parameter.ACTUAL_POSITION)

    def _search(self, search: Search) -> Request:
        return tmcl.reference_search(self._config.module, self._config.motor, search)

    def _read(self, parameter: Parameter) -> int:
        request = tmcl.get_parameter(self._config.module, self._config.motor, parameter)
        return self._ask(request, parameter.name.lower().replace("_", " "))

    def _ask(self, request: Request, what: str, attempts: int = 3) -> int:
        return self._bus.ask(self._name, request, what, attempts=attempts)

    def _sleep_until(self, moment_s: float) -> None:
        self._clock.sleep(max(0.0, moment_s - self._clock.now_s()))
