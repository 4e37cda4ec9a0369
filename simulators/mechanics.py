"""Motion of a stepper axis: trapezoid ramps as functions of time, the step counter, switches, lost steps.

Positions are in microsteps: `counter` is what the module believes, `mechanical` where the axis really stands.
"""

import math
from dataclasses import dataclass, field, replace

from simulators.clock import NS_PER_S


@dataclass(frozen=True, slots=True)
class Leg:
    """A piece of motion under constant acceleration; an infinite duration means for ever."""

    duration_s: float
    position: float
    velocity: float
    acceleration: float

    def at(self, elapsed_s: float) -> tuple[float, float]:
        """Position and velocity that long after the leg's start."""
        position = self.position + (self.velocity + self.acceleration * elapsed_s / 2) * elapsed_s
        return position, self.velocity + self.acceleration * elapsed_s


@dataclass(frozen=True, slots=True)
class Motion:
    """Legs one after the other; afterwards rest at `end`, which is exact."""

    start_ns: int
    legs: tuple[Leg, ...]
    end: float

    def at(self, time_ns: int) -> tuple[float, float]:
        """Position and velocity at that time."""
        if self.end_ns is not None and time_ns >= self.end_ns:
            return self.end, 0.0
        elapsed_s = (time_ns - self.start_ns) / NS_PER_S
        for leg in self.legs:
            if elapsed_s < leg.duration_s:
                return leg.at(elapsed_s)
            elapsed_s -= leg.duration_s
        return self.end, 0.0

    @property
    def end_ns(self) -> int | None:
        """When the motion ends; None for never."""
        total_s = sum(leg.duration_s for leg in self.legs)
        return None if math.isinf(total_s) else self.start_ns + math.ceil(total_s * NS_PER_S)

    def then(self, end: float, velocity_max: float, acceleration: float) -> "Motion":
        """The motion followed by another one, from rest to `end`."""
        return Motion(self.start_ns, self.legs + _trapezoid(self.end, 0.0, end, velocity_max, acceleration), end)

    def crosses(self, position: float, direction: int) -> int | None:
        """The first time at which the motion is at a position, or beyond, and goes on upward (1) or downward (-1).

        None for never.
        """
        elapsed_s = 0.0
        for leg in self.legs:
            inside_s = _time_at(leg, position, direction)
            if inside_s is not None:
                return self.start_ns + round((elapsed_s + inside_s) * NS_PER_S)
            elapsed_s += leg.duration_s
        return None


def _time_at(leg: Leg, position: float, direction: int) -> float | None:
    """First time within the leg at which it passes the position in that direction, or leads on from beyond it."""
    outward = (leg.velocity or leg.acceleration) * direction > 0
    if leg.duration_s > 0 and outward and (leg.position - position) * direction >= 0:
        return 0.0
    a, b, c = leg.acceleration / 2, leg.velocity, leg.position - position
    if a == 0:
        roots = [-c / b] if b else []
    else:
        square = b * b - 4 * a * c
        roots = [(-b + sign * math.sqrt(square)) / (2 * a) for sign in (-1, 1)] if square >= 0 else []
    passed = (root for root in roots if 0 <= root < leg.duration_s and leg.at(root)[1] * direction > 0)
    return min(passed, default=None)


def _trapezoid(
    start: float, velocity: float, target: float, velocity_max: float, acceleration: float
) -> tuple[Leg, ...]:
    """Legs from a start at a velocity to rest at the target; overshoots and comes back where it cannot stop in time."""
    braking = velocity * abs(velocity) / (2 * acceleration)  # signed way needed to stop
    direction = math.copysign(1.0, target - start - braking)
    speed, way = velocity * direction, (target - start) * direction
    if speed < 0:
        stop = Leg(-speed / acceleration, start, velocity, direction * acceleration)
        turned = start + braking
        return (stop, *_trapezoid(turned, 0.0, target, velocity_max, acceleration))
    peak = min(max(velocity_max, speed), math.sqrt(max(acceleration * way + speed * speed / 2, speed * speed)))
    rise_s, fall_s = (peak - speed) / acceleration, peak / acceleration
    cruise_s = (
        max(0.0, (way - (peak**2 - speed**2) / (2 * acceleration) - peak**2 / (2 * acceleration)) / peak)
        if peak
        else 0.0
    )
    legs = []
    position = start
    for duration_s, first, change in (
        (rise_s, speed, acceleration),
        (cruise_s, peak, 0.0),
        (fall_s, peak, -acceleration),
    ):
        legs.append(Leg(duration_s, position, direction * first, direction * change))
        position = legs[-1].at(duration_s)[0]
    return tuple(legs)


def move(start_ns: int, at: tuple[float, float], target: float, velocity_max: float, acceleration: float) -> Motion:
    """Ramp from a position and velocity to rest at the target."""
    return Motion(start_ns, _trapezoid(*at, target, velocity_max, acceleration), target)


def rotate(start_ns: int, at: tuple[float, float], velocity: float, acceleration: float) -> Motion:
    """Ramp to a velocity and keep it; velocity 0 is a stop."""
    position, now = at
    ramp = Leg(abs(velocity - now) / acceleration, position, now, math.copysign(acceleration, velocity - now))
    reached = ramp.at(ramp.duration_s)[0]
    if velocity == 0:
        return Motion(start_ns, (ramp,), round(reached))
    return Motion(start_ns, (ramp, Leg(math.inf, reached, velocity, 0.0)), math.inf)


def standing(position: float) -> Motion:
    """No motion."""
    return Motion(0, (), position)


@dataclass(slots=True)
class Stepper:
    """One axis: what its module counts and where it stands.

    `slip` = mechanical - counter: unknown at power-up, cleared by a reference search, changed by lost steps.
    `end_switches` are mechanical positions; the axis stops there whatever it was told.
    """

    slip: float
    end_switches: tuple[float, float]
    motion: Motion = field(default_factory=lambda: standing(0.0))
    target: float = 0.0

    def exact(self, time_ns: int) -> tuple[float, float]:
        """Counter, with the fraction of a step on the way to the next, and velocity in steps per second."""
        return self.motion.at(time_ns)

    def counter(self, time_ns: int) -> int:
        """What the module reports."""
        return round(self.exact(time_ns)[0])

    def mechanical(self, time_ns: int) -> float:
        """Where the axis stands, in steps from its home switch."""
        return self.exact(time_ns)[0] + self.slip

    def moving(self, time_ns: int) -> bool:
        """Whether the ramp generator runs."""
        return self.motion.end_ns is None or time_ns < self.motion.end_ns

    def start(self, motion: Motion) -> None:
        """Take up a motion, cut off at the end switch that it would run into."""
        self.motion = motion
        for switch, direction in zip(self.end_switches, (-1, 1), strict=True):
            hit_ns = self.motion.crosses(switch - self.slip, direction)
            if hit_ns is not None:
                self.cut(hit_ns)

    def cut(self, time_ns: int) -> None:
        """Let the present motion end abruptly at that time."""
        position = round(self.motion.at(time_ns)[0])
        elapsed_s = (time_ns - self.motion.start_ns) / NS_PER_S
        legs = []
        for leg in self.motion.legs:
            legs.append(replace(leg, duration_s=min(leg.duration_s, elapsed_s)))
            elapsed_s -= legs[-1].duration_s
        self.motion = Motion(self.motion.start_ns, tuple(legs), position)

    def redefine(self, time_ns: int, counter: int) -> None:
        """Let the present place be called that; nothing moves."""
        self.slip = round(self.mechanical(time_ns)) - counter
        self.motion = standing(float(counter))
