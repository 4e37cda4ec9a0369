"""The picture by OpenGL: one program per material, one framebuffer of linear float32."""

from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace

import moderngl
import numpy as np

from processing.products import Mesostructure
from render.arrays import Bool, Float32
from render.camera import Camera, rows_from_gl
from render.context import open_context, renderer_name
from render.layers import MOST_LAYERS, Layers, Wrapped, set_rays, wrapped_bodies
from render.light_view import SIDE_PX
from render.materials import Material
from render.mesh import Mesh
from render.on_card import Card, Target, by_columns
from render.picture import Picture
from render.programs import set_uniform
from render.rays import Rays, camera_rays
from render.scene import Body, Light, Scene
from render.shadows import LIGHTS, LastShadows, ShadowMaps

_DARK = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class GBuffer:
    """One light of unit irradiance: `radiance` (h, w, 3) and what it was computed from, where `mask` (h, w) is set.

    `uv` (h, w, 2) and the unit vectors `light` and `view` (h, w, 3) in the tangent frame; `footprint` (h, w, 2, 2), how
    texture coordinates change to the next pixel right and below.
    """

    radiance: Float32
    uv: Float32
    light: Float32
    view: Float32
    footprint: Float32
    mask: Bool


class GlRenderer:
    """Draws scenes with OpenGL; used by one thread at a time. Raises GlUnavailableError where there is no GL.

    Shadow maps have `shadow_side_px` pixels along each side. Rays are followed through `most_layers` of wrapped meshes;
    `layers` tells how many the last picture took.
    """

    affordable_supersampling = 2

    def __init__(self, shadow_side_px: int = SIDE_PX, most_layers: int = MOST_LAYERS) -> None:
        self.context = open_context()
        self.name = renderer_name(self.context)
        self.most_layers = most_layers
        self.layers = 0
        self._card = Card(self.context)
        self._shadows = LastShadows(self._card, shadow_side_px, most_layers)

    def draw(self, scene: Scene) -> Picture:
        """The scene as its camera sees it; pixels that show nothing are 0 in radiance and coverage."""
        with self.context:
            target = self._target(scene.camera.size, 1)
            radiance = np.zeros((*scene.camera.size[::-1], 3), np.float32)
            for part in _passes(scene):
                self._draw(part, frozenset(), target)
                image = _image(target, 0, scene.camera)
                radiance += image[:, :, :3]
        return Picture(radiance, np.ascontiguousarray(image[:, :, 3]))

    def draw_unread(self, scene: Scene) -> None:
        """Draw and wait until it is done, without reading the picture back: what a frame costs on a screen."""
        with self.context:
            for part in _passes(scene):
                self._draw(part, frozenset(), self._target(scene.camera.size, 1))
            self.context.finish()

    def g_buffer(self, scene: Scene, light: Light) -> GBuffer:
        """Shader results for one light of unit irradiance without shadows, with the inputs that the shader had."""
        with self.context:
            target = self._target(scene.camera.size, 5)
            self._draw(replace(scene, lights=(light,), shadows=False), frozenset({"G_BUFFER"}), target)
            radiance, uv, local, view, footprint = (_image(target, k, scene.camera) for k in range(5))
        footprint = footprint.reshape(*footprint.shape[:2], 2, 2)
        mask = radiance[:, :, 3] > 0.5
        return GBuffer(radiance[:, :, :3], uv[:, :, :2], local[:, :, :3], view[:, :, :3], footprint, mask)

    def release(self) -> None:
        """Give everything on the card back, the context last."""
        with self.context:
            self._card.release()
        self.context.release()

    def _program(
        self,
        frame: "_Frame",
        vertex: str,
        material: Material,
        defines: AbstractSet[str],
        images: Mapping[str, moderngl.Texture] | None = None,
    ) -> moderngl.Program:
        """The material's program with its textures bound and all uniforms set."""
        binding = self._card.binding(material)
        program = self._card.program(vertex, binding.shader, frame.defines | binding.defines | defines)
        maps = {} if frame.shadows is None else {"shadow_maps": frame.shadows.texture}
        binding.use(program, {**maps, **(images or {})})
        if frame.shadows is not None:
            frame.shadows.use(program)
        set_rays(program, frame.rays)
        _set_lights(program, frame.scene)
        return program

    def _target(self, size: tuple[int, int], images: int) -> Target:
        """Images of the picture, and one more of how far rays are known to meet nothing."""
        return self._card.target("picture", size, (4,) * images + (1,))

    def _draw(self, scene: Scene, defines: frozenset[str], target: Target) -> None:
        shadows = self._shadows.of(scene) if scene.shadows else None
        kinds = {"SHADOWS": shadows is not None, "AMBIENT": any(scene.ambient)}
        defines |= {name for name, wanted in kinds.items() if wanted}
        frame = _Frame(scene, camera_rays(scene.camera, scene.positions), shadows, defines)
        plain = [body for body in scene.bodies if not isinstance(body.material, Mesostructure)]
        images = range(len(target.images) - 1)
        picture = target.some(*images, deep=True)
        picture.use()
        picture.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        self.context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        for body in plain:
            self._draw_plain(frame, body)
        if wrapped := wrapped_bodies(scene.bodies):
            self._draw_wrapped(frame, wrapped, [body.mesh for body in plain], target)

    def _draw_plain(self, frame: "_Frame", body: Body) -> None:
        """A body as its mesh is."""
        gradient = {"GRADIENT_MAP"} if body.mesh.map_from_world is not None else set()
        program = self._program(frame, "surface.vert", body.material, gradient)
        set_uniform(program, "eye", tuple(map(float, frame.scene.camera.eye)))
        if body.mesh.map_from_world is not None:
            set_uniform(program, "map_from_world", by_columns(body.mesh.map_from_world))
        self._card.draw(program, body.mesh)

    def _draw_wrapped(self, frame: "_Frame", bodies: Sequence[Wrapped], hiding: Sequence[Mesh], target: Target) -> None:
        """All bodies that are covered with samples of known depth, as far as other meshes do not hide them."""

        def prepare(
            structure: Mesostructure, variant: frozenset[str], layer: dict[str, moderngl.Texture]
        ) -> moderngl.Program:
            return self._program(frame, "screen.vert", structure, variant, layer)

        self.layers = Layers(self._card, frame.rays, target, self.most_layers).peel(bodies, hiding, prepare)


