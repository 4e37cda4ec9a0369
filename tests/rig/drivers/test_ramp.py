import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.drivers.ramp import Ramp
from rig.errors import ConfigError

SPEEDS = st.floats(100.0, 100_000.0)
ACCELERATIONS = st.floats(100.0, 1e5)


@given(SPEEDS, ACCELERATIONS)
@settings(max_examples=50, deadline=None)
def test_the_ramp_is_what_was_asked_for_to_half_a_unit(speed, acceleration):
    ramp = Ramp.choose("arm", speed, acceleration)
    assert 1 <= ramp.speed <= 2047
    assert 1 <= ramp.acceleration <= 2047
    assert ramp.speed_steps_s == pytest.approx(speed, rel=0.5 / ramp.speed)
    assert ramp.acceleration_steps_s2 == pytest.approx(acceleration, rel=0.5 / ramp.acceleration)


@given(SPEEDS, ACCELERATIONS, st.floats(0, 1e6), st.floats(0, 1e6))
@settings(max_examples=50, deadline=None)
def test_longer_ways_take_longer_and_direction_does_not_matter(speed, acceleration, way, more):
    ramp = Ramp.choose("arm", speed, acceleration)
    assert ramp.time_s(way) == ramp.time_s(-way)
    assert ramp.time_s(way + more) >= ramp.time_s(way)
    assert ramp.time_s(way) >= way / ramp.speed_steps_s


@pytest.mark.parametrize(("speed", "acceleration"), [(1e9, 1000.0), (1000.0, 1e9), (1e-6, 1000.0)])
def test_what_the_controller_cannot_do_is_refused(speed, acceleration):
    with pytest.raises(ConfigError, match=r"arm: .* beyond the motion controller.*\[axes.arm\]"):
        Ramp.choose("arm", speed, acceleration)


def test_the_axes_of_a_rig_keep_ten_bits():
    """At 3000 to 4800 steps/s both divisors are free, so that each value fills the upper half of 2047."""
    for scale in (100, 160):
        ramp = Ramp.choose("arm", 30.0 * scale, 60.0 * scale)
        assert ramp.speed >= 1023
        assert ramp.acceleration >= 1023
