"""Meshes made finer or of another size: light that is known at vertices alone needs vertices where it changes."""

import numpy as np
from numpy.typing import NDArray

from render.arrays import Float64, Int32, Rows, unit
from render.errors import MeshError
from render.mesh import Mesh, perpendicular

MOST_VERTICES = 500_000
# Of a triangle with corners 0 1 2 and middles 3 4 5 of its edges 01 12 20, by which edges are halved (bits).
_PARTS: dict[int, list[tuple[int, int, int]]] = {
    0: [(0, 1, 2)],
    1: [(0, 3, 2), (3, 1, 2)],
    2: [(0, 1, 4), (0, 4, 2)],
    3: [(3, 1, 4), (0, 3, 4), (0, 4, 2)],
    4: [(0, 1, 5), (5, 1, 2)],
    5: [(0, 3, 5), (3, 1, 5), (5, 1, 2)],
    6: [(5, 4, 2), (0, 1, 4), (0, 4, 5)],
    7: [(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)],
}


def scaled(mesh: Mesh, factors: Rows) -> Mesh:
    """A mesh (without `map_from_world`) as many times as long along x, y and z, factors (3,) over 0."""
    normals = unit(mesh.normals / factors)
    along = perpendicular(mesh.tangents[:, :3] * factors, normals)
    return Mesh(mesh.positions * factors, normals, np.hstack([along, mesh.tangents[:, 3:]]), mesh.uv, mesh.triangles)


def subdivided(mesh: Mesh, longest: float) -> Mesh:
    """The same surface (without `map_from_world`) with no edge longer than this, its frames interpolated.

    Longer edges are halved, in all their triangles at once, so that no gaps open. Raises MeshError where that takes
    more than half a million vertices.
    """
    while _least_vertices(mesh, longest) <= MOST_VERTICES:
        corners = mesh.positions[mesh.triangles]
        long = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2) > longest
        if not long.any():
            return mesh
        mesh = _halved(mesh, long)
    raise MeshError(f"edges of at most {longest:g} need more than {MOST_VERTICES} vertices; allow longer ones")


def _least_vertices(mesh: Mesh, longest: float) -> float:
    """Half as many as equilateral triangles that cover the surface, or those that there are."""
    one, two, three = (mesh.positions[mesh.triangles[:, corner]] for corner in range(3))
    area = 0.5 * np.linalg.norm(np.cross(two - one, three - one), axis=1).sum()
    return max(float(area / (np.sqrt(3) / 4 * longest**2) / 2), float(len(mesh.positions)))


def _halved(mesh: Mesh, long: NDArray[np.bool_]) -> Mesh:
    """With the edges (m, 3) halved that begin at each corner of a triangle."""
    ends = np.sort(np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=-1), axis=-1)
    edges, number = np.unique(ends[long], axis=0, return_inverse=True)
    middles = np.zeros(long.shape, np.int64)
    middles[long] = len(mesh.positions) + number.ravel()
    one, two = edges.T
    normals = np.concatenate([mesh.normals, unit(mesh.normals[one] + mesh.normals[two])])
    along = _with_means(mesh.tangents[:, :3], one, two)
    sign = np.concatenate([mesh.tangents[:, 3:], mesh.tangents[one, 3:]])
    return Mesh(
        _with_means(mesh.positions, one, two),
        normals,
        np.hstack([perpendicular(along, normals), sign]),
        _with_means(mesh.uv, one, two),
        _parts(np.hstack([mesh.triangles, middles]), long @ np.array([1, 2, 4])),
    )


def _with_means(values: Rows, one: NDArray[np.intp], two: NDArray[np.intp]) -> Float64:
    return np.concatenate([values, 0.5 * (values[one] + values[two])])


def _parts(vertices: NDArray[np.int64], halved: NDArray[np.int64]) -> Int32:
    parts = [vertices[halved == which][:, corners] for which, found in _PARTS.items() for corners in found]
    return np.concatenate(parts).astype(np.int32)
