"""The laser driver against a scripted RCX behind an echoing tower (vectors/rcx.toml)."""

import pytest

from rig.config import LaserConfig
from rig.drivers.laser_unit import RcxLaser
from rig.errors import DeviceError, ReadTimeoutError
from tests.rig.drivers.peers import cut_rcx

MOTOR, LASER = 0, 1


def packet(payload):
    body = payload + bytes([sum(payload) & 0xFF])
    return b"\x55\xff\x00" + b"".join(bytes([byte, byte ^ 0xFF]) for byte in body)


class Brick:
    """Motor states, one rotation sensor, and the rule that a repeated opcode is answered but not executed.

    The motor turns 39 counts a second of the rig's clock. `faults` holds what becomes of the replies to come.
    """

    def __init__(self, clock):
        self.clock = clock
        self.states = [0x0F, 0x0F, 0x0F]
        self.kind, self.mode = 0, 0
        self.counts, self.since_s = 0.0, 0.0
        self.power_down_min = 15
        self.stuck = False
        self.faults = []
        self.executed = []
        self._last = (None, b"")

    def answer(self, request):
        payload = request[3::2][:-1]
        if payload[0] != self._last[0]:
            self.executed.append(bytes([payload[0] & ~8]) + payload[1:])
            self._last = (payload[0], packet(bytes([payload[0] ^ 0xFF]) + self.execute(self.executed[-1])))
        fault = self.faults.pop(0) if self.faults else lambda reply: reply
        return fault(self._last[1])

    def execute(self, payload):
        match list(payload):
            case [0x10] | [0x13, _, 2, _]:
                return b""
            case [0xB1, minutes]:
                self.power_down_min = minutes
            case [0x12, source, number]:
                return (self.value(source, number) & 0xFFFF).to_bytes(2, "little")
            case [0x32, 0, kind]:
                self.kind = kind
            case [0x42, 0, mode]:
                self.mode = mode
            case [0xD1, 0]:
                self.counts = 0.0
            case [0x21 | 0xE1 as opcode, bits]:
                self.turn()
                chosen = [bool(bits & 1 << number) for number in range(3)]
                self.states = [
                    self.changed(state, opcode, bits) if hit else state
                    for state, hit in zip(self.states, chosen, strict=True)
                ]
            case _:
                raise AssertionError(payload.hex(" "))
        return b""

    def changed(self, state, opcode, bits):
        if opcode == 0x21:
            return state & 0x0F | bits & 0xC0
        return state & ~0x08 | (0x08 if bits & 0x80 else 0)

    def value(self, source, number):
        self.turn()
        return {
            3: lambda: self.states[number],
            9: lambda: int(self.counts),
            10: lambda: self.kind,
            11: lambda: self.mode,
        }[source]()

    def turn(self):
        elapsed_s, self.since_s = self.clock.now_s() - self.since_s, self.clock.now_s()
        if self.states[MOTOR] & 0x80 and not self.stuck:
            self.counts += elapsed_s * 39 * (1 if self.states[MOTOR] & 8 else -1)
        self.clock.time_s += 0.1  # an exchange on the infrared wire

    def is_on(self, number):
        return bool(self.states[number] & 0x80)


@pytest.fixture
def brick(clock):
    return Brick(clock)


@pytest.fixture(params=[True, False], ids=["echoing tower", "silent tower"])
def wire(request, pty_peer, brick):
    return pty_peer(cut_rcx, brick.answer, echo=request.param)


@pytest.fixture
def laser(wire, clock):
    config = LaserConfig(port=wire.port, distance_mm=800.0, elevations_deg=(35.0,), sweep_ticks=480, ticks_per_s=39.0)
    laser = RcxLaser(config, clock)
    laser.open()
    yield laser
    laser.close()


def test_opening_leaves_everything_off_awake_and_counting_from_zero(laser, brick):
    assert not brick.is_on(MOTOR)
    assert not brick.is_on(LASER)
    assert (brick.kind, brick.mode, brick.power_down_min, brick.counts) == (4, 0xE0, 0, 0.0)


def test_a_count_that_is_still_valid_is_kept(laser, brick, clock, wire):
    """After a crash in the middle of a sweep the RCX still knows where its motor is."""
    laser.close()
    brick.counts = 250.0
    again = RcxLaser(laser._config, clock)
    again.open()
    assert brick.counts == 250.0
    again.rewind()
    assert abs(brick.counts) < 12
    again.close()


