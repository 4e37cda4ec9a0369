"""Ramps of the TMC429 motion controller: the units that a speed and an acceleration become, and the time of a move."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import sqrt
from typing import Self

from rig.errors import ConfigError
from rig.protocols import tmcl


@dataclass(frozen=True, slots=True)
class Ramp:
    """A trapezoid in the controller's own units; the finest divisors that can express it."""

    pulse_divisor: int
    ramp_divisor: int
    speed: int
    acceleration: int

    @classmethod
    def choose(cls, axis: str, speed_steps_s: float, acceleration_steps_s2: float) -> Self:
        """Nearest ramp to what rig.toml asks for. Raises ConfigError where the controller cannot do it."""
        for pulse in reversed(_fitting(speed_steps_s, tmcl.speed_unit)):
            ramps = _fitting(acceleration_steps_s2, partial(tmcl.acceleration_unit, pulse))
            if ramps:
                speed = round(speed_steps_s / tmcl.speed_unit(pulse))
                unit = tmcl.acceleration_unit(pulse, ramps[-1])
                return cls(pulse, ramps[-1], speed, round(acceleration_steps_s2 / unit))
        raise ConfigError(
            f"{axis}: {speed_steps_s:g} steps/s with {acceleration_steps_s2:g} steps/s^2 is beyond the motion "
            f"controller. Change speed_deg_s, acceleration_deg_s2 or steps_per_deg in rig.toml, [axes.{axis}]."
        )

    @property
    def speed_steps_s(self) -> float:
        """The speed that the controller really takes."""
        return self.speed * tmcl.speed_unit(self.pulse_divisor)

    @property
    def acceleration_steps_s2(self) -> float:
        """The acceleration that the controller really takes."""
        return self.acceleration * tmcl.acceleration_unit(self.pulse_divisor, self.ramp_divisor)

    def time_s(self, way_steps: float) -> float:
        """Time from rest to rest over that way, either direction."""
        way = abs(way_steps)
        speed, acceleration = self.speed_steps_s, self.acceleration_steps_s2
        if way < speed**2 / acceleration:
            return 2 * sqrt(way / acceleration)
        return way / speed + speed / acceleration


def _fitting(wanted: float, unit: Callable[[int], float]) -> list[int]:
    """The divisors with which the value stays within range and is not zero; the last one is the finest."""
    return [n for n in range(tmcl.DIVISOR_MAX + 1) if 1 <= round(wanted / unit(n)) <= tmcl.INTERNAL_MAX]
