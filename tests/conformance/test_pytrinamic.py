"""pytrinamic, Trinamic's own client, drives the axes."""

import time

import pytest

connections = pytest.importorskip("pytrinamic.connections", reason="pytrinamic is not installed")
TMCM1110 = pytest.importorskip("pytrinamic.modules").TMCM1110
TMCLReplyStatusError = pytest.importorskip("pytrinamic.tmcl").TMCLReplyStatusError


@pytest.fixture
def connection(live_rig):
    port = live_rig.state / "bus"
    manager = connections.ConnectionManager(f"--interface serial_tmcl --port {port} --data-rate 9600")
    with manager.connect() as interface:
        interface.set_timeout(5)
        yield interface


def wait_until(condition, seconds=20.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "the axis did not get there"
        time.sleep(0.02)


def test_identity_of_each_module(connection):
    for module in (1, 2, 3):
        assert connection.get_version_string(module).startswith("1110V")


def test_move_to_position_and_back(connection, live_rig):
    motor = TMCM1110(connection, module_id=3).motors[0]
    motor.actual_position = 0
    motor.move_to(4800)
    wait_until(lambda: motor.actual_velocity != 0 or motor.get_position_reached())
    wait_until(motor.get_position_reached)
    assert motor.actual_position == 4800
    motor.move_by(-1600)
    wait_until(motor.get_position_reached)
    assert motor.actual_position == 3200
    assert live_rig.control("status")["axes"]["turntable"]["steps"] == 3200


def test_rotate_and_stop(connection):
    motor = TMCM1110(connection, module_id=1).motors[0]
    start = motor.actual_position
    motor.rotate(200)
    wait_until(lambda: motor.actual_velocity == 200)
    motor.stop()
    wait_until(lambda: motor.actual_velocity == 0)
    stands = motor.actual_position
    assert stands > start
    assert motor.actual_position == stands


def test_reference_search_finds_home(connection):
    connection.reference_search(0, 0, module_id=2)
    wait_until(lambda: connection.reference_search(2, 0, module_id=2) == 0)
    motor = TMCM1110(connection, module_id=2).motors[0]
    assert motor.actual_position == 0
    assert motor.get_axis_parameter(motor.AP.ReferenceSwitchStatus) == 1


def test_speed_of_the_ramp_is_a_parameter(connection):
    motor = TMCM1110(connection, module_id=1).motors[0]
    motor.linear_ramp.max_velocity = 500
    motor.linear_ramp.max_acceleration = 300
    assert motor.linear_ramp.max_velocity == 500
    assert motor.linear_ramp.max_acceleration == 300


@pytest.mark.parametrize(("parameter", "value", "status"), [(4, 5000, 4), (250, 1, 3)])
def test_refusals_arrive_as_status(connection, parameter, value, status):
    with pytest.raises(TMCLReplyStatusError) as refusal:
        connection.set_axis_parameter(parameter, 0, value, module_id=1)
    assert refusal.value.status_code == status


def test_absent_module_stays_silent(connection):
    connection.set_timeout(0.3)
    with pytest.raises(RuntimeError, match="timed out"):
        connection.get_version_string(9)


def test_late_reply_puts_an_unwary_client_one_behind(connection, live_rig):
    """pytrinamic does not match replies: after one that came too late each answer belongs to the request before."""
    module = TMCM1110(connection, module_id=1).motors[0]
    module.set_axis_parameter(module.AP.StandbyCurrent, 33)
    connection.set_timeout(0.3)
    live_rig.control("fault", device="bus", kind="stale")
    with pytest.raises(RuntimeError, match="timed out"):
        module.get_axis_parameter(module.AP.StandbyCurrent)
    assert module.get_axis_parameter(module.AP.PositionReachedFlag) == 33
