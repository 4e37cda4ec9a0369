from math import degrees, radians

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.config import load_config
from simulators.layout import build_layout, direction, rotation
from simulators.phone import build_phone
from simulators.rig_file import rig_toml

LAYOUT = build_layout(1, "small")
ANGLES = st.floats(-3.1, 3.1)


@pytest.mark.parametrize("size", ["small", "full"])
def test_rig_toml_is_what_the_rig_reads(tmp_path, size):
    layout = build_layout(3, size)
    addresses = {name: f"127.0.0.1:{4000 + i}" for i, name in enumerate((*layout.cameras, "phone"))}
    file = tmp_path / "rig.toml"
    serial = {"bus": 'a "bus" \\ port', "dmx": "dmx", "tower": "tower"}
    text = rig_toml(layout, build_phone(3, size), serial=serial, cameras=addresses, clock="127.0.0.1:5000")
    file.write_text(text, encoding="utf-8")
    config = load_config(file)
    assert {name: camera.address for name, camera in config.cameras.items()} == addresses
    assert config.axes["light_arc"].forbidden_deg == ((-12.0, 12.0),)
    assert config.cameras["front"].serial == "DS-0001"
    assert [lamp.elevation_deg for lamp in config.lamps.lamp.values()] == [10, 20, 30, 40, 50, 60, 70, 80, 0]
    assert config.holder.white_reflectance == layout.holder.albedo
    assert config.bus.port == 'a "bus" \\ port'
    assert config.laser is not None
    assert config.laser.elevations_deg == (20, 35, 50, 65, 75)
    assert config.clock is not None


def test_unknown_size_is_refused():
    with pytest.raises(ValueError, match="huge"):
        build_layout(1, "huge")


def test_true_cameras_are_near_nominal_and_differ_between_seeds():
    for camera in LAYOUT.cameras.values():
        nominal = camera.distance_m * direction(0.0, camera.elevation_rad)
        place, axis = camera.rig_from_camera[:3, 3], camera.rig_from_camera[:3, 2]
        assert 0 < np.linalg.norm(place - nominal) <= 0.002
        assert degrees(np.arccos(min(1.0, axis @ -direction(0.0, camera.elevation_rad)))) <= 0.3
        turn = camera.rig_from_camera[:3, :3]
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(turn) > 0
    other = build_layout(2, "small").cameras["cam3"].rig_from_camera
    assert not np.allclose(other, LAYOUT.cameras["cam3"].rig_from_camera)


@given(ANGLES, ANGLES)
def test_lamps_follow_their_own_carrier(arc_rad, arm_rad):
    """Turning the carrier turns the lamp about the rig's axis, and the other's carrier leaves it where it is."""
    for name, turn_rad in (("lamp2", arc_rad), ("led", arm_rad)):
        turned, start = LAYOUT.lamp_position(name, arc_rad, arm_rad), LAYOUT.lamp_position(name, 0.0, 0.0)
        np.testing.assert_allclose(turned, rotation(np.array([0, 0, turn_rad])) @ start, atol=1e-12)


@pytest.mark.parametrize("name", LAYOUT.lamps)
def test_true_lamps_are_near_nominal_and_differ_between_seeds(name):
    lamp, true = LAYOUT.lamps[name], LAYOUT.lamp_position(name, 0.0, 0.0)
    away_m = np.linalg.norm(true)
    assert 0 < degrees(np.arccos(true / away_m @ direction(0.0, lamp.elevation_rad))) <= 0.5
    assert 0 < abs(away_m - lamp.distance_m) <= 0.005
    assert 0.87 < min(lamp.gains) <= max(lamp.gains) < 1.13
    assert max(lamp.gains) / min(lamp.gains) < 1.042
    assert not np.allclose(build_layout(2, "small").lamp_position(name, 0.0, 0.0), true)


@given(ANGLES, st.sampled_from(LAYOUT.laser.elevations_deg), st.floats(0, 480))
def test_fan_plane_holds_source_and_a_trace_square_to_the_azimuth(arc_rad, elevation_deg, ticks):
    laser, elevation_rad = LAYOUT.laser, radians(elevation_deg)
    normal, offset = laser.plane(arc_rad, elevation_rad, laser.fan_rad(ticks, elevation_rad))
    assert np.linalg.norm(normal) == pytest.approx(1)
    assert normal @ laser.source(arc_rad, elevation_rad) == pytest.approx(offset)
    assert normal @ direction(arc_rad + np.pi / 2, 0.0) == pytest.approx(0, abs=1e-12)
    trace_m = offset / (normal @ direction(arc_rad, 0.0))
    assert abs(trace_m) <= 0.052 + 1e-9


def test_every_mounting_is_off_by_its_own_amount_and_those_of_old_rigs_as_before():
    laser = LAYOUT.laser
    turns_rad, shifts_m = np.array(laser.offsets).T
    assert len(set(laser.offsets)) == len(laser.elevations_deg) == 5
    assert np.all(np.abs(turns_rad) <= radians(0.3))
    assert np.all(np.abs(shifts_m) <= 0.002)
    two = np.random.default_rng([1, 3]).uniform(-1, 1, (2, 2)) * (radians(0.3), 0.002)
    for elevation_deg, (turn_rad, shift_m) in zip((35.0, 50.0), two, strict=True):
        true_rad, distance_m = laser.mounting(radians(elevation_deg))
        assert true_rad == radians(elevation_deg) + turn_rad
        assert distance_m == 0.8 + shift_m


@pytest.mark.parametrize(("ticks", "trace_m"), [(0, -0.052), (480, 0.052)])
@pytest.mark.parametrize("elevation_deg", LAYOUT.laser.elevations_deg)
def test_sweep_runs_from_end_to_end(ticks, trace_m, elevation_deg):
    laser, elevation_rad = LAYOUT.laser, radians(elevation_deg)
    normal, offset = laser.plane(0.0, elevation_rad, laser.fan_rad(ticks, elevation_rad))
    assert offset / normal[0] == pytest.approx(trace_m)


@pytest.mark.parametrize("seed", range(5))
def test_a_hand_puts_the_board_nearly_on_the_axis(seed):
    board = build_layout(seed, "small").rig_from_board(0)
    assert 0.02 <= degrees(np.arccos(board[2, 2])) <= 0.1
    assert abs(degrees(np.arctan2(board[1, 0], board[0, 0]))) <= 0.2
    assert 1e-4 <= np.linalg.norm(board[:2, 3]) <= 3e-4
    assert board[2, 3] == 0  # it lies on the reference plane


def test_board_poses_tilt_up_to_thirty_degrees():
    tilts_deg = [degrees(np.arccos(LAYOUT.rig_from_board(k)[2, 2])) for k in range(1, 12)]
    assert 10 < min(tilts_deg)
    assert max(tilts_deg) <= 30
