"""What a body shows in each pixel: the point, and where and whence its material is asked."""

import logging
from dataclasses import dataclass

import numpy as np

from processing.products import Mesostructure
from render.arrays import Float64, Int32, Rows
from render.closed_mesh import is_closed
from render.frames import gradient_frames, vertex_frames
from render.march import Entry, Meeting, march, meets
from render.mesh import Mesh
from render.peeling import Layer, View, layers
from render.rasteriser import Fragments, all_fragments, first_of_each
from render.wrapping import wrapping

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Sight:
    """Points of a body, one for each pixel that sees it.

    Flat `pixel` indices and `distance` (n,) along the pixel's ray; `point` (n, 3) in the world. The material is asked
    at `uv` (n, 2) for `view` (n, 3). Rows t, b, n of `frames` (n, 3, 3) are in the world frame; vectors in them,
    divided by `tile` (n, 3) and made unit, are in tiles, as `view` is.
    """

    pixel: Int32
    distance: Float64
    point: Float64
    uv: Float64
    view: Float64
    frames: Float64
    tile: Float64

    def chosen(self, which: Rows | slice) -> "Sight":
        """Those that an index, a mask (n,) or a slice names."""
        return Sight(*(getattr(self, name)[which] for name in self.__dataclass_fields__))


def plain_sight(mesh: Mesh, view: View) -> tuple[Sight, Fragments]:
    """The nearest front faces, and the fragments that they are."""
    fragments = _nearest(mesh, view)
    point = fragments.interpolate(mesh, mesh.positions)
    uv, frames = textured(mesh, fragments)
    toward = rotated(frames, view.toward(point))
    return Sight(fragments.pixel, view.distance(point), point, uv, toward, frames, np.ones_like(point)), fragments


def relief_sight(mesh: Mesh, structure: Mesostructure, view: View) -> Sight:
    """What is wrapped around the mesh: layer by layer what rays meet; of an open mesh all that its front faces show."""
    if not is_closed(mesh):
        _log.info("a mesh that is open has no silhouettes of its sample: it is drawn up to its own outline")
        fragments = _nearest(mesh, view)
        entry, frames = entries(mesh, fragments, view)
        return _sight(mesh, fragments, view, entry, frames, march(structure, entry))
    undecided = np.ones(view.size[0] * view.size[1], dtype=bool)
    found = []
    for layer in layers(mesh, view):
        layer = layer.chosen(undecided[layer.front.pixel])
        sight = _met(mesh, structure, layer, view)
        undecided[sight.pixel] = False
        found.append(sight)
    return _together(found)


def entries(mesh: Mesh, fragments: Fragments, view: View, *, backward: bool = False) -> tuple[Entry, Float64]:
    """The rays through fragments as they enter there, or backward from where they leave, and the frames (n, 3, 3)."""
    wrap = wrapping(mesh)
    uv, frames = textured(mesh, fragments)
    toward = view.toward(fragments.interpolate(mesh, mesh.positions)) * (-1.0 if backward else 1.0)
    stretch, bending = (fragments.interpolate(mesh, each) for each in (wrap.stretch, wrap.bending))
    return Entry(uv, rotated(frames, toward), stretch, bending), frames


def textured(mesh: Mesh, fragments: Fragments) -> tuple[Float64, Float64]:
    """Texture coordinates (n, 2) and rows t, b, n (n, 3, 3) in the world frame."""
    normal = fragments.interpolate(mesh, mesh.normals)
    if mesh.map_from_world is not None:
        return gradient_frames(normal, mesh.map_from_world)
    return fragments.interpolate(mesh, mesh.uv), vertex_frames(normal, fragments.interpolate(mesh, mesh.tangents))


def rotated(frames: Rows, vectors: Rows) -> Float64:
    """World vectors (n, 3) along the frames' rows."""
    return np.asarray(np.einsum("nij,nj->ni", frames, vectors))


def _nearest(mesh: Mesh, view: View) -> Fragments:
    found = all_fragments(mesh, view.projected(mesh.positions), view.size)
    distance = view.distance(found.interpolate(mesh, mesh.positions))
    return found.chosen(first_of_each(found.pixel, distance))


def _met(mesh: Mesh, structure: Mesostructure, layer: Layer, view: View) -> Sight:
    """The rays of a layer that hit."""
    entry, frames = entries(mesh, layer.front, view)
    behind, _ = entries(mesh, layer.back, view, backward=True)
    front, back = march(structure, entry), march(structure, behind)
    hit = meets(front, back, layer.exit - layer.entry)
    return _sight(mesh, layer.front, view, entry, frames, front).chosen(hit)


def _sight(mesh: Mesh, fragments: Fragments, view: View, entry: Entry, frames: Float64, meeting: Meeting) -> Sight:
    surface = fragments.interpolate(mesh, mesh.positions)
    point = surface - meeting.distance[:, None] * view.toward(surface)
    scale = np.sqrt(entry.stretch.prod(axis=1, keepdims=True))
    tile = np.hstack([entry.stretch, scale])
    return Sight(fragments.pixel, view.distance(point), point, meeting.uv, meeting.view, meeting.turn @ frames, tile)


def _together(found: list[Sight]) -> Sight:
    if not found:
        none = np.zeros((0, 3))
        return Sight(np.zeros(0, np.int32), none[:, 0], none, none[:, :2], none, np.zeros((0, 3, 3)), none)
    return Sight(*(np.concatenate([getattr(each, name) for each in found]) for name in Sight.__dataclass_fields__))
