"""A rig in memory with a clock of its own: light, fast, and strict about what must never happen.

It notes in `offences` every exposure during a motion, every axis that is sent elsewhere on its way, and every use of a
device from a second thread.
"""

import hashlib
import threading
from dataclasses import dataclass, field
from math import degrees

import numpy as np

from rig.config import RigConfig
from rig.devices import FileFormat, RawFrame, Rig
from rig.errors import LimitError, StateError
from tests.reference.dng import dng
from tests.reference.jpeg import jpeg

SIZE = (24, 32)
BLACK, WHITE, READ_NOISE = 256, 4095, 2.0


def config(**changes) -> RigConfig:
    """A small rig.toml: three axes, three lamps, three cameras, a laser."""
    axis = {"steps_per_deg": 100.0, "speed_deg_s": 30.0, "acceleration_deg_s2": 60.0}
    camera = {"address": "127.0.0.1:1", "distance_mm": 1000.0, "frame_megabytes": 0.002}
    data = {
        "name": "fake rig",
        "holder": {"sample_mm": 60, "inner_mm": 76, "outer_mm": 100, "step_mm": 8, "sample_depth_mm": 4,
                   "white_reflectance": 0.9},
        "board": {"columns": 7, "rows": 5, "square_mm": 12, "marker_mm": 9},
        "bus": {"port": "/fake/bus"},
        "axes": {
            "arm": {"module": 1, "min_deg": -90, "max_deg": 90, **axis},
            "light_arc": {"module": 2, "min_deg": -180, "max_deg": 180, "forbidden_deg": [[-12, 12]], **axis},
            "turntable": {"module": 3, "min_deg": -200, "max_deg": 200, **axis},
        },
        "lamps": {"port": "/fake/dmx", "lamp": {
            "led": {"channel": 9, "mount": "arm", "elevation_deg": 0, "distance_mm": 600},
            "lamp0": {"channel": 1, "mount": "light_arc", "elevation_deg": 30, "distance_mm": 900},
            "lamp1": {"channel": 2, "mount": "light_arc", "elevation_deg": 60, "distance_mm": 900},
        }},
        "cameras": {
            "cam0": {"serial": "VC-0000", "mount": "camera_arc", "elevation_deg": 40, **camera},
            "cam1": {"serial": "VC-0001", "mount": "camera_arc", "elevation_deg": 70, **camera},
            "front": {"serial": "DS-0001", "mount": "front", "elevation_deg": 0, **camera},
            "phone": {"address": "127.0.0.1:1", "serial": "PH-0001", "mount": "hand", "field_deg": 190},
        },
        "laser": {"port": "/fake/tower", "distance_mm": 800, "elevations_deg": [35, 50], "sweep_ticks": 20,
                  "ticks_per_s": 40},
    }  # fmt: skip
    return RigConfig.model_validate({**data, **changes})


@dataclass
class World:
    """What the fake devices share. `on_command` is called before every device command with its name."""

    time_s: float = 0.0
    lamps: dict[str, float] = field(default_factory=dict)
    laser_on: bool = False
    commands: list[str] = field(default_factory=list)
    offences: list[str] = field(default_factory=list)
    exposures: list[tuple] = field(default_factory=list)
    on_command: object = lambda name: None
    dead_lamps: set[str] = field(default_factory=set)
    laser_dn_s: float = 4000.0  # of the stripe, which is half of the picture or less, and moves on from frame to frame
    room_dn: float = 0.0
    thread: int | None = None
    _inside: bool = False

    def command(self, name):
        thread = threading.get_ident()
        if self.thread is not None and self.thread != thread:
            self.offences.append(f"{name} from a second thread")
        self.thread = thread
        self.commands.append(name)
        self.on_command(name)

    def moving(self, axes):
        return [axis.name for axis in axes if axis.arrives_s > self.time_s + 1e-9]


class FakeClock:
    def __init__(self, world):
        self.world = world

    def now_s(self):
        return self.world.time_s

    def sleep(self, seconds):
        assert seconds >= 0
        self.world.time_s += seconds


