import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.axes import (
    INVALID_COMMAND,
    INVALID_VALUE,
    OK,
    WRONG_CHECKSUM,
    WRONG_TYPE,
    Bus,
    Module,
    acceleration_unit,
    speed_unit,
)

MVP, SAP, GAP, RFS = 4, 5, 6, 13
DATAGRAM = 9
BYTES_PER_S = 960.0


@pytest.fixture
def bus_wire(wire):
    return wire("bus", BYTES_PER_S)


@pytest.fixture
def bus(bus_wire, world, layout):
    modules = {axis.module: Module(axis.module, world.stages[name]) for name, axis in layout.axes.items()}
    return Bus(bus_wire.line, modules)


@pytest.fixture
def ask(bus, bus_wire):
    """Send a request; status and value of the reply, or None for silence."""

    def ask(module, command, type_=0, bank=0, value=0):
        body = struct.pack(">BBBBi", module, command, type_, bank, value)
        bus.receive(body + bytes([sum(body) & 0xFF]), 0.0)
        reply = bus_wire.take()
        if not reply:
            return None
        assert len(reply) == DATAGRAM
        assert sum(reply[:8]) & 0xFF == reply[8]
        host, address, status, echo, answer = struct.unpack(">BBBBi", reply[:8])
        assert (host, address, echo) == (2, module, command)
        return status, answer

    return ask


REQUESTS = [
    "rotate_right", "rotate_left", "motor_stop", "move_absolute", "move_absolute_negative", "move_relative",
    "set_maximum_speed", "get_actual_position", "get_position_reached", "reference_search_start",
    "reference_search_stop", "reference_search_status", "firmware_version_text", "firmware_version_binary",
]  # fmt: skip


@pytest.mark.parametrize("name", REQUESTS)
def test_real_requests_are_carried_out(bus, bus_wire, vectors, name):
    vector = vectors("tmcl")[name]
    bus.receive(vector["wire"], 0.0)
    reply = bus_wire.take()
    assert len(reply) == DATAGRAM
    if name != "firmware_version_text":
        assert reply[:4] == bytes([2, vector["decoded"]["module"], OK, vector["decoded"]["command"]])


@pytest.mark.parametrize(
    ("request_name", "reply_name"),
    [
        ("firmware_version_text", "firmware_version_text_reply"),
        ("firmware_version_binary", "firmware_version_binary_reply"),
    ],
)
def test_version_replies_are_those_of_the_manual(bus, bus_wire, vectors, request_name, reply_name):
    tmcl = vectors("tmcl")
    bus.receive(tmcl[request_name]["wire"], 0.0)
    assert bus_wire.take() == tmcl[reply_name]["wire"]


@pytest.mark.parametrize(
    ("reply_name", "request_fields"),
    [
        ("status_invalid_command", (1, 99, 0, 0, 0)),
        ("status_wrong_type", (2, SAP, 250, 0, 1)),
        ("status_invalid_value", (3, SAP, 4, 0, 2048)),
    ],
)
def test_refusals_are_those_of_the_manual(bus, bus_wire, vectors, reply_name, request_fields):
    body = struct.pack(">BBBBi", *request_fields)
    bus.receive(body + bytes([sum(body) & 0xFF]), 0.0)
    assert bus_wire.take() == vectors("tmcl")[reply_name]["wire"]


def test_wrong_checksum_is_refused_and_nothing_moves(bus, bus_wire, vectors, world):
    request = bytearray(vectors("tmcl")["move_absolute"]["wire"])
    request[8] ^= 1
    bus.receive(bytes(request), 0.0)
    assert bus_wire.take()[2] == WRONG_CHECKSUM
    assert not world.stages["light_arc"].moving()
    bus.receive(vectors("tmcl")["get_actual_position"]["wire"][:8] + b"\x00", 0.0)
    assert bus_wire.take() == vectors("tmcl")["status_wrong_checksum"]["wire"]


def test_modules_not_addressed_stay_silent(ask):
    assert ask(4, GAP, 1) is None
    assert ask(255, GAP, 1) is None


