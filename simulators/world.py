"""The one world behind all wires: axes, lamps, laser and the sample on the turntable, at the clock's time."""

from collections import Counter
from dataclasses import dataclass, field
from math import degrees, radians
from typing import Any

from simulators.chance import Key
from simulators.clock import Clock
from simulators.faults import FaultSchedule, Occasion
from simulators.layout import Layout
from simulators.motor import LaserMotor
from simulators.phone import FACINGS
from simulators.places import PLACES
from simulators.pose import Pose
from simulators.stage import Stage
from simulators.studio import CAP, LIGHTBOX, SCENES

SAMPLES = (*SCENES, CAP, LIGHTBOX)
FRONT = "front"
HELD = "room"  # the place where the phone is, unless told
STOPS = (-0.05, 1.15)  # of the laser's gear train, in sweeps


class MountError(ValueError):
    """Something that cannot be put there by hand."""


@dataclass(frozen=True, slots=True)
class Mounted:
    """What an operator has put in place by hand."""

    sample: str = "none"
    board_pose: int = 0
    laser_elevation_deg: float = 35.0
    card: str = FRONT  # the camera that the white card beside a sphere faces
    place: str = HELD  # where the phone is held
    facing: str = FACINGS[0]


@dataclass
class LampBank:
    """The lamps on one DMX universe; a lamp whose channel the universe lacks is dark."""

    channels: dict[str, int]
    clock: Clock
    faults: FaultSchedule
    universe: bytes = b""

    def lit(self) -> tuple[tuple[str, float], ...]:
        """Name and level in (0, 1] of the lamps that shine, sorted by name."""
        levels = {name: self.universe[channel - 1 : channel] for name, channel in self.channels.items()}
        shining = {name: level[0] / 255 for name, level in levels.items() if level and level[0]}
        now_s = self.clock.now_s()
        return tuple(sorted((name, level) for name, level in shining.items() if not self.faults.dead(name, now_s)))


@dataclass
class LaserHead:
    """The line laser and the motor that turns its fan plane."""

    motor: LaserMotor
    on: bool = False
    runs: Counter[Key] = field(default_factory=Counter)


class World:
    """Everything that stands, turns or shines. Its readings are those of the clock's present time."""

    def __init__(self, clock: Clock, faults: FaultSchedule, layout: Layout) -> None:
        self.clock = clock
        self.faults = faults
        self.layout = layout
        self.mounted = Mounted()
        self.stages = {name: Stage(name, axis, clock, faults, layout.seed) for name, axis in layout.axes.items()}
        self.lamps = LampBank({name: lamp.channel for name, lamp in layout.lamps.items()}, clock, faults)
        sweep = layout.laser.sweep_ticks
        self.laser = LaserHead(LaserMotor(layout.laser.ticks_per_s, (STOPS[0] * sweep, STOPS[1] * sweep)))
        self._exposures: Counter[Key] = Counter()

    def mount(self, mounted: Mounted) -> None:
        """Put a sample, board pose and laser mounting in place. Raises MountError where that cannot be."""
        if mounted.sample not in SAMPLES:
            raise MountError(f"no sample {mounted.sample!r}: one of {', '.join(SAMPLES)}")
        if mounted.board_pose < 0:
            raise MountError(f"no board pose {mounted.board_pose}: they count from 0")
        if mounted.card not in self.layout.cameras:
            raise MountError(f"no camera {mounted.card!r} to face: one of {', '.join(self.layout.cameras)}")
        if mounted.place not in PLACES:
            raise MountError(f"no place {mounted.place!r}: one of {', '.join(PLACES)}")
        if mounted.facing not in FACINGS:
            raise MountError(f"the phone faces {' or '.join(FACINGS)}, not {mounted.facing!r}")
        allowed = self.layout.laser.elevations_deg
        if mounted.laser_elevation_deg not in allowed:
            raise MountError(f"no laser mounting at {mounted.laser_elevation_deg} deg: one of {allowed}")
        self.mounted = mounted

    def pose(self) -> Pose:
        """All that light depends on; the laser's sweep is left to whoever knows the exposure."""
        angles = {name: stage.angle_rad() for name, stage in self.stages.items()}
        return Pose(
            sample=self.mounted.sample,
            board_pose=self.mounted.board_pose,
            turntable_rad=angles["turntable"],
            light_arc_rad=angles["light_arc"],
            arm_rad=angles["arm"],
            lamps=self.lamps.lit(),
            laser_elevation_rad=radians(self.mounted.laser_elevation_deg),
            laser_on=self.laser.on,
            laser_sweep=None,
            card_elevation_rad=self.layout.cameras[self.mounted.card].elevation_rad,
            place=self.mounted.place,
            facing=self.mounted.facing,
        )

    def fan_rad(self) -> float:
        """Depression angle of the laser's fan plane."""
        ticks = self.laser.motor.ticks(self.clock.now_ns())
        return self.layout.laser.fan_rad(ticks, radians(self.mounted.laser_elevation_deg))

    def turn_laser(self, direction: int, power: int) -> None:
        """Switch the laser's motor; each run has its own unevenness, which belongs to the pose and not to the hour."""
        key = (self.layout.seed, *self.place(), direction, power)
        fault = None
        if direction:
            self.laser.runs[key] += 1
            fault = self.faults.strike(("laser",), Occasion.MOVE, self.clock.now_s())
        jams = fault is not None and fault.kind == "stall"
        self.laser.motor.turn(self.clock.now_ns(), direction, power, (*key, self.laser.runs[key]), jams=jams)

    def place(self) -> Key:
        """Exact positions and what is mounted: with the light it says which frame this is."""
        steps = tuple(stage.steps() for stage in self.stages.values())
        mounting_mdeg = round(1000 * self.mounted.laser_elevation_deg)
        card = () if self.mounted.card == FRONT else (self.mounted.card,)
        held = (self.mounted.place, self.mounted.facing)
        phone = () if held == (HELD, FACINGS[0]) else held
        return (*steps, self.mounted.sample, self.mounted.board_pose, mounting_mdeg, *card, *phone)

    def frame_key(self, serial: str, exposure: int | str, burst_index: int) -> Key:
        """What a frame's noise belongs to; ends in the number of earlier exposures of which all this is equal."""
        light = tuple(part for name, level in self.lamps.lit() for part in (name, round(255 * level)))
        burst = burst_index if self.laser.on else -1
        key = (serial, *self.place(), *light, burst, exposure)
        self._exposures[key] += 1
        return (*key, self._exposures[key] - 1)

    def status(self) -> dict[str, Any]:
        """The present state for people and tests: degrees, levels, yes and no."""
        motor = self.laser.motor
        return {
            "time_s": self.clock.now_s(),
            "axes": {
                name: {"deg": degrees(stage.angle_rad()), "steps": stage.counter(), "moving": stage.moving()}
                for name, stage in self.stages.items()
            },
            "lamps": dict(self.lamps.lit()),
            "laser": self.laser.on,
            "motor": {"ticks": motor.ticks(self.clock.now_ns()), "running": motor.run is not None},
            "sample": self.mounted.sample,
            "pose": self.mounted.board_pose,
            "laser_elevation_deg": self.mounted.laser_elevation_deg,
            "card": self.mounted.card,
            "place": self.mounted.place,
            "facing": self.mounted.facing,
        }
