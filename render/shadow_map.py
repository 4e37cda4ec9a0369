"""Which points a distant light reaches: how far it comes in each pixel of its own picture of the scene."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from processing.products import Mesostructure, bilinear_taps
from render.arrays import Float64, Int32, Rows
from render.closed_mesh import is_closed
from render.light_view import SIDE_PX, LightView, light_view
from render.march import base, march, meets
from render.mesh import Mesh
from render.peeling import Layer, layers
from render.scene import Body
from render.sights import entries, plain_sight

# Of a slope beyond this no more is allowed for: a surface seen so flat is dark by its cosine.
_STEEPEST = 8.0


@dataclass(frozen=True, eq=False)
class ShadowMap:
    """`reach` (side, side): the distance at which light ends, infinite where nothing is in its way."""

    view: LightView
    reach: Float64

    def lit(self, points: Rows) -> Float64:
        """Share (n,) of light at world points (n, 3): bilinear, of the four pixels around, those that reach as far."""
        image = self.view.in_image(points)
        side = self.view.side_px
        rows, columns, weights = bilinear_taps((image[:, :2] + 0.5) / side, side, side, wrap=False)
        reached = image[:, 2:] <= self.reach[rows, columns]
        outside = ((image[:, :2] < 0.0) | (image[:, :2] > side - 1)).any(axis=1)
        return np.where(outside, 1.0, (weights * reached).sum(axis=1))


def shadow_map(bodies: Sequence[Body], direction: Rows, side_px: int = SIDE_PX) -> ShadowMap:
    """What bodies leave of the light that comes from `direction` (3,).

    A wrapped sample ends light at its base: what stands on the base is shaded by the BTF itself. Around a closed mesh
    it lets light by where a ray meets nothing. Source: Wang et al. 2005, 4.2.
    """
    view = light_view(direction, [body.mesh.positions for body in bodies], side_px)
    reach = np.full(side_px**2, np.inf)
    for body in bodies:
        pixel, ends = _ends(body, view)
        np.minimum.at(reach, pixel, ends)
    return ShadowMap(view, reach.reshape(side_px, side_px))


def _ends(body: Body, view: LightView) -> tuple[Int32, Float64]:
    """Pixels in which the body is in the light's way, and where light ends there."""
    if not isinstance(body.material, Mesostructure):
        return _faces(body.mesh, view)
    if is_closed(body.mesh):
        return _bases(body.mesh, body.material, view)
    return _bases_of_open(body.mesh, body.material, view)


def _faces(mesh: Mesh, view: LightView) -> tuple[Int32, Float64]:
    """Where light ends on the mesh itself, with room for the slope of what a pixel covers."""
    sight, _ = plain_sight(mesh, view)
    return sight.pixel, sight.distance + _room(view, sight.view[:, 2])


def _bases_of_open(mesh: Mesh, structure: Mesostructure, view: LightView) -> tuple[Int32, Float64]:
    """Where light ends under the mesh's nearest faces, all of which it meets."""
    sight, fragments = plain_sight(mesh, view)
    entry, _ = entries(mesh, fragments, view)
    return sight.pixel, sight.distance + base(structure, entry) + _room(view, entry.view[:, 2])


def _bases(mesh: Mesh, structure: Mesostructure, view: LightView) -> tuple[Int32, Float64]:
    """Where light ends under the first layer of the mesh in which it meets something."""
    undecided = np.ones(view.side_px**2, dtype=bool)
    reach = np.full(view.side_px**2, np.inf)
    for layer in layers(mesh, view):
        layer = layer.chosen(undecided[layer.front.pixel])
        hit, ends = _base(mesh, structure, layer, view)
        pixel = layer.front.pixel[hit]
        reach[pixel], undecided[pixel] = ends[hit], False
    pixel = np.flatnonzero(~undecided).astype(np.int32)
    return pixel, reach[pixel]


def _base(mesh: Mesh, structure: Mesostructure, layer: Layer, view: LightView) -> tuple[Rows, Float64]:
    """Which rays of a layer hit, and where they come to the base, but not beyond where they leave the mesh."""
    entry, _ = entries(mesh, layer.front, view)
    behind, _ = entries(mesh, layer.back, view, backward=True)
    hit = meets(march(structure, entry), march(structure, behind), layer.exit - layer.entry)
    deep = layer.entry + base(structure, entry) + _room(view, entry.view[:, 2])
    return hit, np.minimum(deep, layer.exit)


def _room(view: LightView, cosine: Float64) -> Float64:
    """How much farther (n,) a surface may lie at the far end of the pixels around a point."""
    slope = np.sqrt(np.maximum(1.0 - cosine**2, 0.0)) / np.maximum(cosine, 1e-6)
    return np.asarray(view.pixel * (0.5 + 1.5 * np.minimum(slope, _STEEPEST)))
