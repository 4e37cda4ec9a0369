"""Scenes as a person writes them: a TOML file of bodies, materials, light and camera. Degrees and millimetres."""

from pathlib import Path
from typing import Annotated, Self

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag, model_validator

from rig.config import read_toml
from service.relit_materials import LambertMaterial, Material

Vector = tuple[float, float, float]
Bounded = Annotated[float, Field(ge=-1e6, le=1e6)]  # millimetres or degrees: a kilometre is no scene of bodies


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _for_each(value: object) -> object:
    return (value,) * 3 if _is_number(value) else value


def _about_vertical(value: object) -> object:
    return (0.0, 0.0, value) if _is_number(value) else value


def _over_zero(value: Vector) -> Vector:
    if not min(value) > 0:
        raise ValueError("must be over 0")
    return value


def _power_of_two(value: int) -> int:
    if value & (value - 1):
        raise ValueError("must be a power of two: 1024, 2048, 4096, 8192, 16384 or 32768")
    return value


def _named_or_table(value: object) -> str:
    return "name" if isinstance(value, str) else "table"


Scale = Annotated[Vector, BeforeValidator(_for_each), AfterValidator(_over_zero)]
Spot = tuple[Bounded, Bounded, Bounded]
Turn = Annotated[Spot, BeforeValidator(_about_vertical)]  # one number turns about the vertical
Name = Annotated[str, Field(min_length=1, max_length=60)]
NamedMaterial = Annotated[
    Annotated[str, Tag("name")] | Annotated[Material, Tag("table")], Discriminator(_named_or_table)
]


class Model(BaseModel):
    """What people and programs write: nothing that is not known, no infinities."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class BodyTable(Model):
    """A rigid body: its mesh, where it stands, and what it is made of."""

    name: Name
    mesh: str
    place_mm: Spot = (0.0, 0.0, 0.0)
    turn_deg: Turn = (0.0, 0.0, 0.0)
    scale: Scale = (1.0, 1.0, 1.0)
    edge_mm: float | None = Field(default=None, gt=0)
    casts: bool = True
    material: NamedMaterial = LambertMaterial(kind="lambert", albedo=(0.8, 0.8, 0.8))


class CameraTable(Model):
    """From where the scene is seen; without target and distance, all but floors."""

    azimuth_deg: Bounded = -50.0
    elevation_deg: float = Field(default=28.0, ge=-89, le=89)
    distance_mm: float | None = Field(default=None, gt=0, le=1e6)
    target_mm: Spot | None = None
    field_of_view_deg: float = Field(default=38.0, ge=1, le=120)
    stops: float = Field(default=0.0, ge=-20, le=20)
    background: bool = False  # the environment behind the bodies


class PrecomputationTable(Model):
    """How finely visibility is kept: sample directions, and the resolution of the spheres around each body."""

    directions: Annotated[int, Field(ge=1024, le=32768), AfterValidator(_power_of_two)] = 32768
    resolution: int = Field(default=32, ge=4, le=64)


class SceneFile(Model):
    """What the file may say; paths are relative to its folder."""

    environment: str
    environments: tuple[str, ...] = ()
    light_azimuth_deg: Bounded = 0.0
    camera: CameraTable = CameraTable()
    precomputation: PrecomputationTable = PrecomputationTable()
    materials: dict[Name, Material] = Field(default_factory=dict)
    body: tuple[BodyTable, ...] = Field(min_length=1, max_length=64)

    @model_validator(mode="after")
    def _names_are_told_apart(self) -> Self:
        names = [body.name for body in self.body]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ValueError(f"two [[body]] are named {twice!r}; give each a name of its own")
        return self

    @model_validator(mode="after")
    def _materials_are_there(self) -> Self:
        for body in self.body:
            if isinstance(body.material, str) and body.material not in self.materials:
                known = ", ".join(self.materials) or "nothing"
                raise ValueError(
                    f"[[body]] {body.name!r} is made of {body.material!r}, and [materials] has {known}; add "
                    f"[materials.{body.material}]"
                )
        return self


def read_scene(path: Path) -> SceneFile:
    """Raises ConfigError that names the file, the field, and what is wrong with it."""
    return read_toml(path, SceneFile, " What a scene says: docs/design-the-light.md")