class FakeAxis:
    def __init__(self, name, settings, world):
        self.name, self.settings, self.world = name, settings, world
        self.homed, self.target_rad, self.arrives_s = False, 0.0, 0.0

    def home(self):
        self.world.command(f"home {self.name}")
        self.world.time_s += 1.0
        self.homed, self.target_rad, self.arrives_s = True, 0.0, self.world.time_s

    def check(self, angle_rad):
        if not self.settings.min_deg - 1e-6 <= degrees(angle_rad) <= self.settings.max_deg + 1e-6:
            raise LimitError(f"{self.name}: {degrees(angle_rad):g} deg is outside")

    def move_to(self, angle_rad):
        self.world.command(f"move {self.name}")
        if not self.homed:
            raise StateError(f"{self.name} is not homed")
        self.check(angle_rad)
        if self.arrives_s > self.world.time_s + 1e-9:
            self.world.offences.append(f"{self.name} was sent elsewhere on its way")
        self.arrives_s = self.world.time_s + self.move_time_s(self.target_rad, angle_rad)
        self.target_rad = angle_rad

    def wait(self):
        self.world.command(f"wait {self.name}")
        self.world.time_s = max(self.world.time_s, self.arrives_s)

    def angle_rad(self):
        return self.target_rad

    def stop(self):
        self.world.command(f"stop {self.name}")
        self.arrives_s = self.world.time_s

    def move_time_s(self, from_rad, to_rad):
        distance = degrees(abs(to_rad - from_rad))
        ramps = self.settings.speed_deg_s**2 / self.settings.acceleration_deg_s2
        if distance < 1e-6:
            return 0.0
        if distance < ramps:
            return 2 * (distance / self.settings.acceleration_deg_s2) ** 0.5 + self.settings.settle_s
        ramp_s = self.settings.speed_deg_s / self.settings.acceleration_deg_s2
        return distance / self.settings.speed_deg_s + ramp_s + self.settings.settle_s


class FakeLamps:
    def __init__(self, names, world):
        self.names, self.world = tuple(names), world

    def light(self, levels):
        self.world.command("light " + "+".join(sorted(levels)))
        self.world.lamps = {name: level for name, level in levels.items() if level > 0}

    def off(self):
        self.world.command("lamps off")
        self.world.lamps = {}


