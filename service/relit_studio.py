"""A scene that is lit, looked at and changed: what changed is found anew, and only where a picture shows it."""

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self, TypeVar

import numpy as np

from processing.environment.equirectangular import panorama_of
from processing.geometry import rotation_z
from processing.lighting.brdfs import Brdf
from processing.lighting.directions import SampleDirections, sample_directions
from processing.lighting.precomputation import cached_self_visibility, outline_or_field
from processing.lighting.relighting import Recomputed, Relighting
from processing.lighting.shells import ShellPlan
from processing.lighting.surroundings import RelitBody
from processing.products import Environment
from processing.products.arrays import Float32, Float64
from processing.progress import Progress
from render.environment import Environment as Panorama
from render.picture import LUMINANCE, Srgb8
from render.relit_bodies import Background
from render.relit_view import open_relit_view
from service.relit_on_card import open_cached_frame
from service.relit_scene import Orbit, Place, RelitScene, SceneBody

Item = TypeVar("Item")
SIZE = (720, 480)
_ROUGH = 2  # times fewer pixels along a side
_WHITE = 0.65  # on the display, of a white surface in half of all the light: as a floor under an even sky
_ALBEDO = 0.8


@dataclass(frozen=True, eq=False)
class Shot:
    """A picture of the scene, display codes (h, w, 3), and what it took.

    `vertices` are those of the picture, of `vertices_of_scene`; of how many radiance came from fields anew, from known
    visibility, or was kept, `recomputed` says.
    """

    codes: Srgb8
    recomputed: Recomputed
    vertices: int
    vertices_of_scene: int
    lighting_s: float
    drawing_s: float


def precomputed(scene: RelitScene, folder: Path, report: Progress) -> list[RelitBody]:
    """The scene's bodies with their visibility; `folder` keeps it by content, so that it is computed once."""
    sampled = directions_of(scene)
    return [_precomputed(body, scene, sampled, folder, _Naming(report, body.name)) for body in scene.bodies]


def directions_of(scene: RelitScene) -> SampleDirections:
    """The sample directions that the scene asks for."""
    return sample_directions(scene.precomputation.directions.bit_length() - 1)


class Studio:
    """A scene at hand, used as a context manager by one thread, whose graphics context it is."""

    def __init__(self, scene: RelitScene, bodies: Sequence[RelitBody], size: tuple[int, int] = SIZE) -> None:
        self.scene, self.orbit, self.size = scene, scene.orbit, size
        self.places = {body.name: body.place for body in scene.bodies}
        self.materials = {body.name: body.material for body in scene.bodies}
        self.environment = next(iter(scene.environments))
        self.light_azimuth_rad = scene.light_azimuth_rad
        self._numbers = {body.name: number for number, body in enumerate(scene.bodies)}
        self._cached_frame = open_cached_frame()
        light = scene.environments[self.environment]
        self._relighting = Relighting(bodies, directions_of(scene), light, self._cached_frame)
        self._radiance: Float32 = np.zeros((int(self._relighting.first[-1]), 3), np.float32)
        self.turn_light(scene.light_azimuth_rad)
        for body in scene.bodies:
            self.put(body.name, body.place)
            self._relighting.paint(self._numbers[body.name], scene.materials[body.material])
        self._panorama: tuple[Environment, Panorama] | None = None
        with ExitStack() as opened:
            opened.callback(self._cached_frame.release)
            self._view = open_relit_view([body.mesh for body in scene.bodies])
            opened.pop_all()

    @property
    def renderer_name(self) -> str:
        """What draws."""
        return self._view.name

    def look(self, orbit: Orbit) -> None:
        """See it from elsewhere."""
        self.orbit = orbit

    def put(self, body: str, place: Place) -> None:
        """Move a body."""
        self._relighting.move(self._numbers[body], place.pose)
        self.places[body] = place

    def turn_light(self, azimuth_rad: float) -> None:
        """Turn the light about the vertical, from +X toward +Y."""
        self._relighting.turn_light(rotation_z(azimuth_rad)[:3, :3])
        self.light_azimuth_rad = azimuth_rad

    def exchange(self, environment: str) -> None:
        """Light the scene by another of its environments."""
        self._relighting.light_with(self.scene.environments[environment])
        self.environment = environment

    def paint(self, body: str, material: str, brdf: Brdf) -> None:
        """Give a body another reflectance, which has a name."""
        self._relighting.paint(self._numbers[body], brdf)
        self.materials[body] = material

    def draw(self, *, rough: bool = False) -> Shot:
        """The scene as it is now, in a window of `size` (width, height); a rough picture has half as many pixels
        along a side."""
        begun = time.perf_counter()
        width, height = (max(side // _ROUGH, 1) for side in self.size) if rough else self.size
        camera, poses = self.orbit.camera((width, height)), self._poses
        visible = self._view.visible(camera, poses)
        self._relighting.look_from(camera.eye)
        seen = time.perf_counter()
        frame = self._relighting.frame(visible)
        self._radiance[visible] = frame.radiance
        lit = time.perf_counter()
        codes = self._view.draw(camera, poses, self._radiance, self._background).srgb8(self._exposure)
        drawing_s = time.perf_counter() - lit + seen - begun
        return Shot(codes, frame.recomputed, len(visible), len(self._radiance), lit - seen, drawing_s)

    def close(self) -> None:
        """Give the graphics library's memory back."""
        self._view.release()
        self._cached_frame.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def _poses(self) -> list[Float64]:
        return [self.places[body.name].pose for body in self.scene.bodies]

    @property
    def _background(self) -> Background | None:
        """The environment as it is turned; one picture of it is kept."""
        if not self.scene.background:
            return None
        light = self.scene.environments[self.environment]
        if self._panorama is None or self._panorama[0] is not light:
            picture = np.asarray(panorama_of(light, 2 * light.size).picture, np.float32)
            self._panorama = light, Panorama(picture)
        return Background(self._panorama[1], rotation_z(self.light_azimuth_rad)[:3, :3])

    @property
    def _exposure(self) -> float:
        """Told by the light alone: the same from picture to picture, whatever they show."""
        light = 0.5 * float(self.scene.environments[self.environment].integral @ LUMINANCE)
        return float(2.0**self.scene.stops * _WHITE * np.pi / (_ALBEDO * light)) if light > 0 else 1.0


class _Naming:
    """Progress whose descriptions say of which body."""

    def __init__(self, report: Progress, name: str) -> None:
        self._report, self._name = report, name

    def track(self, items: Iterable[Item], description: str) -> Iterator[Item]:
        """Yield the items."""
        return self._report.track(items, f"{self._name}: {description}")


def _precomputed(
    body: SceneBody, scene: RelitScene, sampled: SampleDirections, folder: Path, report: Progress
) -> RelitBody:
    cuts, _ = cached_self_visibility(body.triangles, sampled, folder, report)
    if not body.casts:
        return RelitBody(body.triangles, cuts, None)
    shells = ShellPlan(scene.precomputation.resolution)
    return RelitBody(body.triangles, cuts, outline_or_field(body.triangles, sampled, folder, report, shells=shells))
