"""How a mesh wraps a sample around itself: how long a tile becomes, and how the surface bends under it."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from render.arrays import Float64, Int32, Rows, dot, unit
from render.closed_mesh import placed, same_rows
from render.frames import vertex_frames
from render.mesh import Mesh, corner_angles

# Normals and tangents that differ by less than this, as vectors, belong to one smooth surface.
_SAME_DIRECTION = 1e-2
# Of the mesh's mean stretch: where a texture is pinched to a point, as at a sphere's pole, a tile keeps some length.
_LEAST = 1e-3


@dataclass(frozen=True, eq=False)
class Wrapping:
    """Per vertex, in its frame (t, b, n).

    `stretch` (n, 2): lengths of one tile along t and along b in world units, positive. `bending` (n, 3): the shape
    operator's tt, tb and bb, in 1 / world units, by which the normal turns: dn = S dx; positive on a sphere.
    """

    stretch: Float64
    bending: Float64


@lru_cache(maxsize=8)
def wrapping(mesh: Mesh) -> Wrapping:
    """Stretch from the texture's derivatives and bending from the normals, both averaged around each vertex.

    A triangle counts by its angle at the vertex; averages go across seams where position and frame agree. Triangles
    without area, in space or in the texture, tell nothing; where none tells, a tile has the mean length of all, and the
    surface is flat.
    """
    angles = corner_angles(mesh.positions, mesh.triangles)
    normals = same_rows(np.hstack([placed(mesh.positions), mesh.normals / _SAME_DIRECTION]))
    framed = same_rows(np.column_stack([2 * normals, mesh.tangents / _SAME_DIRECTION]))
    lengths, known = _stretch(mesh)
    stretch = _averaged(lengths, known[:, None] * angles, mesh.triangles, framed)
    tensor, known = _bending(mesh)
    bending = _averaged(tensor, known[:, None] * angles, mesh.triangles, normals)
    return Wrapping(_positive(stretch), _in_frames(mesh, np.nan_to_num(bending).reshape(-1, 3, 3)))


def _stretch(mesh: Mesh) -> tuple[Float64, Rows]:
    """World lengths (m, 2) of a tile along t and across it per triangle, and which triangles have area."""
    first, second = _sides(mesh.positions, mesh)
    (du1, dv1), (du2, dv2) = (side.T for side in _sides(mesh.uv, mesh))
    texture_area = du1 * dv2 - du2 * dv1
    area = np.linalg.norm(np.cross(first, second), axis=1)
    known = (np.abs(texture_area) > 1e-12 * np.abs(texture_area).max()) & (area > 1e-12 * area.max())
    divisor = np.where(known, texture_area, 1.0)
    along = np.linalg.norm(first * dv2[:, None] - second * dv1[:, None], axis=1) / np.abs(divisor)
    across = area / np.abs(divisor) / np.where(known, along, 1.0)
    return np.column_stack([along, across]), known


def _bending(mesh: Mesh) -> tuple[Float64, Rows]:
    """The symmetric tensor (m, 9) by which the interpolated normal turns along each triangle, and which have area.

    Source: Rusinkiewicz, Estimating Curvatures and Their Derivatives on Triangle Meshes, 2004, 3.1; the map of the
    triangle's plane that takes two edges to the turns along them takes the third one to its own.
    """
    first, second = _sides(mesh.positions, mesh)
    normal = np.cross(first, second)
    area = np.linalg.norm(normal, axis=1)
    known = area > 1e-9 * (first**2 + second**2).sum(axis=1)
    square = np.where(known, area**2, 1.0)[:, None]
    # Rows of the inverse of (first, second, normal), by which a step in the plane is a sum of the two edges.
    to_first, to_second = np.cross(second, normal) / square, np.cross(normal, first) / square
    turn_first, turn_second = _sides(mesh.normals, mesh)
    turn = np.einsum("ni,nj->nij", turn_first, to_first) + np.einsum("ni,nj->nij", turn_second, to_second)
    across = unit(normal)
    turn -= np.einsum("ni,nj->nij", across, np.einsum("nij,ni->nj", turn, across))
    return (0.5 * (turn + np.swapaxes(turn, 1, 2))).reshape(-1, 9), known


def _sides(values: Rows, mesh: Mesh) -> tuple[Float64, Float64]:
    """From each triangle's first corner to its second and third, (m, k) each."""
    a, b, c = (values[mesh.triangles[:, k]] for k in range(3))
    return b - a, c - a


def _averaged(values: Rows, weights: Rows, triangles: Int32, group: Int32) -> Float64:
    """Weighted means (n, k) of what the triangles (m, k) around each group of vertices tell; NaN where none does."""
    totals = np.zeros((int(group.max()) + 1, values.shape[1]))
    weight = np.zeros((len(totals), 1))
    for corner in range(3):
        around = group[triangles[:, corner]]
        np.add.at(totals, around, weights[:, corner : corner + 1] * values)
        np.add.at(weight, around, weights[:, corner : corner + 1])
    mean = np.where(weight > 0.0, totals / np.where(weight > 0.0, weight, 1.0), np.nan)
    return np.asarray(mean[group])


def _positive(stretch: Float64) -> Float64:
    """The same with no length that is unknown or nothing."""
    mean = float(np.nanmean(stretch)) if np.isfinite(stretch).any() else 1.0
    return np.asarray(np.maximum(np.where(np.isnan(stretch), mean, stretch), _LEAST * mean))


def _in_frames(mesh: Mesh, tensor: Float64) -> Float64:
    """Components tt, tb and bb (n, 3) of the tensors (n, 3, 3) in the vertices' frames."""
    t, b = np.moveaxis(vertex_frames(mesh.normals, mesh.tangents)[:, :2], 1, 0)
    turned_t, turned_b = np.einsum("nij,nj->ni", tensor, t), np.einsum("nij,nj->ni", tensor, b)
    return np.hstack([dot(t, turned_t), dot(b, turned_t), dot(b, turned_b)])
