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

# A ray goes in and out of a mesh no more often than this: no scene asks for it, but rounding might.
MOST_LAYERS = 64
# Of the depth buffer's range, for each material: exact in float32 and in buffers of 16 bits or more.
_DEPTH = 2.0**-10
# Farther than anything, as in march.glsl.
FAR = 1e30

QUICK, THOROUGH = frozenset[str](), frozenset({"THOROUGH"})
# Makes the program ready that draws what rays meet of a material: with these defines, and with the layer's images.
Prepare = Callable[[Mesostructure, frozenset[str], dict[str, moderngl.Texture]], moderngl.Program]


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
    """The rays of one view, and what is made of them.

    `target` holds the images to be drawn; in the last of them shaders mark the pixels that are decided.
    """

    card: Card
    rays: Rays
    target: Target
    most: int = MOST_LAYERS

    def peel(self, bodies: Sequence[Wrapped], hiding: Sequence[Mesh], prepare: Prepare) -> int:
        """Draw what rays meet, layer after layer, until no front face is left, or until the most; their number.

        `hiding` meshes hide what lies behind them.
        """
        structures = {id(body.structure): body.structure for body in bodies}
        numbers = {key: number for number, key in enumerate(structures, start=1)}
        front, back = (self.card.target(side, self.rays.size, (4, 4, 4)) for side in ("front", "back"))
        images = _named(front, "front") | _named(back, "back")
        back.some(0).clear()
        self.target.some(self._last).clear()
        for layer in range(self.most):
            self._start(front, first=layer == 0)
            if not self._fronts(front, bodies, numbers, back.images[0], hiding):
                return layer
            self._start(back, first=layer == 0)
            back.some(0).clear(red=FAR)
            self._backs(back, bodies, numbers, front.images[0])
            # After the first layer few rays are left, and most of them pass near the back.
            for variant in (QUICK, THOROUGH) if layer == 0 else (THOROUGH,):
                self._mark_waiting(front)
                for key, structure in structures.items():
                    program = prepare(structure, variant, images)
                    self._fill(program, numbers[key])
        return self.most

    @property
    def _last(self) -> int:
        return len(self.target.images) - 1

    def _start(self, target: Target, *, first: bool) -> None:
        """Clear the depth buffer; what is decided lies before everything, so that it is left out early."""
        target.some(deep=True).clear(depth=1.0)
        if not first:
            self._fill_depth("undecided.frag", target, {"decided": self.target.images[-1]})

    def _mark_waiting(self, front: Target) -> None:
        images = {"front_place": front.images[0], "decided": self.target.images[-1]}
        self._fill_depth("waiting.frag", self.target, images)

    def _fill_depth(self, fragment: str, target: Target, images: dict[str, moderngl.Texture]) -> None:
        """Let a shader write the depth buffer."""
        context = self.card.context
        context.enable_only(moderngl.DEPTH_TEST)
        context.depth_func = "1"
        program = self.card.program("screen.vert", fragment)
        bind(program, images)
        set_uniform(program, "share", _DEPTH)
        target.some(deep=True).use()
        self.card.fill(program)
        context.depth_func = "<"

    def _fill(self, program: moderngl.Program, number: int) -> None:
        """Draw all images of the target where its depth buffer says that this material waits."""
        context = self.card.context
        context.enable_only(moderngl.DEPTH_TEST)
        context.depth_func = "=="
        set_uniform(program, "depth", _DEPTH * number)
        framebuffer = self.target.whole
        framebuffer.depth_mask = False
        framebuffer.use()
        self.card.fill(program)
        framebuffer.depth_mask = True
        context.depth_func = "<"

    def _fronts(
        self,
        target: Target,
        bodies: Sequence[Wrapped],
        numbers: dict[int, int],
        beyond: moderngl.Texture,
        hiding: Sequence[Mesh],
    ) -> bool:
        """Draw the nearest front faces beyond a distance; whether there are any."""
        context = self.card.context
        context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        target.some(0).clear(red=FAR)
        if hiding:
            target.some(deep=True).use()
            program = self.card.program("surface.vert", "depth.frag")
            set_rays(program, self.rays)
            for mesh in hiding:
                self.card.draw(program, mesh)
        target.whole.use()
        query = context.query(samples=True)
        with query:
            self._draw(bodies, numbers, beyond)
        return bool(query.samples)

    def _backs(
        self, target: Target, bodies: Sequence[Wrapped], numbers: dict[int, int], fronts: moderngl.Texture
    ) -> None:
        """Draw the nearest back faces beyond the front faces."""
        context = self.card.context
        context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
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
