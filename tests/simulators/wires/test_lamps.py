import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.lamps import Widget


@pytest.fixture
def dmx(wire):
    return wire("dmx")


@pytest.fixture
def widget(dmx, world):
    return Widget(dmx.line, world.lamps)


def output(channels):
    data = bytes([0, *channels])
    return bytes([0x7E, 6, len(data) & 0xFF, len(data) >> 8]) + data + b"\xe7"


@pytest.mark.parametrize("name", ["output_full_universe", "output_24_channels"])
def test_real_messages_light_the_lamps(widget, world, vectors, layout, name):
    vector = vectors("dmx")[name]
    widget.receive(vector["wire"], 0.0)
    levels = vector["decoded"]["levels_start"]
    wanted = {
        lamp: levels[device.channel - 1] / 255
        for lamp, device in layout.lamps.items()
        if device.channel <= len(levels) and levels[device.channel - 1]
    }
    assert dict(world.lamps.lit()) == wanted
    assert wanted


@pytest.mark.parametrize(
    ("request_name", "reply_name"), [("parameters_request", "parameters_reply"), ("serial_request", "serial_reply")]
)
def test_replies_are_those_of_the_specification(widget, dmx, vectors, request_name, reply_name):
    widget.receive(vectors("dmx")[request_name]["wire"], 0.0)
    assert dmx.take() == vectors("dmx")[reply_name]["wire"]


@pytest.mark.parametrize(
    ("name", "text"), [("manufacturer_request", b"ENTTEC\0"), ("device_request", b"DMX USB PRO\0")]
)
def test_identity(widget, dmx, vectors, name, text):
    widget.receive(vectors("dmx")[name]["wire"], 0.0)
    reply = dmx.take()
    assert reply[1] == vectors("dmx")[name]["wire"][1]
    assert text in reply


@pytest.mark.parametrize("name", ["wrong_end", "too_long"])
def test_rubbish_is_skipped(widget, dmx, vectors, name):
    widget.receive(vectors("dmx")[name]["wire"] + vectors("dmx")["serial_request"]["wire"], 0.0)
    assert dmx.take() == vectors("dmx")["serial_reply"]["wire"]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(0, 255), min_size=24, max_size=40), st.data())
def test_messages_may_come_in_any_pieces(channels, data):
    class Lamps:
        universe = b""

    class Line:
        def request(self, length):
            return None

    lamps = Lamps()
    widget, message = Widget(Line(), lamps), output(channels)
    cut = data.draw(st.integers(0, len(message)))
    widget.receive(message[:cut], 0.0)
    widget.receive(message[cut:], 0.0)
    assert lamps.universe == bytes(channels)


def test_other_start_codes_and_short_universes_light_nothing(widget, world):
    widget.receive(bytes([0x7E, 6, 25, 0, 0xCC]) + bytes([255] * 24) + b"\xe7", 0.0)
    widget.receive(bytes([0x7E, 6, 24, 0, 0]) + bytes([255] * 23) + b"\xe7", 0.0)
    assert world.lamps.lit() == ()


def test_timing_parameters_are_kept(widget, dmx):
    widget.receive(bytes.fromhex("7e 04 05 00 00 00 14 03 1e e7"), 0.0)
    widget.receive(bytes.fromhex("7e 03 02 00 00 00 e7"), 0.0)
    assert dmx.take()[6:9] == bytes([0x14, 0x03, 0x1E])


def test_dead_lamp_stays_dark_from_its_time_on(widget, world, faults, clock):
    widget.receive(output([255] * 24), 0.0)
    faults.add({"device": "lamp3", "kind": "dead_lamp", "at_time_s": 5.0})
    assert "lamp3" in dict(world.lamps.lit())
    clock.advance(5.0)
    assert set(world.layout.lamps) - set(dict(world.lamps.lit())) == {"lamp3"}
    faults.clear()
    assert "lamp3" in dict(world.lamps.lit())


def test_lost_message_leaves_the_light_as_it_was(widget, world, faults):
    faults.add({"device": "dmx", "kind": "lose"})
    widget.receive(output([255] * 24), 0.0)
    assert world.lamps.lit() == ()
    widget.receive(output([255] * 24), 0.0)
    assert len(world.lamps.lit()) == 9
