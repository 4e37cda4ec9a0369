"""The axis driver against a scripted TMCL bus: nine bytes each way, checksum behind them (vectors/tmcl.toml)."""

import struct
from math import radians

import pytest

from rig.config import AxisConfig, Bus
from rig.drivers.axis import StepperAxis
from rig.drivers.bus import TmclBus
from rig.errors import (
    DeviceError,
    FrameError,
    InterlockError,
    LimitError,
    ReadTimeoutError,
    ReplyError,
    StateError,
    TransportError,
)
from rig.protocols import tmcl
from rig.protocols.tmcl import Parameter
from tests.rig.drivers.peers import cut_fixed

ROTATE, STOP, MOVE, SET, GET, SEARCH, VERSION = 1, 3, 4, 5, 6, 13, 136
POSITION, SPEED, MAX_SPEED, REACHED = 1, 3, 4, 8


def sealed(*fields):
    body = struct.pack(">BBBBi", *fields)
    return body + bytes([sum(body) & 0xFF])


class Modules:
    """Modules 1 and 2. They reach every target at once; `faults` holds what becomes of the replies to come.

    `silent` holds the (command, type) pairs that are obeyed and never answered.
    """

    def __init__(self):
        self.parameters = {(module, parameter): 0 for module in (1, 2) for parameter in (POSITION, SPEED)}
        self.parameters |= {(module, REACHED): 1 for module in (1, 2)}
        self.searching = []
        self.faults = []
        self.silent = set()
        self.late = b""
        self.commands = []

    def answer(self, request):
        module, command, kind, _, value = struct.unpack(">BBBBi", request[:8])
        self.commands.append((module, command, kind, value))
        reply = sealed(2, module, 100, command, self.value_of(module, command, kind, value))
        fault = self.faults.pop(0) if self.faults else lambda reply: reply
        return b"" if (command, kind) in self.silent else fault(reply)

    def value_of(self, module, command, kind, value):
        if command == MOVE:
            self.parameters[module, POSITION] = value
        if command == SET:
            self.parameters[module, kind] = value
        if command == GET:
            return self.parameters.get((module, kind), 0)
        if command == SEARCH and kind == 2:
            return self.searching.pop(0) if self.searching else 0
        return value

    def hold(self, reply):
        """The reply comes late: in front of the next one."""
        self.late, self.faults = reply, [self.release, *self.faults]
        return b""

    def release(self, reply):
        return self.late + reply


def config(**changes):
    return AxisConfig(
        module=1,
        steps_per_deg=100.0,
        min_deg=-90.0,
        max_deg=90.0,
        speed_deg_s=30.0,
        acceleration_deg_s2=60.0,
        **changes,
    )


@pytest.fixture
def modules():
    return Modules()


@pytest.fixture
def wire(pty_peer, modules):
    return pty_peer(cut_fixed(9), modules.answer)


@pytest.fixture
def bus(wire, clock):
    bus = TmclBus(Bus(port=wire.port), clock)
    bus.open()
    yield bus
    bus.close()


@pytest.fixture
def axis(bus, clock, modules):
    axis = StepperAxis("arm", config(), bus, clock)
    axis.open()
    axis.home()
    modules.commands.clear()
    return axis


def moves(modules):
    return [entry for entry in modules.commands if entry[1] in (ROTATE, MOVE)]


def get(parameter):
    return tmcl.get_parameter(1, 0, parameter)


def test_one_late_reply_does_not_shift_all_the_following(bus, modules):
    """The value asked for comes back for ever after, not that of the request before."""
    modules.parameters |= {(1, POSITION): 1111, (1, MAX_SPEED): 2222, (1, SPEED): 3333}
    modules.faults = [modules.hold]
    for _ in range(3):
        assert bus.ask("arm", get(Parameter.ACTUAL_POSITION), "position") == 1111
        assert bus.ask("arm", get(Parameter.MAXIMUM_SPEED), "speed") == 2222
        assert bus.ask("arm", get(Parameter.ACTUAL_SPEED), "actual speed") == 3333


def test_a_late_reply_is_not_taken_for_the_next_parameter_even_without_a_repetition(bus, modules):
    modules.parameters |= {(1, POSITION): 1111, (1, MAX_SPEED): 2222}
    modules.faults = [modules.hold]
    with pytest.raises(ReadTimeoutError):
        bus.ask("arm", get(Parameter.ACTUAL_POSITION), "position", attempts=1)
    assert bus.ask("arm", get(Parameter.MAXIMUM_SPEED), "speed", attempts=1) == 2222