def test_a_sweep_lights_the_laser_before_the_motor_turns(laser, brick):
    brick.executed.clear()
    laser.start_sweep()
    assert brick.is_on(MOTOR)
    assert brick.is_on(LASER)
    on = [payload for payload in brick.executed if payload[0] == 0x21]
    assert on == [bytes([0x21, 0x82]), bytes([0x21, 0x81])]


def test_after_a_sweep_the_motor_comes_back_to_the_start(laser, brick, clock):
    """To within the way of two exchanges of 0.1 s each, the last count's age and that of the stop."""
    laser.start_sweep()
    clock.sleep(laser.sweep_time_s())
    laser.stop()
    assert brick.counts > 400
    laser.rewind()
    assert not brick.is_on(MOTOR)
    assert not brick.is_on(LASER)
    assert abs(brick.counts) < 2 * 0.1 * 39 + 4


def test_a_sweep_that_turned_as_far_as_it_should_ends_dark(laser, brick, clock):
    laser.start_sweep()
    clock.sleep(laser.sweep_time_s())
    laser.end_sweep()
    assert not brick.is_on(MOTOR)
    assert not brick.is_on(LASER)


def test_a_motor_that_stands_during_a_sweep_is_told_after_all_is_off(laser, brick, clock):
    laser.start_sweep()
    clock.sleep(0.2 * laser.sweep_time_s())
    brick.turn()
    brick.stuck = True
    clock.sleep(0.8 * laser.sweep_time_s())
    with pytest.raises(DeviceError, match=r"turned by \d+ counts in 12\.\d s where 480 were to come"):
        laser.end_sweep()
    assert not brick.is_on(MOTOR)
    assert not brick.is_on(LASER)


def test_rewinding_at_the_start_moves_nothing(laser, brick):
    brick.executed.clear()
    laser.rewind()
    assert bytes([0x21, 0x81]) not in brick.executed


def test_rewinding_ends_a_sweep_that_has_only_begun(laser, brick):
    laser.start_sweep()
    laser.rewind()
    assert not brick.is_on(MOTOR)
    assert not brick.is_on(LASER)


def test_a_motor_that_stands_still_is_told_and_switched_off(laser, brick):
    brick.counts, brick.stuck = 300.0, True
    with pytest.raises(DeviceError, match="count stands at 300"):
        laser.rewind()
    assert not brick.is_on(MOTOR)


def test_a_lost_reply_is_repeated_and_not_executed_twice(laser, brick):
    brick.faults = [lambda _: b"", lambda _: b""]
    brick.executed.clear()
    laser.start_sweep()
    assert brick.is_on(MOTOR)
    assert [payload[0] for payload in brick.executed] == [0xE1, 0x21, 0x12, 0x21]


def test_the_same_command_twice_is_executed_twice(laser, brick):
    """Without the toggle bit the RCX would take the second for a repetition of the first."""
    brick.executed.clear()
    laser._count()
    laser._count()
    assert brick.executed == [b"\x12\x09\x00", b"\x12\x09\x00"]


def test_a_lost_first_byte_is_forgiven(laser, brick):
    brick.counts = 42.0
    brick.faults = [lambda reply: reply[1:]]
    assert laser._count() == 42


def test_a_damaged_reply_is_asked_for_again(laser, brick):
    brick.counts = 42.0
    brick.faults = [lambda reply: reply[:4] + b"\x00" + reply[5:]]
    assert laser._count() == 42


def test_negative_counts_are_negative(laser, brick):
    brick.counts = -7.0
    assert laser._count() == -7


def test_a_silent_brick_is_told_after_four_attempts(laser, brick, wire):
    brick.faults = 10 * [lambda _: b""]
    before = len(wire.requests)
    with pytest.raises(ReadTimeoutError, match="laser: no reply to rotation count"):
        laser._count()
    assert len(wire.requests) - before == 4


def test_a_laser_that_stays_on_is_told(laser, brick, monkeypatch):
    laser.start_sweep()
    monkeypatch.setattr(brick, "changed", lambda state, opcode, bits: state)
    with pytest.raises(DeviceError, match="still reads on"):
        laser.stop()


def test_a_laser_that_does_not_light_is_told_before_the_motor_turns(laser, brick, monkeypatch):
    monkeypatch.setattr(brick, "changed", lambda state, opcode, bits: state)
    with pytest.raises(DeviceError, match="does not read on"):
        laser.start_sweep()
    assert not brick.is_on(MOTOR)
