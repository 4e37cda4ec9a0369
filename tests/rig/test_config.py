"""rig.toml: what it may say, and one message with file and field for what it may not."""

import pytest

from rig import load_config
from rig.errors import ConfigError

TEXT = """
name = "rig"
[holder]
sample_mm = 60.0
inner_mm = 76.0
outer_mm = 100.0
step_mm = 8.0
sample_depth_mm = 4.0
white_reflectance = 0.9
[board]
columns = 7
rows = 5
square_mm = 12.0
marker_mm = 9.0
[bus]
port = "/dev/bus"
[axes.arm]
module = 1
steps_per_deg = 100.0
min_deg = -90.0
max_deg = 90.0
forbidden_deg = [[-12.0, 12.0]]
speed_deg_s = 30.0
acceleration_deg_s2 = 60.0
[axes.turntable]
module = 3
steps_per_deg = 160.0
min_deg = -200.0
max_deg = 200.0
collision_deg = [[190.0, 195.0]]
speed_deg_s = 30.0
acceleration_deg_s2 = 60.0
[lamps]
port = "/dev/dmx"
[lamps.lamp.led]
channel = 9
mount = "arm"
elevation_deg = 0.0
distance_mm = 600.0
[cameras]
[laser]
port = "/dev/tower"
distance_mm = 800.0
elevations_deg = [35.0]
sweep_ticks = 480
ticks_per_s = 39.2
"""
BAD = {
    "zone upside down": ("[[-12.0, 12.0]]", "[[12.0, -12.0]]", r"\[axes.arm.forbidden_deg.0\].*from 12 to -12 deg"),
    "collision upside down": ("[[190.0, 195.0]]", "[[195.0, 190.0]]", r"\[axes.turntable.collision_deg.0\]"),
    "limits upside down": ("min_deg = -90.0", "min_deg = 100.0", r"\[axes.arm\].*min_deg 100 is above max_deg 90"),
    "two axes on one motor": ("module = 3", "module = 1", "axes arm and turntable are both motor 0 of module 1"),
    "no limit": ("max_deg = 90.0", "max_deg = inf", r"\[axes.arm.max_deg\]"),
    "endless speed": ("speed_deg_s = 30.0", "speed_deg_s = inf", r"\[axes.arm.speed_deg_s\]"),
    "standing laser": ("ticks_per_s = 39.2", "ticks_per_s = 0.0", r"\[laser.ticks_per_s\]"),
    "sweep of nothing": ("sweep_ticks = 480", "sweep_ticks = 0", r"\[laser.sweep_ticks\]"),
    "channel out of the universe": ("channel = 9", "channel = 513", r"\[lamps.lamp.led.channel\]"),
    "frame inside its opening": ("inner_mm = 76.0", "inner_mm = 59.0", r"\[holder\].*each be less than the next"),
    "margin without texels": ("step_mm = 8.0", "step_mm = 8.0\nmargin_mm = 30.0", r"\[holder\].*margin_mm"),
    "unknown field": ('name = "rig"', 'name = "rig"\ncolour = "red"', r"\[colour\]"),
    "missing field": ("module = 3\n", "", r"\[axes.turntable.module\]"),
    "not TOML": ("[holder]", "[holder", "not TOML"),
}


@pytest.fixture
def file(tmp_path):
    return tmp_path / "rig.toml"


def test_what_it_says_is_what_is_loaded(file):
    file.write_text(TEXT)
    config = load_config(file)
    assert config.axes["arm"].forbidden_deg == ((-12.0, 12.0),)
    assert config.bus.baudrate == 9600  # of the modules as delivered (TMCM-1110 firmware manual)


@pytest.mark.parametrize(("part", "changed", "says"), BAD.values(), ids=BAD.keys())
def test_a_rig_that_cannot_be_is_refused_by_field(file, part, changed, says):
    assert part in TEXT
    file.write_text(TEXT.replace(part, changed, 1))
    with pytest.raises(ConfigError, match=says) as caught:
        load_config(file)
    assert str(caught.value).startswith(f"{file}: ")
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_or_none_is_named(file):
    with pytest.raises(ConfigError, match=r"rig\.toml: no such file"):
        load_config(file)
    file.mkdir()
    with pytest.raises(ConfigError, match=r"rig\.toml: cannot be read"):
        load_config(file)
    file.with_name("bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match="not TOML"):
        load_config(file.with_name("bytes.toml"))
