"""The way of each pixel's ray through a closed mesh, from one front face to the next back face, layer by layer."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from render.arrays import Float64, Int32
from render.camera import Camera
from render.light_view import LightView
from render.mesh import Mesh
from render.rasteriser import Fragments, all_fragments, first_of_each

View = Camera | LightView


@dataclass(frozen=True, eq=False)
class Layer:
    """Rays inside a mesh: for each pixel that has this layer, where it enters and where it leaves.

    `front` and `back` are of the same pixels, ascending; `entry` and `exit` (n,) the distances along the ray.
    """

    front: Fragments
    back: Fragments
    entry: Float64
    exit: Float64

    def chosen(self, which: Int32) -> "Layer":
        """Those that an index or a mask (n,) names."""
        return Layer(self.front.chosen(which), self.back.chosen(which), self.entry[which], self.exit[which])


def layers(mesh: Mesh, view: View) -> Iterator[Layer]:
    """From near to far: the nearest front face beyond the last layer, and the nearest back face beyond that.

    What a ray meets before it first enters does not count: a camera inside the mesh sees nothing of the part that it
    stands in. Source: Wang et al. 2005, 4.1, fig. 7.
    """
    fronts, entries = _sorted(mesh, view, front=True)
    backs, exits = _sorted(mesh, view, front=False)
    passed = np.full(view.size[0] * view.size[1], -np.inf)
    while True:
        front = _next(fronts, entries, passed)
        passed.fill(np.inf)
        passed[fronts.pixel[front]] = entries[front]
        back = _next(backs, exits, passed)
        front = front[np.isin(fronts.pixel[front], backs.pixel[back])]
        if not len(front):
            return
        yield Layer(fronts.chosen(front), backs.chosen(back), entries[front], exits[back])
        passed.fill(np.inf)
        passed[backs.pixel[back]] = exits[back]


def _sorted(mesh: Mesh, view: View, *, front: bool) -> tuple[Fragments, Float64]:
    """All faces that look toward the view, or away from it, and how far along their rays."""
    fragments = all_fragments(mesh, view.projected(mesh.positions), view.size, front=front)
    return fragments, view.distance(fragments.interpolate(mesh, mesh.positions))


def _next(fragments: Fragments, distance: Float64, passed: Float64) -> Int32:
    """Numbers of the nearest fragments beyond what is passed in their pixels, pixels ascending."""
    beyond = np.flatnonzero(distance > passed[fragments.pixel])
    return np.asarray(beyond[first_of_each(fragments.pixel[beyond], distance[beyond])])
