import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.errors import FrameError
from rig.protocols import dmx

MESSAGES = st.builds(dmx.Message, st.integers(0, 255), st.binary(max_size=40))


@pytest.mark.vectors("dmx", "message")
def test_vectors_hold_both_ways(vector):
    decoded = vector["decoded"]
    message = dmx.decode(vector["wire"])
    assert message.label == decoded["label"]
    assert dmx.encode(message) == vector["wire"]
    if "data" in decoded:
        assert message.data == bytes.fromhex(decoded["data"])
    if "channels" in decoded:
        levels = decoded["levels_start"] + [0] * (decoded["channels"] - len(decoded["levels_start"]))
        assert dmx.output(levels) == message
    if "serial" in decoded:
        assert dmx.serial_number(message) == decoded["serial"]


@pytest.mark.vectors("dmx", "message")
def test_malformed_messages_are_refused(malformed):
    with pytest.raises(FrameError):
        dmx.decode(malformed["wire"])


def test_the_serial_request_is_that_of_the_specification():
    assert dmx.encode(dmx.serial_request()) == bytes.fromhex("7e 0a 00 00 e7")


def test_a_short_universe_is_filled_to_24_channels_behind_the_start_code():
    assert dmx.output([255]).data == b"\x00\xff" + bytes(23)


@pytest.mark.parametrize("levels", [[256], [-1], [0] * 513])
def test_impossible_levels_are_refused(levels):
    with pytest.raises(FrameError, match="512 channels of 0 to 255"):
        dmx.output(levels)


@pytest.mark.parametrize("data", [b"\x12\x34\x56", b"\x1a\x00\x00\x00"])
def test_what_is_no_serial_number_is_refused(data):
    """Three bytes, and a digit above nine."""
    with pytest.raises(FrameError, match="not a serial number"):
        dmx.serial_number(dmx.Message(dmx.Label.SERIAL_NUMBER, data))


def test_too_much_data_is_refused():
    with pytest.raises(FrameError, match="601 bytes"):
        dmx.encode(dmx.Message(6, bytes(601)))


@given(st.lists(MESSAGES, max_size=4), st.data())
@settings(max_examples=50, deadline=None)
def test_any_chunking_gives_the_same_messages(messages, data):
    stream = b"".join(map(dmx.encode, messages))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    reader = dmx.MessageReader()
    parts = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    assert [message for part in parts for message in reader.feed(part)] == messages


@given(st.binary(max_size=30).filter(lambda noise: 0x7E not in noise), MESSAGES)
@settings(max_examples=50, deadline=None)
def test_garbage_around_messages_is_skipped(noise, message):
    reader = dmx.MessageReader()
    wire = dmx.encode(message)
    assert reader.feed(noise + wire + noise + wire + noise) == [message, message]


def test_a_false_start_mark_does_not_swallow_the_message_behind_it():
    """Garbage that looks like a start and claims four bytes: its end mark is missing, so the search goes on."""
    serial = dmx.Message(10, b"\x78\x56\x34\x12")
    assert dmx.MessageReader().feed(b"\x7e\x06\x04\x00" + dmx.encode(serial)) == [serial]


def test_an_impossible_length_is_no_start():
    serial = dmx.Message(10, b"\x78\x56\x34\x12")
    assert dmx.MessageReader().feed(b"\x7e\x06\x59\x02" + dmx.encode(serial)) == [serial]


def test_clear_forgets_half_a_message():
    wire = dmx.encode(dmx.serial_request())
    reader = dmx.MessageReader()
    reader.feed(wire[:3])
    reader.clear()
    assert reader.feed(wire) == [dmx.serial_request()]
