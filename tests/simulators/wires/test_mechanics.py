import itertools
from math import inf, sqrt

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.clock import NS_PER_S
from simulators.mechanics import Stepper, move, rotate
from simulators.motor import DRIFT, RIPPLE, LaserMotor

targets = st.integers(-40_000, 40_000)
speeds = st.floats(10, 5000)
accelerations = st.floats(100, 20_000)


def sample(motion, n=200):
    step = (motion.end_ns - motion.start_ns) / n
    return [(motion.start_ns + round(i * step), *motion.at(motion.start_ns + round(i * step))) for i in range(n + 1)]


@settings(max_examples=50, deadline=None)
@given(targets, targets, speeds, accelerations)
def test_ramp_from_rest_arrives_without_overshoot(start, target, speed, acceleration):
    motion = move(7, (start, 0.0), target, speed, acceleration)
    low, high = min(start, target), max(start, target)
    for _, position, velocity in sample(motion):
        assert low - 1e-6 * (1 + high - low) <= position <= high + 1e-6 * (1 + high - low)
        assert abs(velocity) <= speed * (1 + 1e-9)
    assert motion.at(motion.end_ns) == (target, 0.0)


@settings(max_examples=50, deadline=None)
@given(targets, st.floats(-3000, 3000), targets, speeds, accelerations)
def test_ramp_in_motion_is_continuous_and_arrives(start, velocity, target, speed, acceleration):
    """Velocity changes by no more than the acceleration allows, also where the target lies behind."""
    motion = move(0, (start, velocity), target, speed, acceleration)
    points = sample(motion)
    rounding = 1e-6 * (1 + abs(velocity) + speed + abs(target - start))  # times are whole nanoseconds
    for (t0, p0, v0), (t1, p1, v1) in itertools.pairwise(points):
        seconds = (t1 - t0) / NS_PER_S
        assert abs(v1 - v0) <= acceleration * seconds + rounding
        assert abs(p1 - p0) <= max(abs(v0), abs(v1), speed) * seconds + rounding
    assert motion.at(motion.end_ns) == (target, 0.0)


def test_time_of_a_trapezoid():
    """3000 steps at 1000/s with 2000/s^2: 0.5 s up, 2.5 s along, 0.5 s down."""
    assert move(0, (0, 0.0), 3000, 1000, 2000).end_ns == pytest.approx(3.5 * NS_PER_S, abs=2)
    assert move(0, (0, 0.0), 100, 1000, 2000).end_ns == pytest.approx(2 * sqrt(100 / 2000) * NS_PER_S, abs=2)


def test_rotation_goes_on_and_stops():
    turning = rotate(0, (0.0, 0.0), -500, 1000)
    assert turning.end_ns is None
    assert turning.at(10 * NS_PER_S) == (pytest.approx(-500 * 9.75), -500)
    stopped = rotate(10 * NS_PER_S, turning.at(10 * NS_PER_S), 0.0, 1000)
    assert stopped.at(stopped.end_ns)[1] == 0.0
    assert stopped.end == round(-500 * 9.75 - 500**2 / 2000)


@pytest.mark.parametrize("direction", [-1, 1])
def test_end_switch_cuts_a_motion(direction):
    stepper = Stepper(slip=30.0, end_switches=(-1000.0, 1000.0))
    stepper.start(rotate(0, (0.0, 0.0), direction * 400, 800))
    assert stepper.mechanical(100 * NS_PER_S) == pytest.approx(direction * 1000, abs=1)
    assert not stepper.moving(100 * NS_PER_S)
    stepper.start(move(100 * NS_PER_S, stepper.exact(100 * NS_PER_S), 0, 400, 800))
    assert stepper.mechanical(200 * NS_PER_S) == 30.0, "the way back is free"


@pytest.mark.parametrize("direction", [-1, 1])
def test_end_switch_holds_an_axis_that_stands_on_it(direction):
    """Told to go on, by a rotation or by a move, it stays."""
    stepper = Stepper(slip=30.0, end_switches=(-1000.0, 1000.0))
    stepper.start(rotate(0, (0.0, 0.0), direction * 400, 800))
    time_ns = 100 * NS_PER_S
    for onward in (
        rotate(time_ns, stepper.exact(time_ns), direction * 400, 800),
        move(time_ns, stepper.exact(time_ns), direction * 5000, 400, 800),
    ):
        stepper.start(onward)
        assert stepper.mechanical(2 * time_ns) == pytest.approx(direction * 1000, abs=1)
        assert not stepper.moving(2 * time_ns)


def test_redefinition_moves_nothing():
    stepper = Stepper(slip=12.0, end_switches=(-inf, inf))
    stepper.start(move(0, (0, 0.0), 500, 400, 800))
    before = stepper.mechanical(10 * NS_PER_S)
    stepper.redefine(10 * NS_PER_S, -7)
    assert stepper.counter(10 * NS_PER_S) == -7
    assert stepper.mechanical(10 * NS_PER_S) == before


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 7), st.integers(0, 1000), st.sampled_from([-1, 1]))
def test_laser_motor_is_uneven_but_never_turns_around(power, run, direction):
    motor = LaserMotor(39.2, (-1e6, 1e6))
    motor.turn(0, direction, power, (run,))
    ticks = [motor.ticks(i * NS_PER_S // 10) for i in range(150)]
    steps = [direction * (b - a) for a, b in itertools.pairwise(ticks)]
    assert min(steps) > 0
    steady = steps[10:]
    nominal = 0.1 * 39.2 * (0.65 + 0.05 * power)
    assert max(steady) <= nominal * (1 + RIPPLE) * (1 + DRIFT) * 1.011
    assert max(steady) / min(steady) > 1.02, "a LEGO motor is no stepper"


def test_laser_motor_stands_where_it_was_stopped_and_at_its_stops():
    motor = LaserMotor(40.0, (-10.0, 500.0))
    motor.turn(0, 1, 7, (1,))
    stands = motor.ticks(3 * NS_PER_S)
    motor.turn(3 * NS_PER_S, 0, 7, (1,))
    assert motor.ticks(60 * NS_PER_S) == stands > 100
    motor.turn(60 * NS_PER_S, -1, 7, (2,))
    assert motor.ticks(90 * NS_PER_S) == -10.0
    motor.turn(90 * NS_PER_S, 0, 7, (2,))
    assert motor.ticks(91 * NS_PER_S) == -10.0


@pytest.mark.parametrize("direction", [1, -1])
def test_a_laser_motor_that_jams_stands_half_way_until_it_is_turned_again(direction):
    motor = LaserMotor(40.0, (-20.0, 500.0))
    start_ns = 0
    if direction < 0:
        motor.turn(0, 1, 7, ("there",))
        start_ns = 60 * NS_PER_S
    here = motor.ticks(start_ns)
    motor.turn(start_ns, direction, 7, ("run",), jams=True)
    half = (here + motor.stops[direction > 0]) / 2
    assert motor.ticks(start_ns + 60 * NS_PER_S) == half
    motor.turn(start_ns + 60 * NS_PER_S, 0, 7, ())
    motor.turn(start_ns + 61 * NS_PER_S, direction, 7, ("again",))
    assert motor.ticks(start_ns + 121 * NS_PER_S) == motor.stops[direction > 0]
