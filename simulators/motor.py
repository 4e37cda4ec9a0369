"""The LEGO motor that turns the laser's fan plane: uneven speed, and the rotation sensor on its axle."""

import math
from dataclasses import dataclass

from simulators.chance import Key, uniform
from simulators.clock import NS_PER_S

SPIN_UP_S = 0.12  # time constant from rest to speed
RIPPLE, RIPPLE_HZ = 0.03, 1.7  # gear eccentricity
DRIFT, DRIFT_HZ = 0.03, 0.045  # friction and battery over a sweep
SPREAD = 0.01  # of the mean speed from run to run


@dataclass(frozen=True, slots=True)
class Run:
    """The motor on since `start_ns`, at a mean speed in sensor counts per second."""

    start_ns: int
    start_ticks: float
    ticks_per_s: float
    ripple_phase_rad: float
    drift_phase_rad: float

    def ticks(self, time_ns: int) -> float:
        """Integral of the uneven speed; monotonic, since spin-up, ripple and drift never turn the speed around."""
        elapsed_s = max(0, time_ns - self.start_ns) / NS_PER_S
        # The spin-up is taken as a delay that grows to SPIN_UP_S.
        turned_s = elapsed_s - SPIN_UP_S * -math.expm1(-elapsed_s / SPIN_UP_S)
        for share, hertz, phase_rad in (
            (RIPPLE, RIPPLE_HZ, self.ripple_phase_rad),
            (DRIFT, DRIFT_HZ, self.drift_phase_rad),
        ):
            omega = 2 * math.pi * hertz
            turned_s += share * (math.cos(phase_rad) - math.cos(omega * turned_s + phase_rad)) / omega
        return self.start_ticks + self.ticks_per_s * turned_s


@dataclass(slots=True)
class LaserMotor:
    """Motor, gear train with a stop at either end, and rotation sensor."""

    ticks_per_s: float  # at full power
    stops: tuple[float, float]  # sensor counts from the start of the sweep
    run: Run | None = None
    _rest: float = 0.0
    _jam: float | None = None

    def ticks(self, time_ns: int) -> float:
        """Position in sensor counts (16 per turn of the axle) from the start of the sweep."""
        turned = self._rest if self.run is None else self.run.ticks(time_ns)
        if self._jam is not None:
            turned = min(turned, self._jam) if self._jam >= self._rest else max(turned, self._jam)
        return min(max(turned, self.stops[0]), self.stops[1])

    def turn(self, time_ns: int, direction: int, power: int, key: Key, *, jams: bool = False) -> None:
        """Turn at a power of 0 to 7 (direction 1 forward, -1 reverse, 0 stop). The key fixes the unevenness.

        Gears that jam stand still half way to the end.
        """
        self._rest = self.ticks(time_ns)
        self._jam = (self._rest + self.stops[direction > 0]) / 2 if jams else None
        if direction == 0:
            self.run = None
            return
        spread = 1 + SPREAD * (2 * uniform(*key, "speed") - 1)
        speed = direction * self.ticks_per_s * (0.65 + 0.05 * power) * spread
        phases = [2 * math.pi * uniform(*key, name) for name in ("ripple", "drift")]
        self.run = Run(time_ns, self._rest, speed, phases[0], phases[1])