@settings(max_examples=40, deadline=None)
@given(st.binary(min_size=9, max_size=9))
def test_any_datagram_has_one_reply_or_none(datagram):
    """Whatever comes, a module answers nine bytes and lives on."""

    class Axis:
        speed_steps_s, acceleration_steps_s2, name = 3000.0, 6000.0, "arm"

        def __getattr__(self, name):
            return lambda *arguments: 0

    assert len(Module(datagram[0], Axis()).answer(datagram)) == DATAGRAM


def test_datagrams_in_pieces_and_after_a_broken_one(bus, bus_wire, vectors):
    request = vectors("tmcl")["get_actual_position"]["wire"]
    bus.receive(request[:4], 0.0)
    bus.receive(request[4:] + request, 0.01)
    assert len(bus_wire.take()) == 2 * DATAGRAM
    bus.receive(request[:5], 0.0)
    bus.receive(request, 0.2)
    assert len(bus_wire.take()) == DATAGRAM, "a pause ends a broken datagram"


def test_wire_time_is_charged(ask, clock):
    ask(1, GAP, 1)
    assert clock.now_s() == pytest.approx(2 * DATAGRAM / BYTES_PER_S, abs=1e-8)
    ask(9, GAP, 1)
    assert clock.now_s() == pytest.approx(3 * DATAGRAM / BYTES_PER_S, abs=1e-8)


def test_motion_takes_its_time(ask, clock, layout, world):
    """90 deg at 30 deg/s and 60 deg/s^2: 3 s and half a second of ramps."""
    assert ask(3, MVP, value=14400) == (OK, 14400)
    assert ask(3, GAP, 8) == (OK, 0)
    start_s = clock.now_s()
    clock.advance(3.4)
    assert ask(3, GAP, 8) == (OK, 0)
    clock.advance(0.2)
    assert ask(3, GAP, 8) == (OK, 1)
    assert ask(3, GAP, 1) == (OK, 14400)
    assert clock.now_s() - start_s < 3.8
    assert ask(1, GAP, 1) == (OK, 0), "the other axes stood still"


def test_units_are_those_of_the_motion_controller(ask, clock):
    """A speed of 786 at pulse divisor 6 is 2998 steps/s; each step of a divisor halves what a unit means."""
    assert speed_unit(6) == pytest.approx(16e6 / 64 / 65536)
    assert acceleration_unit(6, 9) == pytest.approx(16e6**2 / 2**44)
    for divisor, speed in ((6, 400), (7, 800)):
        ask(1, SAP, 154, value=divisor)
        ask(1, SAP, 5, value=2047)
        assert ask(1, 1, value=speed) == (OK, speed)
        clock.advance(1.0)
        before, start_s = ask(1, GAP, 1)[1], clock.now_s()
        clock.advance(1.0)
        after = ask(1, GAP, 1)[1]
        steps_s = (after - before) / (clock.now_s() - start_s)
        assert steps_s == pytest.approx(400 * speed_unit(6), rel=0.01)
        ask(1, 3)
        clock.advance(1.0)
        assert ask(1, GAP, 3) == (OK, 0)
        ask(1, SAP, 1, value=0)


def test_reference_search_ends_at_the_switch_wherever_the_axis_stood(ask, clock, world):
    stage = world.stages["arm"]
    off_deg = abs(stage.angle_rad())
    assert off_deg > 1e-3, "at power-up the counter does not know where the axis stands"
    ask(1, MVP, value=-3000)
    clock.advance(5.0)
    assert ask(1, RFS, 0) == (OK, 0)
    assert ask(1, RFS, 2)[1] != 0
    clock.advance(15.0)
    assert ask(1, RFS, 2) == (OK, 0)
    assert ask(1, GAP, 1) == (OK, 0)
    assert ask(1, GAP, 9) == (OK, 1)
    assert abs(stage.angle_rad()) < 2e-4, "repeatability of 0.008 deg"


