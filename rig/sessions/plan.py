"""Capture plans: what a person asks for, as data. Degrees, millimetres and seconds; converted where steps are made.

A plan is a TOML or JSON file whose `kind` decides which fields it has. Unknown fields are errors, so that a misspelt
one is never ignored.
"""

import hashlib
import json
import tomllib
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    SerializerFunctionWrapHandler,
    Tag,
    TypeAdapter,
    ValidationError,
    model_serializer,
    model_validator,
)

from rig.config import shown
from rig.errors import PlanError

ANGLE_STEP_DEG = 0.01  # finest difference of two angles in a plan: one step of the coarsest axis
EXPOSURE_STEP_S = 1e-4  # unit of PTP's exposure time (ISO 15740, property 0x500D)
SHORTEST_S = 1 / 64_000  # of a shutter that is told its speed
APART = 1.2  # least ratio of two exposures of such a shutter


def _distinct(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if len(set(values)) != len(values):
        raise ValueError("names or numbers are repeated")
    return values


def _distinct_angles(values: tuple[float, ...]) -> tuple[float, ...]:
    turn = round(360 / ANGLE_STEP_DEG)
    if len({round(value / ANGLE_STEP_DEG) % turn for value in values}) != len(values):
        raise ValueError(f"two angles are the same, modulo 360 deg and to {ANGLE_STEP_DEG} deg")
    return values


def _distinct_exposures(values: tuple[float, ...]) -> tuple[float, ...]:
    if len({round(value / EXPOSURE_STEP_S) for value in values}) != len(values):
        raise ValueError(f"two exposures are less than {EXPOSURE_STEP_S} s apart")
    return values


def _distinct_speeds(values: tuple[float, ...]) -> tuple[float, ...]:
    if any(longer < APART * shorter for shorter, longer in pairwise(sorted(values))):
        raise ValueError(f"two exposures differ by less than a factor of {APART}")
    return values


def _form(angles: object) -> str:
    """Whether angles are one list or a list of lists, so that an error speaks of the form that was meant."""
    nested = isinstance(angles, (list, tuple)) and any(isinstance(item, (list, tuple)) for item in angles)
    return FORMS[nested]


FORMS = ("one list", "list of lists")
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,40}$")]
Degrees = Annotated[float, Field(strict=True, ge=-3600, le=3600)]
Millimetres = Annotated[float, Field(strict=True, ge=-10_000, le=10_000)]
Length = Annotated[float, Field(strict=True, gt=0, le=10_000)]
Exposure = Annotated[float, Field(strict=True, ge=EXPOSURE_STEP_S, le=600)]
Angles = Annotated[tuple[Degrees, ...], Field(min_length=1, max_length=10_000), AfterValidator(_distinct_angles)]
OptionalAngles = Annotated[tuple[Degrees, ...], Field(max_length=10_000), AfterValidator(_distinct_angles)]
Exposures = Annotated[tuple[Exposure, ...], Field(min_length=1, max_length=50), AfterValidator(_distinct_exposures)]
Speed = Annotated[float, Field(strict=True, ge=SHORTEST_S, le=600)]
Bracket = Annotated[tuple[Speed, ...], Field(min_length=3, max_length=50), AfterValidator(_distinct_speeds)]
Names = Annotated[tuple[Name, ...], Field(min_length=1, max_length=512), AfterValidator(_distinct)]
Lists = Annotated[tuple[Angles, ...], Field(min_length=1, max_length=100)]
AnglesOrLists = Annotated[Annotated[Angles, Tag(FORMS[0])] | Annotated[Lists, Tag(FORMS[1])], Discriminator(_form)]
OptionalNames = Annotated[tuple[Name, ...], Field(max_length=512), AfterValidator(_distinct)]
Depth = Annotated[float, Field(strict=True, ge=0, le=1000)]
Texels = Annotated[int, Field(strict=True, ge=4, le=4096)]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Card(_Model):
    """The matt white card beside the sample, in the plane through the rig's origin that faces the camera.

    `y_mm` and `z_mm` of its centre are to the right and up as that camera sees them: for one at elevation 0 they are
    the rig's.
    """

    y_mm: Millimetres
    z_mm: Millimetres
    width_mm: Length
    height_mm: Length
    reflectance: float = Field(strict=True, gt=0, le=1)


