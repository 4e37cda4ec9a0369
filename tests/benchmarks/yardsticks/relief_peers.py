"""Other ways to draw relief in real time: height maps under the surface, searched per pixel by shaders of their own.

Parallax mapping with offset limiting (Kaneko et al. 2001, Welsh 2004), parallax occlusion mapping (Tatarchuk 2006:
linear search and a secant), relief mapping (Policarpo et al. 2005: linear and binary search), and relief mapping whose
rays bend with the surface, so that they miss it at silhouettes (Oliveira and Policarpo 2005; the frame turns with the
ray, which is not in the paper). All but the first shade themselves. Their maps are true: normal, depth, albedo,
specular and roughness of the sample from straight above, and the shader reflects as the ray-traced samples do. What
lies under an overhang is not in a height map.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from render.arrays import unit
from render.camera import clip_from_world, depth_range, rows_from_gl
from render.mesh import Mesh
from render.picture import Picture
from render.programs import compile_program, set_uniform
from render.scene import Light
from render.wrapping import wrapping
from simulators.far_field import first_hits, one_period, ray_places
from tests.benchmarks.yardsticks.figure_scenes import CoveredMesh, FigureScene

Array = NDArray[Any]

METHODS = {
    "parallax, offset limiting": "PARALLAX",
    "parallax occlusion": "OCCLUSION",
    "relief": "RELIEF",
    "relief with silhouettes": "CURVED",
}
_RAYS = 4  # to a texel
_FOLDER = Path(__file__).parent / "shaders"
_FORMAT = ("3f 3f 4f 2f 2f 3f", "position", "normal", "tangent", "uv", "stretch", "bending")


@dataclass(frozen=True, eq=False)
class ReliefMaps:
    """A sample from straight above, in 8 bits as it lies on the card.

    `shapes` (y, x, 4) uint8: normal along t and b, halved and a half added, roughness, depth over `deepest`, which is
    in tiles; `colours` (y, x, 4) uint8: albedo and specular.
    """

    shapes: NDArray[np.uint8]
    colours: NDArray[np.uint8]
    deepest: float

    @property
    def nbytes(self) -> int:
        """Bytes on the card."""
        return self.shapes.nbytes + self.colours.nbytes


def relief_maps(sample: str, seed: int, texels: int) -> ReliefMaps:
    """Means over what a few rays to a texel find, without noise."""
    up = np.array([0.0, 0.0, 1.0])
    body, period_m = one_period(sample, seed, (up[None], up[None]))
    hits = first_hits((body, period_m), ray_places(texels, _RAYS, period_m), up, 0.0)
    rows = np.column_stack([hits.normals, hits.material.albedo, hits.material.specular, hits.material.roughness])
    found = np.zeros((texels * texels * _RAYS, 9))
    found[hits.ray] = np.column_stack([rows, -hits.points[:, 2] / period_m])
    mean = found.reshape(texels, texels, _RAYS, 9).mean(axis=2)
    normal, depth = unit(mean[..., :3]), mean[..., 8]
    deepest = max(float(depth.max()), 1e-9)
    shapes = np.dstack([0.5 * normal[..., :2] + 0.5, mean[..., 7], depth / deepest])
    return ReliefMaps(_codes(shapes), _codes(mean[..., 3:7]), deepest)


class ReliefRenderer:
    """Draws figure scenes by one of `METHODS` under their first light, without shadows of one body on another."""

    def __init__(self, context: moderngl.Context) -> None:
        self.context = context
        self._kept: list[Any] = []
        self._vertices: dict[int, tuple[Mesh, moderngl.Buffer, moderngl.Buffer]] = {}
        self._textures: dict[int, tuple[ReliefMaps, moderngl.Texture, moderngl.Texture]] = {}
        self._targets: dict[tuple[int, int], moderngl.Framebuffer] = {}
        with context:
            self._programs = {
                method: self._keep(compile_program(context, "relief.vert", "relief.frag", frozenset({name}), _FOLDER))
                for method, name in METHODS.items()
            }

    def draw(self, method: str, figure: FigureScene, maps: Mapping[str, ReliefMaps]) -> Picture:
        """The picture; pixels that show nothing are 0 in radiance and coverage."""
        with self.context:
            target = self._draw(method, figure, maps)
            width, height = figure.camera.size
            data = np.frombuffer(target.read(components=4, dtype="f4", alignment=1), np.float32)
        image = np.ascontiguousarray(rows_from_gl(data.reshape(height, width, 4)))
        return Picture(np.ascontiguousarray(image[:, :, :3]), np.ascontiguousarray(image[:, :, 3]))

    def draw_unread(self, method: str, figure: FigureScene, maps: Mapping[str, ReliefMaps]) -> None:
        """Draw and wait until it is done."""
        with self.context:
            self._draw(method, figure, maps)
            self.context.finish()

    def release(self) -> None:
        """Give back what lies on the card; the context stays."""
        with self.context:
            for held in self._kept:
                held.release()

    def _draw(self, method: str, figure: FigureScene, maps: Mapping[str, ReliefMaps]) -> moderngl.Framebuffer:
        target, program = self._target(figure.camera.size), self._programs[method]
        target.use()
        target.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        self.context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        positions = np.concatenate([body.mesh.positions for body in figure.bodies])
        _set_view(program, figure, figure.lights[0], depth_range(figure.camera, positions))
        for body in figure.bodies:
            self._draw_body(program, body, maps[body.sample])
        return target

    def _draw_body(self, program: moderngl.Program, body: CoveredMesh, maps: ReliefMaps) -> None:
        for number, (name, texture) in enumerate(zip(("shapes", "colours"), self._maps(maps), strict=True)):
            texture.use(number)
            set_uniform(program, name, number)
        set_uniform(program, "deepest", maps.deepest)
        vertices, triangles = self._mesh(body.mesh)
        drawn = self.context.vertex_array(program, [(vertices, *_FORMAT)], triangles, skip_errors=True)
        drawn.render()
        drawn.release()

    def _mesh(self, mesh: Mesh) -> tuple[moderngl.Buffer, moderngl.Buffer]:
        if id(mesh) not in self._vertices:
            wrapped = wrapping(mesh)
            rows = np.hstack(
                [mesh.positions, mesh.normals, mesh.tangents, mesh.uv, wrapped.stretch, wrapped.bending]
            ).astype(np.float32)
            buffers = (rows, np.ascontiguousarray(mesh.triangles, dtype=np.int32))
            vertices, triangles = (self._keep(self.context.buffer(each.tobytes())) for each in buffers)
            self._vertices[id(mesh)] = (mesh, vertices, triangles)
        return self._vertices[id(mesh)][1:]

    def _maps(self, maps: ReliefMaps) -> tuple[moderngl.Texture, moderngl.Texture]:
        if id(maps) not in self._textures:
            shapes, colours = (self._texture(each) for each in (maps.shapes, maps.colours))
            self._textures[id(maps)] = (maps, shapes, colours)
        return self._textures[id(maps)][1:]

    def _texture(self, values: Array) -> moderngl.Texture:
        """Repeats, filtered by the card."""
        height, width, _ = values.shape
        texture = self.context.texture((width, height), 4, np.ascontiguousarray(values).tobytes(), alignment=1)
        texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        return self._keep(texture)

    def _target(self, size: tuple[int, int]) -> moderngl.Framebuffer:
        if size not in self._targets:
            colour = self._keep(self.context.renderbuffer(size, 4, dtype="f4"))
            depth = self._keep(self.context.depth_renderbuffer(size))
            self._targets[size] = self._keep(self.context.framebuffer([colour], depth))
        return self._targets[size]

    def _keep(self, held: Any) -> Any:
        self._kept.append(held)
        return held


def _set_view(program: moderngl.Program, figure: FigureScene, light: Light, reach: tuple[float, float]) -> None:
    clip = clip_from_world(figure.camera, *reach)
    set_uniform(program, "clip_from_world", clip.T.astype(np.float32))
    set_uniform(program, "eye", tuple(map(float, figure.camera.eye)))
    set_uniform(program, "light_direction", tuple(map(float, light.direction)))
    set_uniform(program, "light_irradiance", tuple(map(float, light.irradiance)))


def _codes(values: Array) -> NDArray[np.uint8]:
    """8-bit codes of values in [0, 1]."""
    return np.asarray(np.rint(255.0 * np.clip(values, 0.0, 1.0)), np.uint8)
