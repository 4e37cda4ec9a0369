"""An axis of the rig: a stepper with its switches and faults, as its module drives it and as light sees it."""

from math import copysign, radians

from simulators.chance import uniform
from simulators.clock import Clock, Event
from simulators.faults import FaultSchedule, Occasion
from simulators.layout import AxisLayout
from simulators.mechanics import Stepper, move, rotate

HOME_WIDTH_STEPS = 8
OVERRUN_DEG = 3.0  # end switches beyond the range of use
SEARCH_OVERSHOOT_STEPS = 40
UNKNOWN_DEG = 5.0  # at power-up the axis stands up to this far from where its counter says
REPEATABILITY_DEG = 0.008  # largest difference between the angle that steps mean and the one taken up


class Stage:
    """One axis; counts in microsteps, angles in radians."""

    def __init__(self, name: str, layout: AxisLayout, clock: Clock, faults: FaultSchedule, seed: int) -> None:
        self.name = name
        self.speed_steps_s = layout.speed_deg_s * layout.steps_per_deg
        self.acceleration_steps_s2 = layout.acceleration_deg_s2 * layout.steps_per_deg
        self._steps_per_deg = layout.steps_per_deg
        self._clock = clock
        self._faults = faults
        self._seed = seed
        ends = ((layout.min_deg - OVERRUN_DEG), (layout.max_deg + OVERRUN_DEG))
        slip = round(UNKNOWN_DEG * (2 * uniform(seed, name, "power-up") - 1) * layout.steps_per_deg)
        self._stepper = Stepper(float(slip), (ends[0] * layout.steps_per_deg, ends[1] * layout.steps_per_deg))
        self._search: Event | None = None
        self._loss: Event | None = None
        self._target_velocity = 0.0
        self._stalled = False

    # What the module reads.

    def counter(self) -> int:
        """Actual position."""
        return self._stepper.counter(self._now())

    def target(self) -> int:
        """Target position of the last move."""
        return round(self._stepper.target)

    def velocity(self) -> float:
        """Actual speed in steps per second."""
        return self._stepper.exact(self._now())[1]

    def target_velocity(self) -> float:
        """Speed asked for by the last rotation; 0 in positioning."""
        return self._target_velocity

    def moving(self) -> bool:
        """Whether the axis is under way."""
        return self._stepper.moving(self._now())

    def reached(self) -> bool:
        """Whether the axis stands at its target."""
        return not self.moving() and self.counter() == self.target()

    def searching(self) -> bool:
        """Whether a reference search is under way."""
        return self._search is not None

    def stalled(self) -> bool:
        """Whether the last move ended in a stall."""
        return self._stalled and not self.moving()

    def at_home(self) -> bool:
        """State of the home switch."""
        return abs(self._stepper.mechanical(self._now())) <= HOME_WIDTH_STEPS

    def at_end(self, direction: int) -> bool:
        """State of the end switch on the left (-1) or right (1)."""
        left, right = self._stepper.end_switches
        stands = self._stepper.mechanical(self._now())
        return stands >= right - 1 if direction > 0 else stands <= left + 1

    # What the module does.

    def move(self, target: int, velocity: float, acceleration: float) -> None:
        """Ramp to a counter position."""
        self._abandon()
        self._stepper.target = target
        self._stepper.start(move(self._now(), self._exact(), target, velocity, acceleration))
        self._strike()

    def rotate(self, velocity: float, acceleration: float) -> None:
        """Turn at a speed until told otherwise or stopped by an end switch."""
        self._abandon()
        self._target_velocity = velocity
        self._stepper.start(rotate(self._now(), self._exact(), velocity, acceleration))

    def stop(self, acceleration: float) -> None:
        """Ramp down to rest."""
        self._abandon()
        self._stepper.start(rotate(self._now(), self._exact(), 0.0, acceleration))

    def redefine(self, counter: int) -> None:
        """Call the present place by another number."""
        self._abandon()
        self._stepper.redefine(self._now(), counter)

    def search(self, fast: float, slow: float, acceleration: float) -> None:
        """Find the home switch: past it fast, back to its middle slowly; there the counter becomes 0."""
        self._abandon()
        home = -self._stepper.slip
        beyond = home + copysign(SEARCH_OVERSHOOT_STEPS, home - self._exact()[0])
        motion = move(self._now(), self._exact(), beyond, fast, acceleration).then(home, slow, acceleration)
        self._stepper.start(motion)
        self._search = self._clock.at(self._stepper.motion.end_ns or self._now(), self._found)

    # What light sees.

    def steps(self) -> int:
        """Sixteenths of a microstep from the home switch; the same number means the same place."""
        return round(16 * self._stepper.mechanical(self._now()))

    def angle_rad(self) -> float:
        """The angle at which the axis really stands, repeatability error included."""
        error_deg = REPEATABILITY_DEG * (2 * uniform(self._seed, self.name, self.steps()) - 1)
        angle_deg = self._stepper.mechanical(self._now()) / self._steps_per_deg
        return radians(angle_deg if self.moving() else angle_deg + error_deg)

    def _found(self) -> None:
        self._search = None
        self._stepper.redefine(self._now(), 0)
        self._stepper.target = 0.0

    def _abandon(self) -> None:
        if self._search is not None:
            self._search.cancel()
        if self._loss is not None:
            self._loss.cancel()
        self._search = self._loss = None
        self._stalled = False
        self._target_velocity = 0.0

    def _strike(self) -> None:
        fault = self._faults.strike((self.name,), Occasion.MOVE, self._clock.now_s())
        end_ns = self._stepper.motion.end_ns
        if fault is None or end_ns is None:
            return
        half_ns = (self._now() + end_ns) // 2
        if fault.kind == "stall":
            self._stepper.cut(half_ns)
            self._stalled = True
        else:
            self._loss = self._clock.at(half_ns, lambda: self._slip(fault.steps))

    def _slip(self, steps: int) -> None:
        self._stepper.slip += steps

    def _exact(self) -> tuple[float, float]:
        return self._stepper.exact(self._now())

    def _now(self) -> int:
        return self._clock.now_ns()
