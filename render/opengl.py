"""The picture by OpenGL: one program per material, one framebuffer of linear float32."""

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import moderngl
import numpy as np

from render.arrays import Bool, Float32, Rows
from render.camera import Camera, clip_from_world, depth_range, rows_from_gl
from render.context import open_context, renderer_name
from render.materials import Material, upload
from render.mesh import Mesh
from render.picture import Picture
from render.programs import Binding, compile_program, set_uniform
from render.scene import Body, Light, Scene

# Meshes and materials that stay on the card, each: a moving light redraws the same few.
_KEPT = 8
_VERTEX = "surface.vert"
# Lights of one pass over the mesh, as in surface.glsl; more are drawn in several whose radiance is added.
_LIGHTS = 64
_DARK = (0.0, 0.0, 0.0)


class _OnCard(Protocol):
    """Something that occupies memory of the card."""

    def release(self) -> None: ...


Key = TypeVar("Key", bound=Hashable)
Held = TypeVar("Held", bound=_OnCard)


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


@dataclass(frozen=True)
class _Geometry:
    """A mesh on the card."""

    mesh: Mesh
    vertices: moderngl.Buffer
    triangles: moderngl.Buffer

    def release(self) -> None:
        self.vertices.release()
        self.triangles.release()


@dataclass(frozen=True)
class _Uploaded:
    """A material on the card; the material is held so that its identity stays its own."""

    material: Material
    binding: Binding

    def release(self) -> None:
        self.binding.release()


@dataclass(frozen=True)
class _Target:
    """A framebuffer of float32 images with a depth buffer."""

    framebuffer: moderngl.Framebuffer

    def release(self) -> None:
        for attachment in (*self.framebuffer.color_attachments, self.framebuffer.depth_attachment):
            attachment.release()
        self.framebuffer.release()


class GlRenderer:
    """Draws scenes with OpenGL; used by one thread at a time. Raises GlUnavailableError where there is no GL."""

    affordable_supersampling = 2

    def __init__(self) -> None:
        self.context = open_context()
        self.name = renderer_name(self.context)
        self._programs: dict[tuple[str, frozenset[str]], moderngl.Program] = {}
        self._geometries: OrderedDict[int, _Geometry] = OrderedDict()
        self._materials: OrderedDict[int, _Uploaded] = OrderedDict()
        self._targets: OrderedDict[tuple[tuple[int, int], int], _Target] = OrderedDict()

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
        """Shader results for one light of unit irradiance, with the inputs that the shader had."""
        with self.context:
            target = self._target(scene.camera.size, 5)
            self._draw(replace(scene, lights=(light,)), frozenset({"G_BUFFER"}), target)
            radiance, uv, local, view, footprint = (_image(target, k, scene.camera) for k in range(5))
        footprint = footprint.reshape(*footprint.shape[:2], 2, 2)
        mask = radiance[:, :, 3] > 0.5
        return GBuffer(radiance[:, :, :3], uv[:, :, :2], local[:, :, :3], view[:, :, :3], footprint, mask)

    def release(self) -> None:
        """Give everything on the card back, the context last."""
        with self.context:
            for kept in (self._geometries, self._materials, self._targets):
                for held in kept.values():
                    held.release()
                kept.clear()
            for program in self._programs.values():
                program.release()
            self._programs.clear()
        self.context.release()

    def _draw(self, scene: Scene, defines: frozenset[str], target: _Target) -> None:
        target.framebuffer.use()
        target.framebuffer.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        self.context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        for body in scene.bodies:
            self._draw_body(scene, body, defines)

    def _draw_body(self, scene: Scene, body: Body, defines: frozenset[str]) -> None:
        binding = self._material(body.material)
        if body.mesh.map_from_world is not None:
            defines |= {"GRADIENT_MAP"}
        program = self._program(binding.shader, defines | binding.defines)
        binding.use(program)
        _set_scene(program, scene)
        if body.mesh.map_from_world is not None:
            set_uniform(program, "map_from_world", _by_columns(body.mesh.map_from_world))
        geometry = self._geometry(body.mesh)
        layout = (geometry.vertices, "3f 3f 4f 2f", "position", "normal", "tangent", "uv")
        vertex_array = self.context.vertex_array(program, [layout], geometry.triangles, skip_errors=True)
        vertex_array.render()
        vertex_array.release()

    def _program(self, shader: str, defines: frozenset[str]) -> moderngl.Program:
        key = (shader, defines)
        if key not in self._programs:
            self._programs[key] = compile_program(self.context, _VERTEX, shader, defines)
        return self._programs[key]

    def _material(self, material: Material) -> Binding:
        return _keep(self._materials, id(material), lambda: _Uploaded(material, upload(self.context, material))).binding

    def _geometry(self, mesh: Mesh) -> _Geometry:
        def on_card() -> _Geometry:
            rows = np.hstack([mesh.positions, mesh.normals, mesh.tangents, mesh.uv]).astype(np.float32)
            triangles = self.context.buffer(np.ascontiguousarray(mesh.triangles, dtype=np.int32).tobytes())
            return _Geometry(mesh, self.context.buffer(rows.tobytes()), triangles)

        return _keep(self._geometries, id(mesh), on_card)

    def _target(self, size: tuple[int, int], images: int) -> _Target:
        def framebuffer() -> _Target:
            colours = [self.context.renderbuffer(size, 4, dtype="f4") for _ in range(images)]
            return _Target(self.context.framebuffer(colours, self.context.depth_renderbuffer(size)))

        return _keep(self._targets, (size, images), framebuffer)