class FakeCamera:
    def __init__(self, name, settings, world, axes):
        self.name, self.settings, self.world, self.axes = name, settings, world, axes
        self.serial = settings.serial
        self.pending = None
        self.spoil = []  # functions of a list of frames, one used up per fetch

    def expose(self, exposure_s, *, frames=1, interval_s=0.0, file_format=FileFormat.RAW):
        self.world.command(f"expose {self.name}")
        if self.world.moving(self.axes):
            self.world.offences.append(f"{self.name} exposed while {self.world.moving(self.axes)} moved")
        lit = [name for name in self.world.lamps if name not in self.world.dead_lamps]
        angles = tuple(round(degrees(axis.target_rad), 3) for axis in self.axes)
        self.world.exposures += [(self.name, angles, tuple(lit), exposure_s, index) for index in range(frames)]
        light = (4000.0 if lit else 0.0, self.world.laser_dn_s if self.world.laser_on else 0.0)
        self.pending = (exposure_s, frames, interval_s, self.world.time_s, light)
        self.file_format = file_format

    def fetch(self):
        self.world.command(f"fetch {self.name}")
        exposure_s, count, interval_s, start_s, light = self.pending
        self.pending = None
        end_s = start_s + (count - 1) * interval_s + exposure_s
        self.world.time_s = max(self.world.time_s, end_s) + self.transfer_time_s(count)
        times_s = [start_s + index * interval_s for index in range(count)]
        frames = [self._frame(index, exposure_s, time_s, light, count) for index, time_s in enumerate(times_s)]
        for spoil in self.spoil[:1]:
            frames = spoil(frames)
        self.spoil = self.spoil[1:]
        return frames

    def _frame(self, index, exposure_s, taken_s, light, count):
        lamps_dn_s, laser_dn_s = light
        level = np.full(SIZE, self.world.room_dn + min(3000.0, lamps_dn_s * exposure_s))
        stripe = slice(index * SIZE[1] // count, (index + 1) * SIZE[1] // count)
        level[:, stripe] += laser_dn_s * exposure_s
        key = repr((self.serial, len(self.world.exposures), index))
        rng = np.random.default_rng(int.from_bytes(hashlib.sha256(key.encode()).digest()[:8], "big"))
        mosaic = np.clip(rng.normal(BLACK + level, READ_NOISE), 0, WHITE).astype(np.uint16)
        if self.file_format is FileFormat.JPEG:
            data = jpeg(mosaic // 16, exposure_s=exposure_s, serial=self.serial)
            return RawFrame(self.name, self.serial, data, exposure_s, index, taken_s, 100.0, FileFormat.JPEG)
        profile = (1e-4, (READ_NOISE / (WHITE - BLACK)) ** 2)
        data = dng(mosaic, exposure_s=exposure_s, serial=self.serial, noise_profile=profile)
        return RawFrame(self.name, self.serial, data, exposure_s, index, taken_s)

    def abort(self):
        self.world.command(f"abort {self.name}")
        self.pending = None

    def transfer_time_s(self, frames):
        return frames * self.settings.frame_megabytes / self.settings.megabytes_per_s


class FakeLaser:
    def __init__(self, world):
        self.world = world

    def rewind(self):
        self.world.command("laser rewind")
        self.world.laser_on = False
        self.world.time_s += 0.5

    def start_sweep(self):
        self.world.command("laser sweep")
        self.world.laser_on = True

    def stop(self):
        self.world.command("laser stop")
        self.world.laser_on = False

    def end_sweep(self):
        self.stop()

    def sweep_time_s(self):
        return 0.5


def fake_rig(settings=None, world=None):
    """The rig and its world."""
    settings, world = settings or config(), world or World()
    axes = {name: FakeAxis(name, axis, world) for name, axis in settings.axes.items()}
    cameras = {name: FakeCamera(name, camera, world, list(axes.values())) for name, camera in settings.cameras.items()}
    laser = FakeLaser(world) if settings.laser else None
    lamps = FakeLamps(settings.lamps.lamp, world)
    return Rig(settings.name, FakeClock(world), axes, lamps, cameras, laser, ()), world


def is_safe(rig, world):
    """Dark and still."""
    still = not world.moving(rig.axes.values())
    return not world.lamps and not world.laser_on and still


BTF = {
    "kind": "btf", "turntable_deg": [0, 90], "light_azimuth_deg": [45, 135], "lamps": ["lamp0", "lamp1"],
    "cameras": ["cam0", "cam1"], "exposures_s": [0.05, 0.2], "texels": 16,
}  # fmt: skip
MDF = {
    "kind": "mdf", "turntable_deg": [0], "laser_azimuth_deg": [45, -45], "laser_elevations_deg": [50, 35],
    "cameras": ["cam0", "cam1"], "exposure_s": 0.02, "frame_rate_hz": 10.0, "texels": 16,
}  # fmt: skip
SRF = {
    "kind": "srf", "arm_deg": [-20, 0, 30], "exposures_s": [0.05, 0.2], "sphere_radius_mm": 50,
    "card": {"y_mm": 0, "z_mm": -59, "width_mm": 40, "height_mm": 11, "reflectance": 0.9},
}  # fmt: skip
CALIBRATE = {
    "kind": "calibrate", "board_poses": 3, "lamp": "lamp1", "light_arc_deg": 60, "cameras": ["cam0", "cam1"],
    "exposure_s": 0.1,
}  # fmt: skip
SENSOR = {
    "kind": "sensor", "cameras": ["cam0", "front"], "dark_exposures_s": [0.01, 0.2], "flat_exposures_s": [0.05, 0.1],
    "repeats": 2,
}  # fmt: skip
LAMPS = {
    "kind": "lamps", "lamps": ["lamp0", "led"], "light_arc_deg": [60, -60], "arm_deg": [45],
    "cameras": ["cam0", "cam1"], "mirror": {"radius_mm": 20, "exposures_s": [0.05]},
    "white": {"reflectance": 0.9, "exposures_s": [0.05]},
}  # fmt: skip
ENVIRONMENT = {"kind": "environment", "place": "room", "exposures_s": [1 / 32_000, 0.5, 0.01]}
UNTOLD_MDF = {key: value for key, value in MDF.items() if key != "exposure_s"}  # test sweeps choose the exposure
PLANS = {"btf": BTF, "mdf": MDF, "srf": SRF, "calibrate": CALIBRATE, "sensor": SENSOR, "lamps": LAMPS,
         "environment": ENVIRONMENT}  # fmt: skip


def whole(session):
    """Every step is done once, every frame is there once and unchanged."""
    wanted = sum(len(step.cameras) for step in session.steps if not step.test)
    done = [event.step for event in session.events() if event.kind == "done"]
    return session.verify() == wanted and sorted(done) == sorted(step.id for step in session.steps)
