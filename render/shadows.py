"""Shadow maps on the graphics card: those of all lights side by side in one texture (render/shadow_map.py)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import moderngl
import numpy as np

from processing.products import Mesostructure
from render.arrays import Float32, Float64
from render.layers import FAR, Layers, set_rays, wrapped_bodies
from render.light_view import LightView, light_view
from render.mesh import Mesh
from render.on_card import Card, Target
from render.programs import bind, set_uniform
from render.rays import Rays, light_rays
from render.scene import Body, Scene

# Lights of one pass over the scene, as in lighting.glsl and shadow.glsl.
LIGHTS = 64


@dataclass(frozen=True)
class ShadowMaps:
    """The texture, and how shaders find their place in it."""

    texture: moderngl.Texture
    rows: Float32
    windows: Float32

    @property
    def given_back(self) -> bool:
        """Whether the card needed the place for other images."""
        return isinstance(self.texture.mglo, moderngl.InvalidObject)

    def use(self, program: moderngl.Program) -> None:
        """Tell a program where the maps are; the texture is bound with its others."""
        set_uniform(program, "shadow_rows", self.rows)
        set_uniform(program, "shadow_windows", self.windows)


class LastShadows:
    """The shadow maps of the scene that was drawn last: as long as its bodies and lights stay, they are kept."""

    def __init__(self, card: Card, side_px: int, most_layers: int) -> None:
        self._card, self._side_px, self._most_layers = card, side_px, most_layers
        self._bodies: tuple[Body, ...] = ()
        self._directions: tuple[Float64, ...] = ()
        self._maps: ShadowMaps | None = None

    def of(self, scene: Scene) -> ShadowMaps:
        """Those of this scene, drawn if they are not those of the last one."""
        if self._maps is not None and self._shows(scene) and not self._maps.given_back:
            return self._maps
        self._maps = None
        maps = shadow_maps(self._card, scene, self._side_px, self._most_layers)
        self._bodies = scene.bodies
        self._directions = tuple(light.direction.copy() for light in scene.lights)
        self._maps = maps
        return maps

    def _shows(self, scene: Scene) -> bool:
        """Whether the scene has the same meshes and materials, held here so that they stay themselves, and lights."""
        if (len(scene.bodies), len(scene.lights)) != (len(self._bodies), len(self._directions)):
            return False
        same = all(
            one.mesh is other.mesh and one.material is other.material
            for one, other in zip(scene.bodies, self._bodies, strict=True)
        )
        lights = zip(scene.lights, self._directions, strict=True)
        return same and all(np.array_equal(light.direction, direction) for light, direction in lights)


def shadow_maps(card: Card, scene: Scene, side_px: int, most_layers: int) -> ShadowMaps:
    """How far the light of each of the scene's lights comes."""
    views = [
        light_view(each.direction, [body.mesh.positions for body in scene.bodies], side_px) for each in scene.lights
    ]
    columns = math.ceil(math.sqrt(len(views)))
    corners = [(number % columns * side_px, number // columns * side_px) for number in range(len(views))]
    single = card.target("reach", (side_px, side_px), (1, 1))
    if len(views) == 1:
        _draw(card, scene, views[0], single, most_layers)
        texture = single.images[0]
    else:
        together = card.target("reaches", (columns * side_px, (corners[-1][1] // side_px + 1) * side_px), (1,))
        for view, corner in zip(views, corners, strict=True):
            _draw(card, scene, view, single, most_layers)
            _copy(card, single.images[0], together, corner)
        texture = together.images[0]
    # Ambient light may be one light more, which nothing shades: no place is in its window of no size.
    rows, windows = np.zeros((LIGHTS + 1, 3, 4), np.float32), np.full((LIGHTS + 1, 4), -1.0, np.float32)
    rows[: len(views)] = [_in_texture(view, corner) for view, corner in zip(views, corners, strict=True)]
    windows[: len(views)] = [(x, y, x + side_px - 1, y + side_px - 1) for x, y in corners]
    return ShadowMaps(texture, rows, windows)


def _draw(card: Card, scene: Scene, view: LightView, target: Target, most_layers: int) -> None:
    """The map of one light, in the first image of the target; the second is for the peeling."""
    target.some(0).clear(red=FAR)
    rays = light_rays(view, scene.positions)
    wrapped = wrapped_bodies(scene.bodies)

    def prepare(
        structure: Mesostructure, variant: frozenset[str], images: dict[str, moderngl.Texture]
    ) -> moderngl.Program:
        program = card.program("screen.vert", "base.frag", variant)
        card.binding(structure).use(program, images)
        set_rays(program, rays)
        set_uniform(program, "pixel", view.pixel)
        return program

    if wrapped:
        Layers(card, rays, target, most_layers).peel(wrapped, (), prepare)
    plain = [body.mesh for body in scene.bodies if not isinstance(body.material, Mesostructure)]
    _draw_faces(card, plain, rays, view, target)


def _draw_faces(card: Card, meshes: Sequence[Mesh], rays: Rays, view: LightView, target: Target) -> None:
    """Lower the first image to where light ends on the meshes as they are."""
    context = card.context
    program = card.program("surface.vert", "face.frag")
    set_rays(program, rays)
    set_uniform(program, "pixel", view.pixel)
    context.enable_only(moderngl.CULL_FACE | moderngl.BLEND)
    context.blend_equation = moderngl.MIN, moderngl.MIN
    target.some(0).use()
    for mesh in meshes:
        card.draw(program, mesh)
    context.blend_equation = moderngl.FUNC_ADD, moderngl.FUNC_ADD


def _copy(card: Card, image: moderngl.Texture, target: Target, corner: tuple[int, int]) -> None:
    program = card.program("screen.vert", "copy.frag")
    bind(program, {"source": image})
    program["corner"] = corner
    card.context.enable_only(moderngl.NOTHING)
    framebuffer = target.some(0)
    framebuffer.viewport = (*corner, *image.size)
    framebuffer.use()
    card.fill(program)


def _in_texture(view: LightView, corner: tuple[int, int]) -> Float64:
    """Rows (3, 4) that take world points to pixels of the texture, counted upward, and to the distance."""
    rows = view.image_from_world.copy()
    rows[0, 3] += corner[0]
    rows[1] *= -1.0
    rows[1, 3] += corner[1] + view.side_px - 1
    return rows