def _keep(kept: OrderedDict[Key, Held], key: Key, make: Callable[[], Held]) -> Held:
    """What is kept under the key, made if need be; beyond the limit, the one used longest ago is given back."""
    if key not in kept:
        kept[key] = make()
        if len(kept) > _KEPT:
            kept.popitem(last=False)[1].release()
    kept.move_to_end(key)
    return kept[key]


def _passes(scene: Scene) -> Iterator[Scene]:
    """The scene with no more lights than one pass takes, as often as it needs; its ambient light only once."""
    for first in range(0, len(scene.lights), _LIGHTS):
        lights = scene.lights[first : first + _LIGHTS]
        yield replace(scene, lights=lights, ambient=scene.ambient if first == 0 else _DARK)


def _set_scene(program: moderngl.Program, scene: Scene) -> None:
    near, far = depth_range(scene.camera, scene.positions)
    set_uniform(program, "clip_from_world", _by_columns(clip_from_world(scene.camera, near, far)))
    set_uniform(program, "eye", tuple(map(float, scene.camera.eye)))
    directions, irradiances = np.zeros((2, _LIGHTS + 1, 3), dtype=np.float32)
    lights = scene.lights
    directions[: len(lights)] = [light.direction for light in lights]
    # Ambient light is one more pass of the shader's loop, whose direction is zero: a branch would cost every pixel.
    irradiances[: len(lights)] = [light.irradiance for light in lights]
    irradiances[len(lights)] = scene.ambient
    set_uniform(program, "light_count", len(lights) + any(scene.ambient))
    set_uniform(program, "light_direction", directions)
    set_uniform(program, "light_irradiance", irradiances)


def _by_columns(matrix: Rows) -> Float32:
    """A matrix as it is written to the card."""
    return matrix.T.astype(np.float32)


def _image(target: _Target, attachment: int, camera: Camera) -> Float32:
    """An image of the framebuffer (h, w, 4), first row on top."""
    data = target.framebuffer.read(components=4, attachment=attachment, dtype="f4", alignment=1)
    width, height = camera.size
    return np.asarray(rows_from_gl(np.frombuffer(data, dtype=np.float32).reshape(height, width, 4)))
