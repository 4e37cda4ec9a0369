import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from rig.errors import FrameError
from rig.protocols import tmcl

BYTE = st.integers(0, 255)
VALUE = st.integers(-(2**31), 2**31 - 1)
REPLIES = st.builds(tmcl.Reply, BYTE, BYTE, st.sampled_from(sorted(tmcl.STATUS_MEANING)), BYTE, VALUE)


@pytest.mark.vectors("tmcl", "request")
def test_request_vectors_hold_both_ways(vector):
    request = tmcl.Request(**vector["decoded"])
    assert tmcl.encode_request(request) == vector["wire"]
    assert tmcl.decode_request(vector["wire"]) == request


@pytest.mark.vectors("tmcl", "reply")
def test_reply_vectors_hold_both_ways(vector):
    reply = tmcl.Reply(**vector["decoded"])
    assert tmcl.encode_reply(reply) == vector["wire"]
    assert tmcl.decode_reply(vector["wire"]) == reply


@pytest.mark.vectors("tmcl", "reply")
def test_malformed_replies_are_refused(malformed):
    with pytest.raises(FrameError, match="not a TMCL reply"):
        tmcl.decode_reply(malformed["wire"])


def test_the_requests_of_the_driver_are_those_of_the_vectors():
    """The constructors name command, type and parameter right: the wire says the same as an independent client."""
    wire = {
        "02 04 00 00 00 00 23 28 51": tmcl.move_absolute(2, 0, 9000),
        "01 03 00 00 00 00 00 00 04": tmcl.motor_stop(1, 0),
        "01 06 01 00 00 00 00 00 08": tmcl.get_parameter(1, 0, tmcl.Parameter.ACTUAL_POSITION),
        "01 06 08 00 00 00 00 00 0f": tmcl.get_parameter(1, 0, tmcl.Parameter.POSITION_REACHED),
        "03 05 04 00 00 00 07 d0 e3": tmcl.set_parameter(3, 0, tmcl.Parameter.MAXIMUM_SPEED, 2000),
        "03 05 05 00 00 00 0f a0 bc": tmcl.set_parameter(3, 0, tmcl.Parameter.MAXIMUM_ACCELERATION, 4000),
        "01 0d 00 00 00 00 00 00 0e": tmcl.reference_search(1, 0, tmcl.Search.START),
        "01 0d 01 00 00 00 00 00 0f": tmcl.reference_search(1, 0, tmcl.Search.STOP),
        "01 0d 02 00 00 00 00 00 10": tmcl.reference_search(1, 0, tmcl.Search.STATUS),
        "01 88 01 00 00 00 00 00 8a": tmcl.firmware_version(1),
    }
    for expected, request in wire.items():
        assert tmcl.encode_request(request) == bytes.fromhex(expected)


@given(st.builds(tmcl.Request, BYTE, BYTE, BYTE, BYTE, VALUE), REPLIES)
@settings(max_examples=50, deadline=None)
def test_encoding_loses_nothing(request, reply):
    assert tmcl.decode_request(tmcl.encode_request(request)) == request
    assert tmcl.decode_reply(tmcl.encode_reply(reply)) == reply


@given(REPLIES, st.integers(0, 71))
@settings(max_examples=50, deadline=None)
def test_no_flipped_bit_passes(reply, bit):
    """The 8-bit sum catches every single flipped bit."""
    wire = bytearray(tmcl.encode_reply(reply))
    wire[bit // 8] ^= 1 << bit % 8
    with pytest.raises(FrameError):
        tmcl.decode_reply(bytes(wire))


@given(st.lists(REPLIES, max_size=5), st.data())
@settings(max_examples=50, deadline=None)
def test_any_chunking_gives_the_same_replies(replies, data):
    stream = b"".join(map(tmcl.encode_reply, replies))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    reader = tmcl.ReplyReader()
    parts = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    assert [reply for part in parts for reply in reader.feed(part)] == replies


def fits_by_accident(stream, replies):
    """Nine bytes that are none of the replies, whose last is the sum of the others and whose third is a status."""
    windows = (stream[start : start + 9] for start in range(len(stream) - 8))
    return any(
        sum(window[:8]) & 0xFF == window[8] and window[2] in tmcl.STATUS_MEANING and window not in replies
        for window in windows
    )


@given(st.binary(max_size=30), REPLIES, st.binary(max_size=30))
@settings(max_examples=50, deadline=None)
def test_garbage_before_and_behind_does_not_hide_a_reply(before, reply, behind):
    """Unless it makes up a reply of its own together with the bytes beside it: TMCL marks no start."""
    wire = tmcl.encode_reply(reply)
    assume(not fits_by_accident(before + wire + behind, [wire]))
    assert tmcl.ReplyReader().feed(before + wire + behind) == [reply]


def test_a_damaged_reply_costs_only_itself():
    good = tmcl.Reply(2, 1, 100, 6, -1000)
    damaged = bytearray(tmcl.encode_reply(good))
    damaged[6] ^= 0x40
    reader = tmcl.ReplyReader()
    assert reader.feed(bytes(damaged) + tmcl.encode_reply(good)) == [good]


def test_clear_forgets_half_a_reply():
    wire = tmcl.encode_reply(tmcl.Reply(2, 1, 100, 6, 7))
    reader = tmcl.ReplyReader()
    reader.feed(wire[:5])
    reader.clear()
    assert reader.feed(wire[5:]) == []