def test_an_interrupted_request_does_not_shift_the_following(bus, modules, monkeypatch):
    """Ctrl-C while waiting: the reply comes all the same, and is dropped."""
    modules.parameters |= {(1, POSITION): 1111, (1, SPEED): 3333}

    def interrupt(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(bus._link, "receive", interrupt)
        with pytest.raises(KeyboardInterrupt):
            bus.ask("arm", get(Parameter.ACTUAL_POSITION), "position")
    assert bus.ask("arm", get(Parameter.ACTUAL_SPEED), "speed") == 3333


def test_a_reply_that_comes_twice_answers_once(bus, modules):
    modules.parameters |= {(1, POSITION): 1111, (1, MAX_SPEED): 2222}
    modules.faults = [lambda reply: reply + reply]
    assert bus.ask("arm", get(Parameter.ACTUAL_POSITION), "position") == 1111
    assert bus.ask("arm", get(Parameter.MAXIMUM_SPEED), "speed") == 2222


def test_the_reply_of_another_module_is_not_taken(bus, modules):
    modules.parameters[1, POSITION] = 1111
    modules.faults = [lambda reply: sealed(2, 2, 100, GET, 9999) + reply]
    assert bus.ask("arm", get(Parameter.ACTUAL_POSITION), "position") == 1111


def test_a_wrong_checksum_is_never_accepted(bus, modules):
    modules.faults = 10 * [lambda reply: reply[:8] + bytes([reply[8] ^ 1])]
    with pytest.raises(FrameError, match=r"no reply to arm: position.*< 02 01 64 06"):
        bus.ask("arm", get(Parameter.ACTUAL_POSITION), "position")


def test_a_damaged_reply_is_asked_for_again(bus, modules):
    modules.parameters[1, POSITION] = 1111
    modules.faults = [lambda reply: reply[:5] + b"\xff" + reply[6:]]
    assert bus.ask("arm", get(Parameter.ACTUAL_POSITION), "position") == 1111


def test_a_request_that_came_damaged_is_repeated(bus, modules):
    """Status 1: the module saw a wrong checksum and executed nothing."""
    modules.parameters[1, POSITION] = 1111
    modules.faults = [lambda _: sealed(2, 1, 1, GET, 0)]
    assert bus.ask("arm", get(Parameter.ACTUAL_POSITION), "position") == 1111
    assert len(modules.commands) == 2


@pytest.mark.parametrize(
    ("status", "meaning"),
    [(2, "invalid command"), (3, "wrong type"), (4, "invalid value"), (5, "locked"), (6, "not available")],
)
def test_a_refusal_says_why_and_is_not_repeated(bus, modules, status, meaning):
    modules.faults = [lambda _: sealed(2, 1, status, GET, 0)]
    with pytest.raises(ReplyError, match=rf"arm: module 1 refuses position: .*{meaning}.*status {status}.*< 02 01"):
        bus.ask("arm", get(Parameter.ACTUAL_POSITION), "position")
    assert len(modules.commands) == 1


def test_silence_is_repeated_three_times_and_then_told(bus, modules):
    modules.faults = 10 * [lambda _: b""]
    with pytest.raises(ReadTimeoutError, match=r"arm: position.*switched on"):
        bus.ask("arm", get(Parameter.ACTUAL_POSITION), "position")
    assert len(modules.commands) == 3


def test_opening_stops_the_axis_and_sets_its_ramp(bus, clock, modules):
    """30 deg/s and 60 deg/s^2 at 100 steps/deg in the TMC429's units: at least ten bits of each are used."""
    StepperAxis("arm", config(), bus, clock).open()
    assert [entry[:3] for entry in modules.commands[:4]] == [
        (1, VERSION, 1),
        (1, SEARCH, 1),
        (1, STOP, 0),
        (1, GET, SPEED),
    ]
    written = {kind: value for _, command, kind, value in modules.commands if command == SET}
    speed_unit = 16e6 / (2 ** written[154] * 2048 * 32)
    acceleration_unit = 16e6**2 / 2 ** (written[154] + written[153] + 29)
    assert written[4] * speed_unit == pytest.approx(3000, rel=1 / 1024)
    assert written[5] * acceleration_unit == pytest.approx(6000, rel=1 / 1024)
    assert max(written.values()) <= 2047


def test_a_module_that_is_not_there_is_told_at_opening(bus, clock, modules):
    modules.faults = 10 * [lambda _: b""]
    with pytest.raises(ReadTimeoutError, match="arm: version"):
        StepperAxis("arm", config(), bus, clock).open()


def test_a_move_is_commanded_in_steps_and_read_back_in_radians(axis, modules, clock):
    axis.move_to(radians(12.34))
    assert moves(modules) == [(1, MOVE, 0, 1234)]
    before_s = clock.now_s()
    axis.wait()
    assert axis.angle_rad() == pytest.approx(radians(12.34), abs=1e-12)
    assert clock.now_s() - before_s == pytest.approx(axis.move_time_s(0.0, radians(12.34)), abs=1e-9)


def test_waiting_without_a_move_returns_at_once(axis, modules, clock):
    before_s = clock.now_s()
    axis.wait()
    assert clock.now_s() == before_s
    assert modules.commands == []


@pytest.mark.parametrize(("way_deg", "expected_s"), [(0.0, 0.2), (15.0, 1.2), (30.0, 1.7), (-90.0, 3.7)])
def test_move_times_are_those_of_the_ramp(axis, way_deg, expected_s):
    """Ramps of 0.5 s and 7.5 deg each, a triangle below 15 deg; 0.2 s to settle. Bound: the units' rounding."""
    assert axis.move_time_s(0.0, radians(way_deg)) == pytest.approx(expected_s, rel=1e-3)


@pytest.mark.parametrize("angle_deg", [90.1, -90.1, 1e9, float("nan")])
def test_outside_the_limits_nothing_moves(axis, modules, angle_deg):
    with pytest.raises(LimitError, match=r"arm: .* is outside -90 to 90 deg; nothing was moved.*\[axes.arm\]"):
        axis.move_to(radians(angle_deg))
    assert moves(modules) == []


@pytest.mark.parametrize("angle_deg", [90.0, -90.0])
def test_the_limits_themselves_are_allowed(axis, angle_deg):
    axis.check(radians(angle_deg))


def test_a_forbidden_zone_may_be_passed_but_not_stood_in(bus, clock, modules):
    axis = StepperAxis("light_arc", config(forbidden_deg=((-12, 12),)), bus, clock)
    axis.open()
    axis.home()
    with pytest.raises(InterlockError, match="12 deg is into the zone -12 to 12 deg"):
        axis.move_to(radians(12))
    assert moves(modules) == []
    for angle_deg in (-45, 45):
        axis.move_to(radians(angle_deg))
        axis.wait()
    assert len(moves(modules)) == 2


def test_a_collision_zone_is_checked_along_the_whole_way(bus, clock, modules):
    axis = StepperAxis("light_arc", config(collision_deg=((20, 30),)), bus, clock)
    axis.open()
    axis.home()
    axis.check(radians(19))
    for angle_deg in (25, 45):
        with pytest.raises(InterlockError, match=r"light_arc: .* into the zone 20 to 30 deg"):
            axis.check(radians(angle_deg))
        with pytest.raises(InterlockError, match="nothing was moved"):
            axis.move_to(radians(angle_deg))
    assert moves(modules) == []


def test_without_homing_nothing_moves(bus, clock, modules):
    axis = StepperAxis("arm", config(), bus, clock)
    axis.open()
    with pytest.raises(StateError, match="not homed"):
        axis.move_to(0.1)
    assert moves(modules) == []


def test_homing_waits_for_the_search_and_bears_missing_replies(axis, modules, clock):
    """Up to three in a row: a module that is busy with its switch may not answer."""
    modules.searching = [1, 1, 1, 0]
    modules.faults = [lambda reply: reply, lambda _: b"", lambda _: b"", lambda _: b""]
    axis.home()
    axis.move_to(0.1)
    assert (1, SEARCH, 0, 0) in modules.commands


def test_homing_gives_up_after_more_silence_than_that(axis, modules):
    modules.faults = [lambda reply: reply, *(10 * [lambda _: b""])]
    with pytest.raises(ReadTimeoutError, match="reference search"):
        axis.home()
    with pytest.raises(StateError, match="not homed"):
        axis.move_to(0.1)


def test_a_switch_that_is_never_found_ends_in_an_error_and_a_stop(axis, modules):
    modules.searching = 100_000 * [1]
    with pytest.raises(DeviceError, match="arm: the reference switch was not found"):
        axis.home()
    assert (1, SEARCH, 1, 0) in modules.commands
    assert (1, STOP, 0, 0) in modules.commands


def test_a_stall_is_told_with_where_and_the_axis_is_stopped(axis, modules):
    axis.move_to(radians(40))
    modules.parameters |= {(1, REACHED): 0, (1, POSITION): 2000}
    with pytest.raises(DeviceError, match="arm: stalled at 20 deg on the way to 40 deg"):
        axis.wait()
    assert (1, STOP, 0, 0) in modules.commands
    with pytest.raises(StateError, match="stalled"):
        axis.move_to(0.1)


def test_a_stalled_axis_is_stopped_also_where_it_does_not_tell_its_position(axis, modules):
    axis.move_to(radians(40))
    modules.parameters[1, REACHED] = 0
    modules.silent = {(GET, POSITION)}
    with pytest.raises(ReadTimeoutError, match="arm: actual position"):
        axis.wait()
    assert (1, STOP, 0, 0) in modules.commands
    with pytest.raises(StateError, match="stalled"):
        axis.move_to(0.1)


def test_a_stop_is_confirmed_by_the_speed_read_back(axis, modules, clock):
    modules.parameters[1, SPEED] = 500
    clock.at(clock.now_s() + 0.3, lambda: modules.parameters.update({(1, SPEED): 0}))
    axis.stop()
    assert modules.parameters[1, SPEED] == 0


def test_an_axis_that_does_not_stop_is_told(axis, modules):
    modules.parameters[1, SPEED] = 500
    with pytest.raises(DeviceError, match="still turns"):
        axis.stop()


def test_after_the_wire_was_lost_the_position_is_not_trusted(axis, wire, modules):
    """The module may have lost power with its adapter."""
    wire.unplug()
    with pytest.raises(TransportError, match="bus: lost"):
        axis.angle_rad()
    wire.plug()
    axis.angle_rad()
    with pytest.raises(StateError, match="wire was lost"):
        axis.move_to(0.1)
    axis.home()
    axis.move_to(0.1)
    assert len(moves(modules)) == 1
