"""One period of a sample's surface as triangles that join their own copies."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulators.far_field import one_period
from simulators.samples.bodies import terrain
from simulators.samples.mesh import Mesh, MeshSample
from simulators.samples.relief import Relief, ReliefSample
from simulators.scene import Material

Array = NDArray[Any]

_UP = np.array([[0.0, 0.0, 1.0]])
_PLATE = 64  # quads along the side of a plate, which is bent with its body
_OFF_EDGE = 1e-4  # of the period: no piece has its middle on a border moved by this


@dataclass(frozen=True, eq=False)
class Period:
    """Triangles `faces` (f, 3) between `vertices` (v, 3) of one period, which is 1 long; z = 0 is the reference plane.

    `normals` (v, 3) have any length; `surface` (v, 5) is albedo, specular and roughness. Shadow rays start `offset` off
    the surface.
    """

    vertices: Array
    faces: Array
    normals: Array
    surface: Array
    offset: float

    @property
    def deepest(self) -> float:
        """Depth of the lowest point."""
        return -float(self.vertices[:, 2].min())

    def at(self, face: Array, share: Array) -> tuple[Array, Array, Material]:
        """Points (n, 3), normals (n, 3) and material in triangles (n,), by shares (n, 3) of their corners."""
        corners = self.faces[face]
        points, normals, surface = (
            np.einsum("nc,nck->nk", share, values[corners]) for values in (self.vertices, self.normals, self.surface)
        )
        values = surface.astype(np.float32)
        return points, normals, Material(values[:, :3].copy(), values[:, 3].copy(), values[:, 4].copy())


@lru_cache(maxsize=3)
def period(sample: str, seed: int) -> Period:
    """The sample that `far_field` traces, kept for the next who asks for the same."""
    body, period_m = one_period(sample, seed, (_UP, _UP))
    if isinstance(body, ReliefSample):
        mesh = _height_field(body.relief)
    elif isinstance(body, MeshSample):
        mesh = _bodies(body.mesh, period_m)
    else:
        raise TypeError(f"{sample} is neither a relief nor a mesh")
    return Period(mesh.vertices / period_m, mesh.faces, mesh.normals, mesh.surface, body.offset_m / period_m)


def _height_field(relief: Relief) -> Mesh:
    """The middle period of two, a vertex for each of its texels, moved by half a texel to where the texels are."""
    count = len(relief.height_m) // 2
    middle = slice(count // 2, count // 2 + count)
    # Rows of a relief run downward, those of a terrain upward.
    height, albedo, specular, roughness = (
        field[middle, middle][::-1] for field in (relief.height_m, relief.albedo, relief.specular, relief.roughness)
    )
    period_m = relief.side_m / 2
    ground = terrain(height, np.dstack([albedo, specular, roughness]), period_m)
    half = np.array([0.5, 0.5, 0.0]) * period_m / count
    return Mesh(ground.vertices + half, ground.faces, ground.normals, ground.surface)


def _bodies(mesh: Mesh, period_m: float) -> Mesh:
    """The pieces whose middle lies in the middle period; a plate under them becomes a grid."""
    corners = mesh.vertices[mesh.faces]
    large = np.ptp(corners[..., 0], axis=1) > period_m / 4
    middle = corners.mean(axis=1)[:, :2] / period_m + 0.5 + _OFF_EDGE
    kept = mesh.faces[(np.floor(middle) == 0).all(axis=1) & ~large]
    used, faces = np.unique(kept, return_inverse=True)
    found = Mesh(mesh.vertices[used], faces.reshape(kept.shape), mesh.normals[used], mesh.surface[used])
    if not large.any():
        return found
    first = mesh.faces[large][0, 0]
    height = np.full((_PLATE, _PLATE), mesh.vertices[first, 2])
    grid = terrain(height, np.broadcast_to(mesh.surface[first], (_PLATE, _PLATE, 5)), period_m)
    return Mesh(
        np.concatenate([found.vertices, grid.vertices]),
        np.concatenate([found.faces, grid.faces + len(found.vertices)]),
        np.concatenate([found.normals, grid.normals]),
        np.concatenate([found.surface, grid.surface]),
    )
