"""Time and disk of a list of steps, from rig.toml alone, and the lower bound that no rig of these parts can beat."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import degrees, sqrt

from rig.config import AxisConfig, RigConfig
from rig.sessions.step import Step

SHUTTER_LAG_S = 0.1  # between a camera's consent to expose and the opening of its shutter, at most
LAMP_SETTLE_S = 0.05  # one DMX frame (23 ms at 44 Hz) and the lamp's own rise
_MEGABYTE = 1e6


@dataclass(frozen=True, slots=True)
class Forecast:
    """What a session will take. `step_s` has one entry per step; waiting for the operator is not included.

    `frames` and `bytes` are those that are kept, so without test sweeps; bursts are compressed, to a quarter or a half.
    """

    steps: int
    frames: int
    mounts: int
    bytes: int
    time_s: float
    lower_bound_s: float
    motion_s: float
    exposure_s: float
    transfer_s: float
    step_s: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Effort:
    """The parts of one step: the way to its pose (with the laser's rewinding), exposure, and download per camera."""

    motion_s: float
    exposure_s: float
    transfer_s: Mapping[str, float]


def forecast(steps: Sequence[Step], config: RigConfig) -> Forecast:
    """Forecast of these steps in this order, from the reference position."""
    poses = [reference_rad(config), *(step.axes_rad for step in steps)]
    efforts = [effort(step, here, config) for here, step in zip(poses, steps, strict=False)]
    lights = [None, *((step.lamps, step.sweep) for step in steps)]
    mounts = [None, *(step.mount for step in steps)]
    step_s = tuple(
        part.motion_s + part.exposure_s + sum(part.transfer_s.values()) + LAMP_SETTLE_S * (before != now)
        for part, (before, now) in zip(efforts, pairwise(lights), strict=True)
    )
    kept = [step for step in steps if not step.test]
    megabytes = sum(step.frames * config.cameras[name].frame_megabytes for step in kept for name in step.cameras)
    return Forecast(
        steps=len(steps),
        frames=sum(step.frames * len(step.cameras) for step in kept),
        mounts=sum(before != now for before, now in pairwise(mounts)),
        bytes=round(megabytes * _MEGABYTE),
        time_s=sum(step_s),
        lower_bound_s=lower_bound_s(efforts),
        motion_s=sum(part.motion_s for part in efforts),
        exposure_s=sum(part.exposure_s for part in efforts),
        transfer_s=sum(sum(part.transfer_s.values()) for part in efforts),
        step_s=step_s,
    )


def effort(step: Step, from_rad: Mapping[str, float], config: RigConfig) -> Effort:
    """The parts of one step that starts from these angles."""
    transfer_s = {
        name: step.frames * config.cameras[name].frame_megabytes / config.cameras[name].megabytes_per_s
        for name in step.cameras
    }
    motion_s = max(motion_time_s(from_rad, step.axes_rad, config), sweep_time_s(config) if step.sweep else 0.0)
    return Effort(motion_s, step.duration_s, transfer_s)


def lower_bound_s(efforts: Sequence[Effort]) -> float:
    """Time of an ideal rig: axes move together, cameras expose together and download together while the axes move on.

    A camera downloads before it exposes again, and nothing moves during an exposure. The laser's motor runs back as
    fast as it sweeps, also while the axes move and frames download.
    """
    if not efforts:
        return 0.0
    downloads_s = [max(part.transfer_s.values(), default=0.0) for part in efforts]
    motions_s = [*(part.motion_s for part in efforts[1:]), 0.0]
    between_s = sum(max(pair) for pair in zip(downloads_s, motions_s, strict=True))
    return efforts[0].motion_s + sum(part.exposure_s for part in efforts) + between_s


def reference_rad(config: RigConfig) -> dict[str, float]:
    """Angles after the reference search."""
    return dict.fromkeys(config.axes, 0.0)


def motion_time_s(from_rad: Mapping[str, float], to_rad: Mapping[str, float], config: RigConfig) -> float:
    """Time until the slowest axis has arrived and settled; all start together. 0 where none has to move."""
    times = [_move_s(config.axes[name], degrees(abs(angle - from_rad[name]))) for name, angle in to_rad.items()]
    return max(times, default=0.0)


def sweep_time_s(config: RigConfig) -> float:
    """Nominal time of one laser sweep; 0 without a laser."""
    return config.laser.sweep_ticks / config.laser.ticks_per_s if config.laser else 0.0


def _move_s(axis: AxisConfig, distance_deg: float) -> float:
    """Trapezoidal ramp, triangular where the distance is too short for full speed, and settling."""
    if distance_deg < 0.5 / axis.steps_per_deg:
        return 0.0
    ramps_deg = axis.speed_deg_s**2 / axis.acceleration_deg_s2
    if distance_deg < ramps_deg:
        return 2 * sqrt(distance_deg / axis.acceleration_deg_s2) + axis.settle_s
    return distance_deg / axis.speed_deg_s + axis.speed_deg_s / axis.acceleration_deg_s2 + axis.settle_s
