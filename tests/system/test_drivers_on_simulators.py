"""The drivers against the simulators: two programs that share no code and meet on the wires."""

from math import degrees, radians

import pytest

from rig import load_config, open_rig
from rig.drivers import bus, lamps, laser_unit
from rig.errors import DeviceError, FrameCheckError, ReadTimeoutError, TransportError

SWEEP_FRAMES = 8


@pytest.fixture(autouse=True)
def short_timeouts(monkeypatch):
    """The simulators answer within milliseconds or not at all."""
    for module in (bus, lamps, laser_unit):
        monkeypatch.setattr(module, "_REPLY_TIMEOUT_S", 0.4)


@pytest.fixture
def lab(shared_simulated_rig):
    """The running simulators with whatever broke in the test before mended."""
    shared_simulated_rig.control("clear_faults")
    yield shared_simulated_rig
    shared_simulated_rig.control("clear_faults")


@pytest.fixture
def rig(lab):
    with open_rig(load_config(lab.toml)) as rig:
        yield rig


def status(lab):
    return lab.control("status")


def test_each_axis_homes_moves_and_reads_back(lab, rig):
    """The driver's steps, the module's counter and the mechanics agree; repeatability is better than 0.02 deg."""
    for name, angle_deg in (("arm", -30.0), ("light_arc", 45.0), ("turntable", 90.0)):
        axis = rig.axes[name]
        axis.home()
        assert axis.angle_rad() == pytest.approx(0.0, abs=radians(0.1))
        axis.move_to(radians(angle_deg))
        axis.wait()
        assert degrees(axis.angle_rad()) == pytest.approx(angle_deg, abs=0.01)
        stands = status(lab)["axes"][name]
        assert stands["deg"] == pytest.approx(angle_deg, abs=0.02)
        assert not stands["moving"]


def test_a_move_takes_as_long_as_forecast(rig):
    """The ramps agree to 1 %; each of the four messages of a move takes 19 ms on the bus at 9600 baud."""
    axis = rig.axes["turntable"]
    axis.home()
    started_s = rig.clock.now_s()
    axis.move_to(radians(60.0))
    axis.wait()
    took_s, forecast_s = rig.clock.now_s() - started_s, axis.move_time_s(0.0, radians(60.0))
    assert 0.99 * forecast_s <= took_s <= 1.01 * forecast_s + 0.1


def test_moves_of_different_axes_overlap(rig):
    for axis in rig.axes.values():
        axis.home()
    started_s = rig.clock.now_s()
    for axis in rig.axes.values():
        axis.move_to(radians(60.0))
    for axis in rig.axes.values():
        axis.wait()
    slowest_s = max(axis.move_time_s(0.0, radians(60.0)) for axis in rig.axes.values())
    assert rig.clock.now_s() - started_s < 1.2 * slowest_s


def test_lamps_light_and_go_dark(lab, rig):
    rig.lamps.light({"lamp3": 1.0, "led": 0.5})
    lit = status(lab)["lamps"]
    assert lit["lamp3"] == pytest.approx(1.0)
    assert lit["led"] == pytest.approx(0.5, abs=1 / 255)
    assert set(lit) == {"lamp3", "led"}
    rig.lamps.off()
    assert not any(status(lab)["lamps"].values())


def test_a_camera_delivers_its_own_frame_at_the_exposure_asked_for(lab, rig):
    lab.control("mount", sample="white")
    camera = rig.cameras["cam2"]
    for exposure_s in (0.0333, 0.1):
        camera.expose(exposure_s)
        (frame,) = camera.fetch()
        assert frame.serial == "VC-0002"
        assert frame.exposure_s == pytest.approx(exposure_s)
        assert frame.data[:4] == b"II*\0"


def test_cameras_expose_together(lab, rig):
    lab.control("mount", sample="white")
    cameras = [rig.cameras["cam0"], rig.cameras["cam1"], rig.cameras["cam2"]]
    started_s = rig.clock.now_s()
    for camera in cameras:
        camera.expose(1.0)
    assert [camera.fetch()[0].serial for camera in cameras] == ["VC-0000", "VC-0001", "VC-0002"]
    assert rig.clock.now_s() - started_s < 1.5, "not one after the other"


def test_a_sweep_runs_under_a_burst_and_comes_back(lab, rig):
    lab.control("mount", sample="white")
    camera, laser = rig.cameras["cam0"], rig.laser
    laser.rewind()
    start = status(lab)["motor"]["ticks"]
    laser.start_sweep()
    assert status(lab)["laser"]
    assert status(lab)["motor"]["running"]
    camera.expose(0.02, frames=SWEEP_FRAMES, interval_s=1 / 7.5)
    frames = camera.fetch()
    laser.stop()
    after = status(lab)
    assert [frame.index for frame in frames] == list(range(SWEEP_FRAMES))
    assert len({frame.data for frame in frames}) == SWEEP_FRAMES, "the stripe moved between the frames"
    assert not after["laser"]
    assert not after["motor"]["running"]
    assert after["motor"]["ticks"] > start + 0.8 * 39.2 * SWEEP_FRAMES / 7.5
    laser.rewind()
    assert abs(status(lab)["motor"]["ticks"] - start) < 16, "within one turn of the start"