class SrfPlan(_Model):
    """A body under lamps that go round it on the arm and the light arc, seen by one camera.

    A sphere where its radius is told; without it the sample is of any shape. One `lamp`, or several `lamps`, each at
    every angle of the axis that carries it.
    """

    kind: Literal["srf"]
    sample: Name = "sphere"
    arm_deg: OptionalAngles = ()
    light_arc_deg: OptionalAngles = ()
    exposures_s: Exposures
    camera: Name = "front"
    lamp: Name = "led"
    lamps: OptionalNames = ()
    sphere_radius_mm: Length | None = None
    card: Card

    def lamp_names(self) -> tuple[str, ...]:
        """Every lamp of the plan."""
        return self.lamps or (self.lamp,)

    @model_validator(mode="after")
    def _has_lights(self) -> "SrfPlan":
        if not self.light_arc_deg and not self.arm_deg:
            raise ValueError("neither arm_deg nor light_arc_deg is there: name angles of the axis that carries a lamp")
        if self.lamps and "lamp" in self.model_fields_set:
            raise ValueError("both lamp and lamps are there: name one lamp, or several")
        return self

    @model_serializer(mode="wrap")
    def _without_what_is_not_used(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Plans from before there were several lamps keep their hash: what they do not name is left out."""
        data: dict[str, Any] = dump(self)
        unused = {name for name in ("arm_deg", "light_arc_deg", "lamps", "sphere_radius_mm") if not data[name]}
        return {name: value for name, value in data.items() if name not in unused | ({"lamp"} if self.lamps else set())}


class _TexelPlan(_Model):
    """A flat sample, measured texel by texel.

    `depth_mm` is how far its surface lies under the holder's opening, in the mean: there the texels are, so that what a
    texel shows moves the less from view to view.
    """

    texels: Texels
    depth_mm: Depth = 0.0

    @model_serializer(mode="wrap")
    def _without_no_depth(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Plans from before there was a depth keep their hash."""
        data: dict[str, Any] = dump(self)
        return {name: value for name, value in data.items() if name != "depth_mm" or value}


class BtfPlan(_TexelPlan):
    """A flat sample on the turntable under every lamp of the light arc; light azimuths in the sample frame."""

    kind: Literal["btf"]
    sample: Name = "brick"
    turntable_deg: Angles
    light_azimuth_deg: Angles
    lamps: Names
    cameras: Names
    exposures_s: Exposures


class MdfPlan(_TexelPlan):
    """Laser sweeps over a flat sample; laser azimuths in the rig frame, elevations are mountings by hand.

    The azimuths are one list for every mounting, or one list for each of `laser_elevations_deg`, in its order. Without
    `exposure_s` a test sweep in every mounting chooses it.
    """

    kind: Literal["mdf"]
    sample: Name = "brick"
    turntable_deg: Angles
    laser_azimuth_deg: AnglesOrLists
    laser_elevations_deg: Angles
    cameras: Names
    exposure_s: Exposure | None = None
    frame_rate_hz: float = Field(strict=True, gt=0, le=240)

    def mountings_deg(self) -> tuple[tuple[float, tuple[float, ...]], ...]:
        """Every mounting's elevation with its azimuths, lowest first."""
        return tuple(sorted(zip(self.laser_elevations_deg, self._lists_deg(), strict=True)))

    def _lists_deg(self) -> list[tuple[float, ...]]:
        lists = [angles for angles in self.laser_azimuth_deg if isinstance(angles, tuple)]
        shared = tuple(angle for angle in self.laser_azimuth_deg if not isinstance(angle, tuple))
        return lists or [shared] * len(self.laser_elevations_deg)

    @model_validator(mode="after")
    def _every_mounting_has_azimuths(self) -> "MdfPlan":
        lists, mountings = len(self._lists_deg()), len(self.laser_elevations_deg)
        if lists != mountings:
            raise ValueError(
                f"laser_azimuth_deg has {lists} lists and laser_elevations_deg {mountings} mountings: "
                "name one list for all of them, or one for each"
            )
        return self

    @model_validator(mode="after")
    def _exposure_fits_the_rate(self) -> "MdfPlan":
        if self.exposure_s is not None and self.exposure_s * self.frame_rate_hz > 1:
            raise ValueError(f"exposure_s is longer than the {1 / self.frame_rate_hz:.4f} s between frames")
        return self


class CalibratePlan(_Model):
    """A ChArUco board held in several poses; in pose 0 it lies on the turntable, which defines the reference plane.

    Pose 0 is also photographed with the turntable at `turntable_deg`: that shows the turntable's axis. Without such
    angles the axis is taken to be the board's.
    """

    kind: Literal["calibrate"]
    board_poses: int = Field(strict=True, ge=3, le=200)
    turntable_deg: OptionalAngles = ()
    lamp: Name
    light_arc_deg: Degrees
    cameras: Names
    exposure_s: Exposure


class SensorPlan(_Model):
    """Dark frames under the lens cap and flat frames before a light box, all lamps off: what measures the sensors."""

    kind: Literal["sensor"]
    cameras: Names
    dark_exposures_s: Exposures
    flat_exposures_s: Exposures
    repeats: int = Field(strict=True, ge=2, le=100)


class MirrorBall(_Model):
    """A polished ball on the reference plane, its centre on the turntable's axis to a few millimetres."""

    sample: Name = "mirror"
    radius_mm: Length
    exposures_s: Exposures


class WhitePlate(_Model):
    """A matt white plate in the reference plane; `reflectance` is the share of light that it returns."""

    sample: Name = "white"
    reflectance: float = Field(strict=True, gt=0, le=1)
    exposures_s: Exposures


class LampsPlan(_Model):
    """Every lamp in a mirror ball and on a white plate, from several angles of the axis that carries it."""

    kind: Literal["lamps"]
    lamps: Names
    light_arc_deg: OptionalAngles = ()
    arm_deg: OptionalAngles = ()
    cameras: Names
    mirror: MirrorBall | None = None
    white: WhitePlate | None = None

    @model_validator(mode="after")
    def _has_a_sample(self) -> "LampsPlan":
        if self.mirror is None and self.white is None:
            raise ValueError("neither [mirror] nor [white] is there: lamps are measured by one of them, or both")
        if not self.light_arc_deg and not self.arm_deg:
            raise ValueError("neither light_arc_deg nor arm_deg is there: name angles of the axis that carries a lamp")
        return self


class EnvironmentPlan(_Model):
    """The light of a place: a camera with a fish-eye, in the hand, photographs it front and back, each as a bracket.

    `azimuth_deg` is where the front looks, from +X toward +Y. `texels` are along the side of a cubemap's face.
    """

    kind: Literal["environment"]
    place: Name
    camera: Name = "phone"
    exposures_s: Bracket
    files: Literal["jpeg", "raw"] = "jpeg"
    azimuth_deg: Degrees = 0.0
    texels: Texels = 128


Plan = SrfPlan | BtfPlan | MdfPlan | CalibratePlan | SensorPlan | LampsPlan | EnvironmentPlan
KINDS = ("srf", "btf", "mdf", "calibrate", "sensor", "lamps", "environment")
_PLAN: TypeAdapter[Plan] = TypeAdapter(Annotated[Plan, Field(discriminator="kind")])


def load_plan(path: Path) -> Plan:
    """Read a plan from a .toml or .json file. Raises PlanError that names the file, the field and what is wrong."""
    try:
        text = path.read_text(encoding="utf-8")
        data = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except OSError as error:
        raise PlanError(f"{path}: cannot be read: {error.strerror}.") from error
    except (tomllib.TOMLDecodeError, json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        language = "JSON" if path.suffix == ".json" else "TOML"
        raise PlanError(f"{path}: not {language}: {error}") from error
    return parse_plan(data, source=str(path))


def parse_plan(data: object, *, source: str = "plan") -> Plan:
    """Check plan data that came from a file or a request. Raises PlanError that names the source and the field."""
    try:
        return _PLAN.validate_python(data)
    except ValidationError as error:
        raise PlanError(f"{source}: {_first_problem(error)}") from error


def plan_schema() -> dict[str, Any]:
    """JSON schema of all kinds of plan."""
    return _PLAN.json_schema()


def plan_data(plan: Plan) -> dict[str, Any]:
    """The plan as JSON data; `parse_plan` reads it back to an equal plan."""
    return plan.model_dump(mode="json")


def plan_sha256(plan: Plan) -> str:
    """Identity of a plan: `content_sha256` of its data."""
    return content_sha256(plan_data(plan))


def in_steps_s(exposure_s: float) -> float:
    """The exposure in whole units of PTP's exposure time, as the camera will be told; at least one."""
    return round(max(round(exposure_s / EXPOSURE_STEP_S), 1) * EXPOSURE_STEP_S, 6)


def content_sha256(data: object) -> str:
    """Hex digest of the data's canonical JSON (sorted keys, no white space)."""
    return hashlib.sha256(canonical_json(data).encode()).hexdigest()


def canonical_json(data: object) -> str:
    """The one JSON text of this data: sorted keys, no white space."""
    return json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _first_problem(error: ValidationError) -> str:
    first = error.errors()[0]
    path = [str(part) for part in first["loc"] if part not in FORMS]
    where = ".".join(path[1:] if path and path[0] in KINDS else path)
    more = f" ({error.error_count() - 1} more)" if error.error_count() > 1 else ""
    field = f"field {where}: " if where else ""
    return f"{field}{first['msg']} (got {shown(first['input'])}){more}"
