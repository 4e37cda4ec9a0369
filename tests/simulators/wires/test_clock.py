import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.clock import NS_PER_S, Clock


class Wall:
    def __init__(self):
        self.ns = 17

    def __call__(self):
        return self.ns


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(0, 100), max_size=20), st.lists(st.floats(0, 30), min_size=1, max_size=10))
def test_events_happen_in_time_order_however_time_advances(times, jumps):
    clock, happened = Clock(), []
    for seconds in times:
        clock.after(seconds, lambda seconds=seconds: happened.append((round(seconds * NS_PER_S), clock.now_ns())))
    for jump in jumps:
        clock.advance(jump)
    assert happened == sorted(happened, key=lambda entry: entry[0])
    assert all(due == seen for due, seen in happened), "within an event it is the event's time"
    now_ns = clock.now_ns()
    assert len(happened) == sum(round(seconds * NS_PER_S) <= now_ns for seconds in times)


def test_time_stands_still_at_rate_0():
    wall = Wall()
    clock = Clock(0.0, wall)
    wall.ns += 10**12
    assert clock.now_ns() == 0
    assert clock.due_in_s() is None


def test_time_follows_the_wall_at_a_rate_and_jumps_besides():
    wall = Wall()
    clock = Clock(4.0, wall)
    happened = []
    clock.after(10.0, lambda: happened.append(clock.now_s()))
    assert clock.due_in_s() == pytest.approx(2.5)
    wall.ns += NS_PER_S
    assert clock.now_s() == pytest.approx(4.0)
    clock.advance(5.0)
    assert not happened
    wall.ns += NS_PER_S // 4
    clock.run_due()
    assert happened == [10.0]


def test_what_an_event_asks_for_happens_in_the_same_advance():
    clock, happened = Clock(), []

    def chain():
        happened.append(clock.now_s())
        if len(happened) < 4:
            clock.after(0.5, chain)

    clock.after(1.0, chain)
    clock.advance(10.0)
    assert happened == [1.0, 1.5, 2.0, 2.5]
    assert clock.now_s() == 10.0


def test_advance_within_an_event_moves_the_end_not_the_moment():
    clock, seen = Clock(), []

    def charge():
        clock.advance(0.25)
        seen.append(clock.now_s())

    clock.after(1.0, charge)
    clock.advance(2.0)
    assert seen == [1.0]
    assert clock.now_s() == 2.25


def test_cancelled_events_do_not_happen():
    clock, happened = Clock(), []
    clock.after(1.0, lambda: happened.append(1)).cancel()
    clock.advance(2.0)
    assert not happened


def test_time_does_not_go_back():
    with pytest.raises(ValueError, match="back"):
        Clock().advance(-0.1)
