"""DMXEnttecPro drives the lamps."""

import time

import pytest

DMXEnttecPro = pytest.importorskip("DMXEnttecPro", reason="DMXEnttecPro is not installed")


def lamps(rig, count):
    """The lit lamps, once so many are lit: the widget is one-way, its client does not learn of it."""
    deadline = time.monotonic() + 10
    while len(lit := rig.control("status")["lamps"]) != count and time.monotonic() < deadline:
        time.sleep(0.01)
    return lit


@pytest.mark.parametrize("size", [24, 512])
def test_channels_light_their_lamps(live_rig, size):
    controller = DMXEnttecPro.Controller(str(live_rig.state / "dmx"), dmx_size=size)
    try:
        controller.set_channel(1, 255)
        controller.set_channel(9, 51)
        controller.submit()
        assert lamps(live_rig, 2) == pytest.approx({"lamp0": 1.0, "led": 0.2})
        controller.clear_channels()
        controller.submit()
        assert lamps(live_rig, 0) == {}
    finally:
        controller.close()


def test_parameters_of_the_output_are_taken(live_rig):
    controller = DMXEnttecPro.Controller(str(live_rig.state / "dmx"))
    try:
        controller.set_dmx_parameters(output_break_time=20, mab_time=3, output_rate=30)
        controller.set_channel(2, 255, submit_after=True)
        assert lamps(live_rig, 1) == {"lamp1": 1.0}
    finally:
        controller.close()
