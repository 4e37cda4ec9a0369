"""The steps of a session: frozen, and named by what they contain, so that 'done' means the same after any restart."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import degrees, isclose, radians
from typing import Any

from rig.devices import FileFormat

_SHORT = {"turntable": "tt", "light_arc": "arc", "arm": "arm"}
Mount = Mapping[str, str | int | float]


@dataclass(frozen=True, slots=True)
class Step:
    """One pose, one light, one exposure of all cameras at once, or one burst of them during a laser sweep.

    `id` is unique within a session and readable: 'tt+090.00_arc-030.00_lamp3_0.0333s'. `axes_rad` holds every axis of
    the rig, also those that only stand by. `mount` is what the operator must have mounted. `interval_s` is the time
    between the starts of a burst's `frames`. The frames of a `test` sweep are not kept: they choose the exposure of its
    mounting's other sweeps.
    """

    id: str
    axes_rad: Mapping[str, float]
    lamps: tuple[str, ...]
    exposure_s: float
    cameras: tuple[str, ...]
    frames: int = 1
    interval_s: float = 0.0
    sweep: bool = False
    mount: Mount | None = None
    test: bool = False
    file_format: FileFormat = FileFormat.RAW

    @property
    def pose(self) -> tuple[tuple[str, float], ...]:
        """The axes' angles as something that can be compared and sorted."""
        return tuple(sorted(self.axes_rad.items()))

    @property
    def duration_s(self) -> float:
        """From the first exposure's start to the last one's end."""
        return (self.frames - 1) * self.interval_s + self.exposure_s


def step_data(step: Step) -> dict[str, Any]:
    """The step as JSON data; `read_step` gives an equal step back."""
    return asdict(step)


def read_step(data: Mapping[str, Any]) -> Step:
    """A step from `step_data`. Raises KeyError or TypeError where the data is not one."""
    lists = {"lamps": tuple(data["lamps"]), "cameras": tuple(data["cameras"])}
    return Step(**{**data, **lists, "file_format": FileFormat(data.get("file_format", FileFormat.RAW))})


def step_id(mount: Mount, axes_deg: Mapping[str, float], light: str, exposure_s: float | None) -> str:
    """Identity from content: mounting, the angles that the plan names, light, and exposure where it is known."""
    parts = [f"pose{mount['pose']}"] if "pose" in mount else []
    if "laser_elevation_deg" in mount:
        parts.append(f"el{mount['laser_elevation_deg']:05.2f}")
    parts += [f"{_SHORT.get(name, name)}{_signed(angle)}" for name, angle in axes_deg.items()]
    return "_".join([*parts, light, *([] if exposure_s is None else [_seconds(exposure_s)])])


def _seconds(exposure_s: float) -> str:
    """Down to 0.1 ms, which is PTP's unit, or to a microsecond where the exposure is no multiple of it."""
    return f"{exposure_s:.{4 if isclose(exposure_s, round(exposure_s, 4), rel_tol=1e-9) else 6}f}s"


def _signed(angle_deg: float) -> str:
    return f"{round(angle_deg, 2) + 0.0:+07.2f}"


def to_rad(axes_deg: Mapping[str, float]) -> dict[str, float]:
    """Angles in radians, by axis name."""
    return {name: radians(angle) for name, angle in axes_deg.items()}


def describe(step: Step) -> str:
    """One line of a dry run."""
    angles = ", ".join(f"{name} {degrees(angle):+.2f} deg" for name, angle in step.axes_rad.items())
    sweep = "test sweep that chooses the exposure" if step.test else "laser sweep"
    light = sweep if step.sweep else " + ".join(step.lamps) or "dark"
    frames = f"{step.frames} x " if step.frames > 1 else ""
    mounted = " ".join(f"{key}={value}" for key, value in (step.mount or {}).items())
    exposure = f"{frames}{_seconds(step.exposure_s)[:-1]} s"
    return f"{step.id}: [{mounted}] {angles}; {light}; {exposure}; {', '.join(step.cameras)}"
