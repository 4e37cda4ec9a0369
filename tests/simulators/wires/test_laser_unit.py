import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.laser_unit import Brick, Tower, encode

BYTES_PER_S = 2400 / 11


@pytest.fixture
def tower_wire(wire):
    return wire("tower", BYTES_PER_S)


@pytest.fixture
def brick(clock, world):
    return Brick(clock, world)


@pytest.fixture
def tower(tower_wire, brick):
    return Tower(tower_wire.line, brick)


def decode_reply(packet):
    """The payload of a whole packet, checked."""
    assert packet[:3] == b"\x55\xff\x00"
    values, complements = packet[3::2], packet[4::2]
    assert all(value ^ complement == 0xFF for value, complement in zip(values, complements, strict=True))
    assert sum(values[:-1]) & 0xFF == values[-1]
    return values[:-1]


@pytest.fixture
def ask(tower, tower_wire):
    """Send a payload in hex; the reply's payload after the echo, None for silence."""

    def ask(payload):
        packet = encode(bytes.fromhex(payload))
        tower.receive(packet, 0.0)
        heard = tower_wire.take()
        assert heard.startswith(packet), "the serial tower echoes"
        answer = heard[len(packet) :]
        return decode_reply(answer) if answer else None

    return ask


PACKETS = [
    "alive", "alive_toggled", "get_rotation", "get_motor_a_state", "get_motor_b_state", "sensor_type_rotation",
    "sensor_mode_angle", "clear_sensor", "motor_power", "motor_forward", "motor_on", "motor_off", "power_down_never",
    "transmitter_far",
]  # fmt: skip


@pytest.mark.parametrize("name", PACKETS)
def test_real_packets_are_answered_with_the_complement(tower, tower_wire, vectors, name):
    vector = vectors("rcx")[name]
    tower.receive(vector["wire"], 0.0)
    heard = tower_wire.take()
    assert heard.startswith(vector["wire"])
    reply = decode_reply(heard[len(vector["wire"]) :])
    assert reply[0] == vector["decoded"]["opcode"] ^ 0xFF


def test_alive_reply_is_the_published_one(tower, tower_wire, vectors):
    rcx = vectors("rcx")
    tower.receive(rcx["alive"]["wire"], 0.0)
    assert tower_wire.take() == rcx["alive"]["wire"] + rcx["alive_reply"]["wire"]


def test_set_message_has_no_reply(tower, tower_wire, brick, vectors):
    vector = vectors("rcx")["set_message"]
    for _ in range(2):
        tower.receive(vector["wire"], 0.0)
        assert tower_wire.take() == vector["wire"], "the echo alone"
    assert brick.message == 0x12


def test_first_byte_may_be_lost(tower, tower_wire, vectors):
    packet = vectors("rcx")["alive"]["wire"][1:]
    tower.receive(packet, 0.0)
    assert tower_wire.take() == packet + vectors("rcx")["alive_reply"]["wire"]


@pytest.mark.parametrize("name", ["complement_wrong", "checksum_wrong"])
def test_broken_packets_are_ignored(tower, tower_wire, brick, vectors, name):
    broken = vectors("rcx")[name]["wire"]
    tower.receive(broken, 0.0)
    assert tower_wire.take() == broken
    assert brick.message == 0
    alive = vectors("rcx")["alive"]["wire"]
    tower.receive(alive, 0.0)
    assert tower_wire.take() == alive + vectors("rcx")["alive_reply"]["wire"], "the next packet is found"


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.integers(0, 254), max_size=12).map(bytes),
    st.sampled_from(["10", "12 09 00", "e1 81", "45 01 00 03 00 07 08 09 18"]),
    st.integers(0, 40),
)
def test_packets_are_found_behind_noise_and_in_pieces(noise, payload, cut):
    class Line:
        write = staticmethod(lambda data: None)
        request = staticmethod(lambda length: None)

    class Ear:
        def __init__(self):
            self.heard = []

        def answer(self, payload):
            self.heard.append(payload)

    ear = Ear()
    tower, data = Tower(Line(), ear), noise + encode(bytes.fromhex(payload))
    tower.receive(data[:cut], 0.0)
    tower.receive(data[cut:], 0.0)
    assert ear.heard == [bytes.fromhex(payload)]


