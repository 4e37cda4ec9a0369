"""rig.toml: what the rig consists of, and where each device is reached. Degrees and millimetres, as people write."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, Self, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from rig.errors import ConfigError


def _ascending(zone: tuple[float, float]) -> tuple[float, float]:
    if zone[0] > zone[1]:
        raise ValueError(f"a zone runs from its lower to its upper angle, not from {zone[0]:g} to {zone[1]:g} deg")
    return zone


Degrees = Annotated[float, Field(ge=-3600, le=3600)]
Model = TypeVar("Model", bound=BaseModel)
Zone = Annotated[tuple[Degrees, Degrees], AfterValidator(_ascending)]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class SampleHolder(_Model):
    """The stepped square frame around the sample, centred on the turntable axis.

    From the sample's edge to `inner_mm` it lies in the reference plane (z = 0), from there to `outer_mm` at
    z = -step_mm. Both are matt white of known reflectance: they serve the laser analysis (two known heights in
    every frame) and the photometry (irradiance of every lamp in every frame).
    """

    sample_mm: float = Field(gt=0)  # side of the square opening
    margin_mm: float = Field(ge=0, default=0.0)  # of the sample that the texels leave out along the opening's edge
    inner_mm: float = Field(gt=0)  # outer side of the upper frame
    outer_mm: float = Field(gt=0)  # outer side of the lower frame
    step_mm: float = Field(gt=0)
    sample_depth_mm: float = Field(gt=0)  # the sample lies between z = -sample_depth_mm and 0
    white_reflectance: float = Field(gt=0, le=1)  # albedo of the frame, the same in all channels

    @model_validator(mode="after")
    def _widens(self) -> Self:
        if not 2 * self.margin_mm < self.sample_mm < self.inner_mm < self.outer_mm:
            raise ValueError("twice margin_mm, sample_mm, inner_mm and outer_mm must each be less than the next")
        return self

    @property
    def texels_mm(self) -> float:
        """Side of the square that the texels divide."""
        return self.sample_mm - 2 * self.margin_mm


class BoardConfig(_Model):
    """The ChArUco board of the calibration plan."""

    columns: int = Field(ge=2)
    rows: int = Field(ge=2)
    square_mm: float = Field(gt=0)
    marker_mm: float = Field(gt=0)
    dictionary: str = "DICT_4X4_50"


class Bus(_Model):
    """The TMCL serial bus that the axes share."""

    port: str
    baudrate: int = Field(gt=0, default=9600)


class AxisConfig(_Model):
    """One stepper axis on the TMCL bus."""

    module: int = Field(ge=1, le=255)
    motor: int = Field(ge=0, le=255, default=0)
    steps_per_deg: float = Field(gt=0)
    min_deg: Degrees
    max_deg: Degrees
    forbidden_deg: tuple[Zone, ...] = ()  # may not stand there: would block the view
    collision_deg: tuple[Zone, ...] = ()  # may not even pass there: would touch another part
    speed_deg_s: float = Field(gt=0)
    acceleration_deg_s2: float = Field(gt=0)
    settle_s: float = Field(ge=0, default=0.2)

    @model_validator(mode="after")
    def _has_a_range(self) -> Self:
        if self.min_deg > self.max_deg:
            raise ValueError(f"min_deg {self.min_deg:g} is above max_deg {self.max_deg:g}")
        return self


class LampConfig(_Model):
    """One lamp: its DMX channel and its place on the arm or on the light arc."""

    channel: int = Field(ge=1, le=512)
    mount: Literal["arm", "light_arc"]
    elevation_deg: Degrees
    distance_mm: float = Field(gt=0)


class LampsConfig(_Model):
    """The ENTTEC DMX USB Pro widget and its lamps."""

    port: str
    lamp: dict[str, LampConfig]


class CameraConfig(_Model):
    """One PTP/IP camera and its nominal place; the true pose comes from calibration.

    One that is held by hand stands in the rig's middle and looks around through a fish-eye, whose field of view its
    maker states.
    """

    address: str  # host:port
    serial: str
    mount: Literal["front", "camera_arc", "hand"]
    elevation_deg: Degrees = 0.0
    distance_mm: float = Field(ge=0, default=0.0)
    field_deg: float | None = Field(gt=0, lt=360, default=None)  # of a fish-eye
    megabytes_per_s: float = Field(gt=0, default=20.0)  # of the download
    frame_megabytes: float = Field(gt=0, default=10.0)  # of one file, for the forecast of time and disk

    @model_validator(mode="after")
    def _has_a_place_or_a_field(self) -> Self:
        if self.mount == "hand" and self.field_deg is None:
            raise ValueError("a camera that is held by hand needs field_deg, the field of view of its fish-eye")
        if self.mount != "hand" and not (self.distance_mm > 0 and "elevation_deg" in self.model_fields_set):
            raise ValueError("a mounted camera needs elevation_deg and distance_mm, its place")
        return self


class LaserConfig(_Model):
    """The RCX laser unit on the light arc."""

    port: str
    baudrate: int = Field(gt=0, default=2400)
    distance_mm: float = Field(gt=0)  # nominal distance from the rig origin
    elevations_deg: tuple[Degrees, ...]  # the mountings by hand
    sweep_ticks: int = Field(gt=0)  # rotation-sensor counts of one sweep (1/16 turn each)
    ticks_per_s: float = Field(gt=0)  # nominal


class ClockConfig(_Model):
    """Control port of the simulators whose clock this rig follows; absent on hardware."""

    address: str


class RigConfig(_Model):
    """The whole of rig.toml."""

    name: str
    holder: SampleHolder
    board: BoardConfig
    bus: Bus
    axes: dict[str, AxisConfig]
    lamps: LampsConfig
    cameras: dict[str, CameraConfig]
    laser: LaserConfig | None = None
    clock: ClockConfig | None = None

    @model_validator(mode="after")
    def _one_motor_per_axis(self) -> Self:
        names: dict[tuple[int, int], str] = {}
        for name, axis in self.axes.items():
            other = names.setdefault((axis.module, axis.motor), name)
            if other != name:
                raise ValueError(f"axes {other} and {name} are both motor {axis.motor} of module {axis.module}")
        return self


def load_config(path: Path) -> RigConfig:
    """Read rig.toml. Raises ConfigError that names the file, the field and what is wrong with it."""
    return read_toml(path, RigConfig, " Name a rig.toml with --rig, or start `rig serve --simulated`.")


def read_toml(path: Path, kind: type[Model], advice: str = "") -> Model:
    """Read a TOML file of this kind. Raises ConfigError that names the file, the field and what is wrong with it.

    `advice` follows where there is no file.
    """
    try:
        return kind.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError as error:
        raise ConfigError(f"{path}: no such file.{advice}") from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}.") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not TOML: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        field = f"[{where}] " if where else ""
        raise ConfigError(f"{path}: {field}{first['msg']} (got {shown(first['input'])})") from error


def shown(value: object) -> str:
    """A value as a message tells it: in one line, a table by its keys."""
    text = f"fields {', '.join(map(str, value))}" if isinstance(value, Mapping) else repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