def test_search_can_be_stopped(ask, clock):
    ask(1, MVP, value=5000)
    clock.advance(5.0)
    ask(1, RFS, 0)
    clock.advance(0.3)
    ask(1, RFS, 1)
    assert ask(1, RFS, 2) == (OK, 0)
    clock.advance(2.0)
    assert ask(1, GAP, 3) == (OK, 0)
    assert ask(1, GAP, 1)[1] > 1000, "it is where it was stopped"


def test_same_steps_are_the_same_place(ask, clock, world):
    """The repeatability error belongs to the place: a repeated session sees the same bits."""
    places = []
    for target in (1234, -800, 1234):
        ask(1, MVP, value=target)
        clock.advance(10.0)
        places.append(world.stages["arm"].angle_rad())
    assert places[0] == places[2] != places[1]


def test_end_switch_stops_a_rotation(ask, clock):
    ask(1, 1, value=500)
    clock.advance(60.0)
    assert ask(1, GAP, 3) == (OK, 0)
    assert ask(1, GAP, 10) == (OK, 1)
    assert ask(1, GAP, 11) == (OK, 0)


def test_stall_stops_half_way_and_never_arrives(ask, clock, faults):
    faults.add({"device": "turntable", "kind": "stall"})
    ask(3, MVP, value=8000)
    clock.advance(60.0)
    assert ask(3, GAP, 8) == (OK, 0)
    assert 0 < ask(3, GAP, 1)[1] < 8000
    assert ask(3, GAP, 3) == (OK, 0)
    assert ask(3, GAP, 207)[1] == 1
    ask(3, MVP, value=8000)
    clock.advance(60.0)
    assert ask(3, GAP, 8) == (OK, 1), "the fault struck once"


def test_lost_steps_are_not_in_the_counter(ask, clock, faults, world):
    stage = world.stages["turntable"]
    before = stage.angle_rad()
    faults.add({"device": "turntable", "kind": "lost_steps", "steps": -320})
    ask(3, MVP, value=1600)
    clock.advance(10.0)
    ask(3, MVP, value=0)
    clock.advance(10.0)
    assert ask(3, GAP, 1) == (OK, 0)
    assert stage.angle_rad() - before == pytest.approx(-0.0349, abs=3e-4), "2 deg off"


def test_a_search_begun_before_the_steps_are_lost_ends_at_the_switch(ask, clock, faults, world):
    """They belong to the move that the search has ended."""
    faults.add({"device": "turntable", "kind": "lost_steps", "steps": -320})
    ask(3, MVP, value=16000)
    clock.advance(0.1)
    ask(3, RFS, 0)
    clock.advance(60.0)
    assert ask(3, GAP, 9) == (OK, 1)
    assert abs(world.stages["turntable"].angle_rad()) < 2e-4, "repeatability of 0.008 deg"


def test_parameters_pins_and_globals(ask):
    assert ask(1, SAP, 6, value=200) == (OK, 200)
    assert ask(1, GAP, 6) == (OK, 200)
    assert ask(1, SAP, 3, value=1)[0] == WRONG_TYPE, "actual speed is read only"
    assert ask(1, GAP, 1, bank=1)[0] == INVALID_VALUE, "there is one motor"
    assert ask(1, 14, 2, 2, 1) == (OK, 1)
    assert ask(1, 15, 2, 2) == (OK, 1)
    assert ask(1, 15, 3, 2) == (OK, 0)
    assert ask(1, 15, 7, 1)[0] == WRONG_TYPE
    assert ask(1, 9, 5, 2, 42) == (OK, 42)
    assert ask(1, 10, 5, 2) == (OK, 42)
    assert ask(1, 10, 66, 0) == (OK, 1)
    assert ask(1, 200)[0] == INVALID_COMMAND


def test_position_beyond_the_controllers_range_is_refused(ask):
    assert ask(1, MVP, value=2**23)[0] == INVALID_VALUE
    assert ask(1, MVP, 2, value=0)[0] == WRONG_TYPE