def test_identical_opcode_is_a_repetition(ask, brick):
    """The reply is repeated, the flip is not done again; with the toggle bit it is a new command."""
    assert ask("e1 41") == ask("e1 41") == b"\x1e"
    assert brick.outputs[1] & 0x08 == 0
    assert ask("e9 41") == b"\x16"
    assert brick.outputs[1] & 0x08


def test_repetition_after_another_command_is_new(ask, brick):
    ask("e1 41")
    ask("10")
    ask("e1 41")
    assert brick.outputs[1] & 0x08, "flipped twice"


def test_motor_turns_the_rotation_sensor(ask, clock, world):
    for payload in ("32 00 04", "42 00 e0", "d1 00", "13 01 02 07", "e1 81", "21 81"):
        assert ask(payload) is not None
    clock.advance(2.0)
    counted = int.from_bytes(ask("12 09 00")[1:], "little", signed=True)
    assert counted == pytest.approx(2 * world.layout.laser.ticks_per_s, rel=0.15)
    assert ask("12 03 00".replace("12", "1a"))[1:] == bytes([0x8F, 0]), "on, forward, power 7"
    ask("29 41")
    stands = ask("12 09 00")
    clock.advance(5.0)
    ask("10")
    assert ask("12 09 00") == stands


def test_fan_sweeps_over_the_sample_in_the_time_told(ask, clock, world):
    laser = world.layout.laser
    start = world.fan_rad()
    for payload in ("13 03 02 07", "e1 83", "21 83"):
        ask(payload)
    clock.advance(laser.sweep_ticks / laser.ticks_per_s)
    swept = laser.fan_rad(laser.sweep_ticks, 0.6108652381980153) - laser.fan_rad(0, 0.6108652381980153)
    assert world.fan_rad() - start == pytest.approx(swept, rel=0.1)
    assert world.laser.on


def test_sensor_without_a_type_reads_open(ask):
    assert ask("12 09 00") == bytes([0xED, 0xFF, 0x03])


def test_wire_time_is_charged(ask, clock):
    """A get-value and its reply take 22 bytes of 11 bits: 101 ms at 2400 baud."""
    ask("12 09 00")
    assert clock.now_s() == pytest.approx(22 * 11 / 2400, abs=1e-8)


@pytest.mark.parametrize(("delay", "answers"), [("b1 00", True), ("b1 01", False), ("b1 05", True)])
def test_power_goes_off_after_the_delay(ask, clock, world, delay, answers):
    for payload in (delay, "13 03 02 07", "e1 83", "21 83"):
        ask(payload)
    clock.advance(120.0)
    assert world.laser.on is answers, "it goes off by itself, not at the next message"
    assert (world.laser.motor.run is not None) is answers
    assert (ask("10") is not None) is answers


def test_switched_on_again_it_has_forgotten(ask, brick):
    ask("32 00 04")
    brick.switch(on=False)
    assert ask("10") is None
    brick.switch(on=True)
    assert ask("10") == b"\xef"
    assert ask("12 09 00")[1:] == b"\xff\x03"


def test_download_in_blocks(ask, brick):
    program = bytes(range(30))
    assert ask("25 00 02 00 1e 00") == b"\xda\x00"
    for number, opcode in ((1, "45"), (0, "4d")):
        block = program[:20] if number else program[20:]
        header = bytes([number, 0, len(block), 0])
        payload = bytes.fromhex(opcode) + header + block + bytes([sum(block) & 0xFF])
        assert ask(payload.hex()) == bytes([payload[0] ^ 0xFF, 0])
    assert brick.tasks == {2: program}
    bad = bytes([0x45, 0, 0, 1, 0, 7, 8])
    assert ask(bad.hex())[1] != 0, "no download is active"


def test_dropped_reply_leaves_the_command_done(ask, brick, faults):
    faults.add({"device": "tower", "kind": "drop"})
    assert ask("e1 41") is None
    assert brick.outputs[1] & 0x08 == 0
    assert ask("e1 41") == b"\x1e", "the repetition is answered"
    assert brick.outputs[1] & 0x08 == 0, "and not done again"