def test_making_safe_leaves_everything_dark_and_still(lab, rig):
    lab.control("mount", sample="white")
    for axis in rig.axes.values():
        axis.home()
    rig.lamps.light({"lamp0": 1.0})
    rig.laser.start_sweep()
    rig.cameras["cam0"].expose(5.0)
    for axis in rig.axes.values():
        axis.move_to(radians(80.0))
    rig.clock.sleep(0.5)
    assert rig.make_safe() == []
    stands = status(lab)
    assert not any(stands["lamps"].values())
    assert not stands["laser"]
    assert not stands["motor"]["running"]
    assert not any(axis["moving"] for axis in stands["axes"].values())


def test_a_rig_that_a_crash_left_lit_and_moving_is_dark_and_still_once_opened(lab):
    config = load_config(lab.toml)
    crashed = open_rig(config)
    crashed.axes["turntable"].home()
    crashed.lamps.light({"lamp0": 1.0})
    crashed.laser.start_sweep()
    crashed.axes["turntable"].move_to(radians(170.0))
    for closer in crashed.closers:
        closer.close()
    assert status(lab)["laser"]
    with open_rig(config) as rig:
        stands = status(lab)
        assert not any(stands["lamps"].values())
        assert not stands["laser"]
        assert not any(axis["moving"] for axis in stands["axes"].values())
        rig.laser.rewind()
        assert abs(status(lab)["motor"]["ticks"]) < 16


@pytest.mark.parametrize("kind", ["lose", "drop", "stale", "duplicate", "corrupt", "truncate"])
@pytest.mark.parametrize("wire", ["bus", "dmx", "tower"])
def test_one_bad_message_on_a_serial_wire_changes_nothing(lab, rig, wire, kind):
    axis = rig.axes["arm"]
    axis.home()
    lab.control("fault", device=wire, kind=kind)
    axis.move_to(radians(10.0))
    rig.lamps.light({"lamp1": 1.0})
    rig.laser.start_sweep()
    axis.wait()
    assert degrees(axis.angle_rad()) == pytest.approx(10.0, abs=0.01)
    stands = status(lab)
    assert stands["lamps"] == {"lamp1": 1.0}
    assert stands["laser"]
    assert [fault["struck"] for fault in lab.control("faults")["faults"]] == [1]
    rig.laser.stop()
    rig.laser.rewind()


def test_a_busy_camera_and_a_cut_download_cost_a_repetition(lab, rig):
    lab.control("mount", sample="white")
    camera = rig.cameras["cam0"]
    lab.control("fault", device="cam0", kind="busy")
    camera.expose(0.1)
    lab.control("fault", device="cam0", kind="truncate")
    (frame,) = camera.fetch()
    assert frame.serial == "VC-0000"
    assert [fault["struck"] for fault in lab.control("faults")["faults"]] == [1, 1]


def test_a_stall_is_told_and_homing_mends_it(lab, rig):
    axis = rig.axes["arm"]
    axis.home()
    lab.control("fault", device="arm", kind="stall")
    axis.move_to(radians(60.0))
    with pytest.raises(DeviceError, match="arm: stalled at 30"):
        axis.wait()
    axis.home()
    axis.move_to(radians(60.0))
    axis.wait()
    assert degrees(axis.angle_rad()) == pytest.approx(60.0, abs=0.01)


def test_a_frame_of_the_wrong_camera_is_refused_and_the_next_one_is_good(lab, rig):
    lab.control("mount", sample="white")
    camera = rig.cameras["cam0"]
    lab.control("fault", device="cam0", kind="wrong_camera", other="cam1")
    camera.expose(0.1)
    with pytest.raises(FrameCheckError, match="expected serial VC-0000, frame carries VC-0001"):
        camera.fetch()
    camera.expose(0.1)
    assert camera.fetch()[0].serial == "VC-0000"


def test_a_frame_that_never_comes_is_a_timeout_and_the_next_one_is_good(lab, rig):
    lab.control("mount", sample="white")
    camera = rig.cameras["cam0"]
    lab.control("fault", device="cam0", kind="no_frame")
    camera.expose(0.1)
    with pytest.raises(ReadTimeoutError, match="0 of 1 frames"):
        camera.fetch()
    camera.expose(0.1)
    assert len(camera.fetch()) == 1


def test_an_unplugged_bus_is_told_and_works_again_once_plugged_in(lab, rig):
    axis = rig.axes["arm"]
    axis.home()
    lab.control("fault", device="bus", kind="unplug", seconds=1.0)
    with pytest.raises(TransportError, match="bus: lost"):
        axis.move_to(radians(10.0))
    rig.clock.sleep(2.0)
    axis.home()
    axis.move_to(radians(10.0))
    axis.wait()
    assert degrees(axis.angle_rad()) == pytest.approx(10.0, abs=0.01)
