import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.errors import FrameError
from rig.protocols import rcx

SHORT = st.integers(-(2**15), 2**15 - 1)
VALUE_REPLIES = st.builds(
    lambda opcode, value: bytes([opcode]) + value.to_bytes(2, "little", signed=True),
    st.sampled_from([0xED, 0xE5]),
    SHORT,
)
REPLIES = st.one_of(VALUE_REPLIES, st.sampled_from([b"\xef", b"\xe7", b"\xde", b"\x1e", b"\x16", b"\x2e", b"\x4e"]))


@pytest.mark.vectors("rcx", "packet")
def test_vectors_hold_both_ways(vector):
    payload = bytes.fromhex(vector["decoded"]["payload"])
    assert rcx.encode(payload) == vector["wire"]
    assert rcx.decode(vector["wire"]) == payload
    assert payload[0] == vector["decoded"]["opcode"]
    assert rcx.toggled(payload, vector["decoded"]["toggle"]) == payload
    if "value" in vector["decoded"]:
        assert rcx.value(payload) == vector["decoded"]["value"]


@pytest.mark.vectors("rcx")
def test_a_lost_first_byte_is_forgiven(lenient):
    payload = bytes.fromhex(lenient["decoded"]["payload"])
    assert rcx.decode(lenient["wire"]) == payload
    assert rcx.PacketReader().feed(lenient["wire"]) == [payload]


@pytest.mark.vectors("rcx")
def test_malformed_packets_are_refused(malformed):
    with pytest.raises(FrameError, match="RCX packet"):
        rcx.decode(malformed["wire"])
    assert rcx.PacketReader().feed(malformed["wire"]) == []


def test_the_requests_of_the_driver_are_those_of_the_vectors():
    wire = {
        "10": rcx.alive(),
        "12 09 00": rcx.get_value(rcx.Source.SENSOR_VALUE, 0),
        "12 03 01": rcx.get_value(rcx.Source.MOTOR_STATE, 1),
        "32 00 04": rcx.sensor_type(0, rcx.SENSOR_TYPE_ROTATION),
        "42 00 e0": rcx.sensor_mode(0, rcx.SENSOR_MODE_ANGLE),
        "d1 00": rcx.clear_sensor(0),
        "13 01 02 05": rcx.motor_power(rcx.Motor.A, 5),
        "e1 81": rcx.motor_direction(rcx.Motor.A, rcx.DIRECTION_FORWARD),
        "21 81": rcx.motor_state(rcx.Motor.A, rcx.MOTOR_ON),
        "21 41": rcx.motor_state(rcx.Motor.A, rcx.MOTOR_OFF),
        "b1 00": rcx.power_down_delay(0),
    }
    for expected, payload in wire.items():
        assert payload == bytes.fromhex(expected)


def test_the_toggle_changes_the_opcode_and_so_its_reply():
    """12 and 1a ask the same; ed answers 12, e5 answers 1a (opcode reference)."""
    request = rcx.get_value(rcx.Source.SENSOR_VALUE, 0)
    assert rcx.toggled(request, True) == bytes.fromhex("1a 09 00")
    assert rcx.reply_opcode(request) == 0xED
    assert rcx.reply_opcode(rcx.toggled(request, True)) == 0xE5


def test_a_value_that_looks_like_its_own_checksum_does_not_end_the_packet():
    """After `ed` the byte ed is a fitting checksum; the opcode says that two more bytes belong to the payload."""
    payload = b"\xed\xed\x00"
    assert rcx.PacketReader().feed(rcx.encode(payload)) == [payload]


def test_a_value_of_the_wrong_length_is_refused():
    with pytest.raises(FrameError, match="get-value"):
        rcx.value(b"\xed\x00")


@given(st.binary(min_size=1, max_size=20))
@settings(max_examples=50, deadline=None)
def test_encoding_loses_nothing(payload):
    assert rcx.decode(rcx.encode(payload)) == payload


@given(VALUE_REPLIES, st.integers(24, 88))
@settings(max_examples=50, deadline=None)
def test_no_flipped_bit_passes(payload, bit):
    """Each byte behind the header is there twice, once inverted."""
    wire = bytearray(rcx.encode(payload))
    bit = 24 + bit % (8 * len(wire) - 24)
    wire[bit // 8] ^= 1 << bit % 8
    with pytest.raises(FrameError):
        rcx.decode(bytes(wire))


@given(st.lists(REPLIES, max_size=4), st.data())
@settings(max_examples=50, deadline=None)
def test_any_chunking_gives_the_same_payloads(payloads, data):
    stream = b"".join(map(rcx.encode, payloads))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    reader = rcx.PacketReader()
    parts = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    assert [payload for part in parts for payload in reader.feed(part)] == payloads


@given(st.binary(max_size=30), REPLIES)
@settings(max_examples=50, deadline=None)
def test_garbage_does_not_hide_the_packets_behind_it(noise, payload):
    """Whatever comes before, the second of two packets is found: noise can at most break off the first."""
    reader = rcx.PacketReader()
    wire = rcx.encode(payload)
    assert reader.feed(noise + wire + wire + noise).count(payload) >= 1


def test_a_packet_broken_off_in_the_middle_costs_only_itself():
    whole = rcx.encode(b"\xed\x2a\x00")
    assert rcx.PacketReader().feed(whole[:6] + whole) == [b"\xed\x2a\x00"]


def test_clear_forgets_half_a_packet():
    wire = rcx.encode(b"\xef")
    reader = rcx.PacketReader()
    reader.feed(wire[:4])
    reader.clear()
    assert reader.feed(wire[4:]) == []
