"""Depth peeling on the graphics card: the ways of rays through wrapped meshes, one layer after the other.

Source: Wang et al. 2005, 4.1, fig. 7. Distances are along the rays, never the window's z.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import moderngl

from processing.products import Mesostructure
from render.closed_mesh import is_closed
from render.mesh import Mesh
from render.on_card import Card, Target, by_columns
from render.programs import bind, set_uniform
from render.rays import Rays
from render.scene import Body

MOST_LAYERS = 64
# Farther than anything, as in march.glsl.
FAR = 1e30

# Draws what the rays of a layer meet: material, its number in the layer's images, and these images by their names.
Ask = Callable[[Mesostructure, int, dict[str, moderngl.Texture]], None]


@dataclass(frozen=True, eq=False)
class Wrapped:
    """A mesh that is covered with a sample of known depth, and whether it is closed: an open one has no silhouettes."""

    mesh: Mesh
    structure: Mesostructure
    closed: bool


def wrapped_bodies(bodies: Sequence[Body]) -> list[Wrapped]:
    """Those whose material has a depth."""
    return [
        Wrapped(body.mesh, body.material, is_closed(body.mesh))
        for body in bodies
        if isinstance(body.material, Mesostructure)
    ]


@dataclass(frozen=True)
class Layers:
    """The rays of one view, and images for where they enter and leave.

    `passed` is the image in which `ask` leaves how far each ray is known to meet nothing, and FAR where it is decided.
    """

    card: Card
    rays: Rays
    passed: moderngl.Texture

    def peel(self, bodies: Sequence[Wrapped], hiding: Sequence[Mesh], ask: Ask) -> int:
        """Ask of layer after layer until no front face is left; the number of layers.

        `hiding` meshes hide what lies behind them.
        """
        structures = {id(body.structure): body.structure for body in bodies}
        numbers = {key: number for number, key in enumerate(structures, start=1)}
        front, back = (self.card.target(side, self.rays.size, (4, 4, 4)) for side in ("front", "back"))
        images = _named(front, "front") | _named(back, "back")
        back.some(0).clear()
        for layer in range(MOST_LAYERS):
            if not self._fronts(front, bodies, numbers, hiding):
                return layer
            self._backs(back, bodies, numbers, front.images[0])
            for key, structure in structures.items():
                ask(structure, numbers[key], images)
        return MOST_LAYERS

    def _fronts(
        self, target: Target, bodies: Sequence[Wrapped], numbers: dict[int, int], hiding: Sequence[Mesh]
    ) -> bool:
        """Draw the nearest front faces beyond what is passed; whether there are any."""
        context = self.card.context
        context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        target.some(0, 2).clear(red=FAR)
        depth = target.some(deep=True)
        depth.use()
        depth.clear(depth=1.0)
        program = self.card.program("surface.vert", "depth.frag")
        set_rays(program, self.rays)
        for mesh in hiding:
            self.card.draw(program, mesh)
        target.whole.use()
        query = context.query(samples=True)
        with query:
            self._draw(bodies, numbers, self.passed)
        return bool(query.samples)

    def _backs(
        self, target: Target, bodies: Sequence[Wrapped], numbers: dict[int, int], fronts: moderngl.Texture
    ) -> None:
        """Draw the nearest back faces beyond the front faces."""
        context = self.card.context
        target.some(deep=True).clear(depth=1.0)
        target.whole.use()
        context.cull_face = "front"
        self._draw(bodies, numbers, fronts)
        context.cull_face = "back"

    def _draw(self, bodies: Sequence[Wrapped], numbers: dict[int, int], beyond: moderngl.Texture) -> None:
        program = self.card.program("surface.vert", "layer.frag", frozenset({"WRAPPED"}))
        set_rays(program, self.rays)
        bind(program, {"beyond": beyond})
        for body in bodies:
            number = numbers[id(body.structure)]
            set_uniform(program, "number", float(number if body.closed else -number))
            self.card.draw(program, body.mesh, wrapped=True)


def _named(target: Target, side: str) -> dict[str, moderngl.Texture]:
    names = (f"{side}_{what}" for what in ("place", "upward", "along"))
    return dict(zip(names, target.images, strict=True))


def set_rays(program: moderngl.Program, rays: Rays) -> None:
    """Tell a program the rays."""
    set_uniform(program, "clip_from_world", by_columns(rays.clip_from_world))
    set_uniform(program, "start_from_window", by_columns(rays.start_from_window))
    set_uniform(program, "toward_from_window", by_columns(rays.toward_from_window))
