"""Making a rig safe: every device is told, whatever another one does."""

import signal

import pytest

from rig.errors import ReadTimeoutError
from tests.rig.sessions.fake_rig import fake_rig

ORDERS = {
    "lamps off": "lamps",
    "laser stop": "laser",
    **{f"stop {name}": name for name in ("arm", "light_arc", "turntable")},
    **{f"abort {name}": name for name in ("cam0", "cam1", "front", "phone")},
}


@pytest.fixture
def lit():
    """A rig that shines, sweeps, moves and exposes."""
    rig, world = fake_rig()
    for axis in rig.axes.values():
        axis.home()
        axis.move_to(1.0)
    rig.lamps.light({"lamp0": 1.0})
    rig.laser.start_sweep()
    for camera in rig.cameras.values():
        camera.pending = (1.0, 1, 0.0, world.time_s, True)
    world.commands.clear()
    return rig, world


def failing(order, error):
    def act(name):
        if name == order:
            raise error

    return act


@pytest.mark.parametrize("error", [ReadTimeoutError("no answer"), OSError("gone"), ZeroDivisionError("a mistake")])
@pytest.mark.parametrize("order", ORDERS)
def test_one_device_that_fails_keeps_no_other_from_being_made_safe(lit, order, error):
    rig, world = lit
    world.on_command = failing(order, error)
    assert rig.make_safe() == [f"{ORDERS[order]}: unconfirmed ({error})"]
    assert world.commands == list(ORDERS), "all of them, light sources first"
    assert (world.lamps == {}) == (order != "lamps off")
    assert world.laser_on == (order == "laser stop")
    assert [axis.name for axis in rig.axes.values() if axis.name in world.moving(rig.axes.values())] == (
        [ORDERS[order]] if order.startswith("stop") else []
    )


def test_all_that_fail_are_told(lit):
    rig, world = lit
    world.on_command = lambda name: failing(name, OSError("gone"))(name)
    assert rig.make_safe() == [f"{device}: unconfirmed (gone)" for device in ORDERS.values()]
    assert world.commands == list(ORDERS)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("order", ORDERS)
def test_a_signal_waits_until_all_is_dark_and_still(lit, order, number):
    """As a second Ctrl-C does, pressed because the first seemed to do nothing."""
    rig, world = lit
    world.on_command = lambda name: signal.raise_signal(number) if name == order else None

    def interrupt(*_):
        raise KeyboardInterrupt

    before = signal.signal(number, interrupt)
    try:
        with pytest.raises(KeyboardInterrupt):
            rig.make_safe()
        assert signal.getsignal(number) is interrupt
    finally:
        signal.signal(number, before)
    assert world.commands == list(ORDERS)


def test_leaving_a_rig_logs_what_could_not_be_confirmed(lit, caplog):
    """Whoever leaves the context has no return value to look at."""
    rig, world = lit
    with rig:
        world.on_command = failing("laser stop", ReadTimeoutError("no answer"))
    assert caplog.messages == ["laser: unconfirmed (no answer)"]
