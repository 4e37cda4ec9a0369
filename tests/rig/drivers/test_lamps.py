"""The lamp driver against a scripted ENTTEC widget: 7E, label, length, data, E7 (vectors/dmx.toml)."""

import pytest

from rig.config import LampConfig, LampsConfig
from rig.drivers.lamps import EnttecLamps
from rig.errors import ConfigError, FrameError, LimitError, ReadTimeoutError, ReplyError, UnknownDeviceError
from tests.rig.drivers.peers import cut_enttec

SERIAL_REPLY = bytes.fromhex("7e 0a 04 00 78 56 34 12 e7")
OTHER_SERIAL_REPLY = bytes.fromhex("7e 0a 04 00 79 56 34 12 e7")


class Widget:
    """Answers label 10; keeps the universe of label 6. `faults` holds what becomes of the replies to come."""

    def __init__(self):
        self.universe = None
        self.faults = []

    def answer(self, message):
        if message[1] == 6:
            self.universe = message[4:-1]
            return b""
        assert message == bytes.fromhex("7e 0a 00 00 e7")
        return self.faults.pop(0) if self.faults else SERIAL_REPLY


def config(port, **channels):
    lamp = {
        name: LampConfig(channel=channel, mount="light_arc", elevation_deg=10.0, distance_mm=900.0)
        for name, channel in channels.items()
    }
    return LampsConfig(port=port, lamp=lamp)


@pytest.fixture
def widget():
    return Widget()


@pytest.fixture
def wire(pty_peer, widget):
    return pty_peer(cut_enttec, widget.answer)


@pytest.fixture
def lamps(wire, clock):
    lamps = EnttecLamps(config(wire.port, led=9, lamp0=1, lamp2=3), clock)
    lamps.open()
    yield lamps
    lamps.close()


def test_lamps_are_named_in_channel_order(lamps):
    assert lamps.names == ("lamp0", "lamp2", "led")


def test_opening_leaves_all_lamps_dark(lamps, widget):
    assert widget.universe == bytes(25)


def test_levels_reach_their_channels_behind_the_start_code_and_all_others_go_dark(lamps, widget):
    lamps.light({"lamp0": 1.0, "led": 0.5})
    assert widget.universe == b"\x00\xff" + bytes(7) + b"\x80" + bytes(15)
    lamps.light({"lamp2": 1.0})
    assert widget.universe == bytes(3) + b"\xff" + bytes(21)
    lamps.off()
    assert widget.universe == bytes(25)


@pytest.mark.parametrize("level", [-0.1, 1.1, float("nan")])
def test_an_impossible_level_lights_nothing(lamps, widget, level):
    with pytest.raises(LimitError, match=r"lamp led: level .* nothing was lit"):
        lamps.light({"lamp0": 1.0, "led": level})
    assert widget.universe == bytes(25)


def test_an_unknown_lamp_lists_the_known_ones(lamps, widget):
    with pytest.raises(UnknownDeviceError, match=r"no lamp 'lamp9' .*lamp0, lamp2, led"):
        lamps.light({"lamp9": 1.0})
    assert widget.universe == bytes(25)


def test_levels_are_sent_twice_because_nothing_tells_a_message_that_got_lost(lamps, wire):
    lamps.light({"lamp0": 1.0})
    first, second, question = wire.requests[-3:]
    assert first == second
    assert question[1] == 10


def test_levels_count_as_taken_only_once_the_widget_has_answered(lamps, widget):
    """It works in order, so silence behind the levels leaves it open whether it took them."""
    widget.faults = 3 * [b""]
    with pytest.raises(ReadTimeoutError, match="lamps: no reply to the lamps' levels"):
        lamps.off()


def test_a_lost_answer_makes_the_levels_travel_again(lamps, wire, widget):
    widget.faults = [b""]
    lamps.light({"lamp0": 1.0})
    assert [request[1] for request in wire.requests[-6:]] == 2 * [6, 6, 10]
    assert widget.universe[1] == 255


def test_damaged_answers_are_told_with_their_bytes(lamps, widget):
    widget.faults = 3 * [SERIAL_REPLY[:-1] + b"\x00"]
    with pytest.raises(FrameError, match="< 7e 0a 04 00 78 56 34 12 00"):
        lamps.off()


def test_another_widget_on_the_cable_is_told(lamps, widget):
    widget.faults = [OTHER_SERIAL_REPLY]
    with pytest.raises(ReplyError, match="widget 12345679 answers where 12345678 was"):
        lamps.off()


def test_two_lamps_on_one_channel_are_refused(wire, clock):
    with pytest.raises(ConfigError, match="share a DMX channel"):
        EnttecLamps(config(wire.port, a=1, b=1), clock)
