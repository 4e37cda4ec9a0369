"""What a client says to a relighting session, one small JSON message a change. Degrees and millimetres."""

from dataclasses import replace
from math import radians
from typing import Annotated, Literal, Self

from pydantic import Field, TypeAdapter, ValidationError, field_validator

from rig.errors import ConfigError
from service.problems import NotFoundError
from service.relit_materials import MerlMaterial, ProductMaterial, material_brdf
from service.relit_scene import Place, RelitScene
from service.relit_studio import Studio
from service.scene_file import Bounded, Model, Name, NamedMaterial, Spot, Turn

MOST_CHARACTERS = 4096


class _Change(Model):
    """A change of the scene; `rough` where more is to come, so that a smaller picture will do until then."""

    rough: bool = False

    @property
    def subject(self) -> str:
        """What a later change of the same subject takes the place of."""
        return str(self.model_dump(include={"kind", "body"}))

    def after(self, earlier: "_Change") -> Self:
        """This and what an earlier change of the same subject said beside."""
        said = {name: getattr(self, name) for name in self.model_fields_set | {"rough"}}
        return self.model_validate(earlier.model_dump(exclude_unset=True) | said)

    def check(self, scene: RelitScene) -> None:
        """Raises NotFoundError where it names what the scene does not have."""

    def apply(self, studio: Studio) -> None:
        """Make the change."""
        raise NotImplementedError


class Eye(_Change):
    """Look from elsewhere at the same place; what is left out stays."""

    kind: Literal["eye"]
    azimuth_deg: Bounded | None = None
    elevation_deg: float | None = Field(default=None, ge=-89, le=89)
    distance_mm: float | None = Field(default=None, ge=1, le=1e6)
    target_mm: Spot | None = None

    def apply(self, studio: Studio) -> None:
        """Move the eye."""
        orbit = studio.orbit
        if self.azimuth_deg is not None:
            orbit = replace(orbit, azimuth_rad=radians(self.azimuth_deg))
        if self.elevation_deg is not None:
            orbit = replace(orbit, elevation_rad=radians(self.elevation_deg))
        if self.distance_mm is not None:
            orbit = replace(orbit, distance_m=self.distance_mm / 1e3)
        if self.target_mm is not None:
            orbit = replace(orbit, target_m=Place.of(self.target_mm, (0, 0, 0)).place_m)
        studio.look(orbit)


class Move(_Change):
    """Put a body elsewhere, or turn it; what is left out stays."""

    kind: Literal["move"]
    body: Name
    place_mm: Spot | None = None
    turn_deg: Turn | None = None

    def check(self, scene: RelitScene) -> None:
        """Whether there is such a body."""
        _check_name("body", self.body, [body.name for body in scene.bodies])

    def apply(self, studio: Studio) -> None:
        """Move it."""
        place = studio.places[self.body]
        told = Place.of(self.place_mm or (0, 0, 0), self.turn_deg or (0, 0, 0))
        if self.place_mm is not None:
            place = replace(place, place_m=told.place_m)
        if self.turn_deg is not None:
            place = replace(place, turn_rad=told.turn_rad)
        studio.put(self.body, place)


class TurnLight(_Change):
    """Turn the light about the vertical."""

    kind: Literal["light"]
    azimuth_deg: Bounded

    def apply(self, studio: Studio) -> None:
        """Turn it."""
        studio.turn_light(radians(self.azimuth_deg))


class Exchange(_Change):
    """Light by another environment of the scene."""

    kind: Literal["environment"]
    name: Name

    def check(self, scene: RelitScene) -> None:
        """Whether the scene has it."""
        _check_name("environment", self.name, list(scene.environments))

    def apply(self, studio: Studio) -> None:
        """Exchange it."""
        studio.exchange(self.name)


class Paint(_Change):
    """Give a body a material of the scene, or one of numbers, which may have a name: files are for the scene to
    name."""

    kind: Literal["paint"]
    body: Name
    material: NamedMaterial
    name: Name | None = None

    @field_validator("material")
    @classmethod
    def _is_no_file(cls, material: NamedMaterial) -> NamedMaterial:
        if isinstance(material, ProductMaterial | MerlMaterial):
            raise ValueError("a material from a file is named in the scene's [materials], and painted by that name")
        return material

    def check(self, scene: RelitScene) -> None:
        """Whether there are such a body and material."""
        _check_name("body", self.body, [body.name for body in scene.bodies])
        if isinstance(self.material, str):
            _check_name("material", self.material, list(scene.materials))

    def apply(self, studio: Studio) -> None:
        """Paint it."""
        if isinstance(self.material, str):
            studio.paint(self.body, self.material, studio.scene.materials[self.material])
        elif not isinstance(self.material, ProductMaterial | MerlMaterial):  # which are no messages
            studio.paint(self.body, self.name or self.material.kind, material_brdf(self.material))


class Window(_Change):
    """Draw pictures of another size."""

    kind: Literal["window"]
    width_px: int = Field(ge=16, le=2048)
    height_px: int = Field(ge=16, le=2048)

    def apply(self, studio: Studio) -> None:
        """The next picture has that size."""
        studio.size = self.width_px, self.height_px


Change = Annotated[Eye | Move | TurnLight | Exchange | Paint | Window, Field(discriminator="kind")]
_CHANGE: TypeAdapter[Change] = TypeAdapter(Change)


def read_change(text: str) -> Change:
    """A message. Raises ConfigError that names the field that is wrong."""
    if len(text) > MOST_CHARACTERS:
        raise ConfigError(f"a message has at most {MOST_CHARACTERS} characters, this one {len(text)}")
    try:
        return _CHANGE.validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ConfigError(f"message: {where}: {first['msg']}" if where else f"message: {first['msg']}") from error


def _check_name(what: str, name: str, known: list[str]) -> None:
    if name not in known:
        raise NotFoundError(f"no {what} {name!r} in the scene, but {', '.join(known)}.")