@dataclass(frozen=True)
class _Frame:
    """One pass over a scene: its rays, the shadow maps if it has any, and what programs are compiled with."""

    scene: Scene
    rays: Rays
    shadows: ShadowMaps | None
    defines: frozenset[str]


def _passes(scene: Scene) -> Iterator[Scene]:
    """The scene with no more lights than one pass takes, as often as it needs; its ambient light only once."""
    for first in range(0, len(scene.lights), LIGHTS):
        lights = scene.lights[first : first + LIGHTS]
        yield replace(scene, lights=lights, ambient=scene.ambient if first == 0 else _DARK)


def _set_lights(program: moderngl.Program, scene: Scene) -> None:
    directions, irradiances = np.zeros((2, LIGHTS + 1, 3), dtype=np.float32)
    lights = scene.lights
    directions[: len(lights)] = [light.direction for light in lights]
    irradiances[: len(lights)] = [light.irradiance for light in lights]
    # Materials that do not know ambient light have it as one more light of theirs, whose direction is zero.
    as_light = any(scene.ambient) and "ambient_irradiance" not in program
    irradiances[len(lights)] = scene.ambient
    set_uniform(program, "ambient_irradiance", scene.ambient)
    set_uniform(program, "light_count", len(lights) + as_light)
    set_uniform(program, "light_direction", directions)
    set_uniform(program, "light_irradiance", irradiances)


def _image(target: Target, attachment: int, camera: Camera) -> Float32:
    """An image (h, w, 4), first row on top."""
    data = target.images[attachment].read()
    width, height = camera.size
    return np.asarray(rows_from_gl(np.frombuffer(data, dtype=np.float32).reshape(height, width, 4)))
