"""Triangle meshes with the tangent frame that a material is drawn in.

Texture coordinates run to the right (u) and downward (v), as a material's columns and rows do. The tangent frame
follows them: t along growing u, b along falling v, n outward; that is the sample's frame when a material lies flat.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from render.arrays import Float64, Int32, Rows, dot, unit
from render.errors import MeshError

# Positions, normals and tangents (n, 3 each) of a parametric surface at u and v (n,) in [0, 1].
Surface = Callable[[Rows, Rows], tuple[Rows, Rows, Rows]]


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with one frame per vertex.

    `positions` and unit `normals` (n, 3) in the world frame, `tangents` (n, 4): t and the sign w in b = w n x t,
    `uv` (n, 2), `triangles` (m, 3) counterclockwise from outside. Only front faces are drawn.
    `map_from_world` (3, 3) is set on the reconstruction of a captured sphere alone: texture coordinates and frame then
    come from the normal (see `frames.gradient_frames`).
    Raises MeshError where the arrays disagree or nothing is there to draw.
    """

    positions: Float64
    normals: Float64
    tangents: Float64
    uv: Float64
    triangles: Int32
    map_from_world: Float64 | None = None

    def __post_init__(self) -> None:
        n = len(self.positions)
        shapes = {"positions": (n, 3), "normals": (n, 3), "tangents": (n, 4), "uv": (n, 2)}
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array.shape != shape or not np.isfinite(array).all():
                raise MeshError(f"mesh: {name} must be {shape} finite numbers, not {array.shape}")
        if self.triangles.ndim != 2 or self.triangles.shape[1] != 3 or not len(self.triangles):
            raise MeshError(f"mesh: no triangles in an array of shape {self.triangles.shape}")
        if self.triangles.min() < 0 or self.triangles.max() >= n:
            raise MeshError(f"mesh: triangles name vertices {self.triangles.min()} to {self.triangles.max()} of {n}")


def mesh_from_uv(positions: Rows, normals: Rows, uv: Rows, triangles: Int32) -> Mesh:
    """A mesh whose tangents are averaged per vertex from the texture's derivatives.

    Each triangle's dP/du counts by the angle of its corner, in the plane of the vertex normal; a vertex where mirrored
    and unmirrored texture meet becomes two. Source: Mikkelsen, Simulation of Wrinkled Surfaces Revisited, 2008, 2.5.
    """
    along_u, mirrored = _texture_derivative(positions, uv, triangles)
    key = 2 * triangles.astype(np.int64) + mirrored[:, None]
    split, corner = np.unique(key, return_inverse=True)
    vertex, triangles = split // 2, corner.reshape(triangles.shape).astype(np.int32)
    positions, normals, uv = positions[vertex], unit(normals[vertex]), uv[vertex]
    tangent = np.zeros_like(normals)
    for corner_of_three, angle in enumerate(corner_angles(positions, triangles).T):
        index = triangles[:, corner_of_three]
        flat = unit(along_u - dot(along_u, normals[index]) * normals[index])
        np.add.at(tangent, index, angle[:, None] * flat)
    tangent = perpendicular(tangent, normals)
    sign = np.where(split % 2 == 1, -1.0, 1.0)
    return Mesh(positions, normals, np.column_stack([tangent, sign]), uv, triangles)


def plain_mesh(positions: Rows, normals: Rows, triangles: Int32) -> Mesh:
    """A mesh that no texture is drawn on: any tangents, texture coordinates of zero."""
    tangents = perpendicular(np.zeros_like(positions), normals)
    w = np.ones((len(positions), 1))
    return Mesh(positions, normals, np.hstack([tangents, w]), np.zeros((len(positions), 2)), triangles)


def perpendicular(tangent: Rows, normal: Rows) -> Float64:
    """Unit tangents (n, 3) made perpendicular to unit normals; where nothing is left, any perpendicular direction."""
    flat = tangent - dot(tangent, normal) * normal
    axis = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    some = axis - dot(axis, normal) * normal
    return unit(np.where(np.linalg.norm(flat, axis=1, keepdims=True) > 1e-9, flat, some))


def angle_weighted_normals(positions: Rows, triangles: Int32) -> Float64:
    """Sums (n, 3), not of unit length, of the unit normals of the triangles around, each by its angle at the vertex."""
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    face = unit(np.cross(b - a, c - a))
    normals = np.zeros_like(positions, dtype=np.float64)
    for corner, angle in enumerate(corner_angles(positions, triangles).T):
        np.add.at(normals, triangles[:, corner], angle[:, None] * face)
    return normals


def grid_mesh(surface: Surface, shape: tuple[int, int], tiles: tuple[float, float]) -> Mesh:
    """A mesh over a parametric surface with analytic frames.

    `shape` counts the quads along v and u; the texture repeats `tiles` times along u and v.
    """
    rows, columns = shape
    v, u = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij"))
    positions, normals, tangents = surface(u, v)
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    right, below = first + 1, first + columns + 1
    lower, upper = np.column_stack([first, below, right]), np.column_stack([right, below, below + 1])
    triangles = np.concatenate([lower, upper]).astype(np.int32)
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    uv = np.column_stack([u, v]) * np.asarray(tiles, dtype=np.float64)
    w = np.ones((len(u), 1))
    return Mesh(positions, unit(normals), np.hstack([unit(tangents), w]), uv, triangles[area > 1e-12 * area.max()])


def _texture_derivative(positions: Rows, uv: Rows, triangles: Int32) -> tuple[Float64, Int32]:
    """dP/du (m, 3) per triangle, zero where the texture has no area, and 1 where the texture is mirrored."""
    p0, p1, p2 = (positions[triangles[:, k]] for k in range(3))
    w0, w1, w2 = (uv[triangles[:, k]] for k in range(3))
    du1, dv1 = (w1 - w0).T
    du2, dv2 = (w2 - w0).T
    area = du1 * dv2 - du2 * dv1
    along_u = np.sign(area)[:, None] * ((p1 - p0) * dv2[:, None] - (p2 - p0) * dv1[:, None])
    # v runs downward, so a texture seen the right way round has negative area on counterclockwise triangles.
    return along_u, (area > 0).astype(np.int32)


def corner_angles(positions: Rows, triangles: Int32) -> Float64:
    """Inner angles (m, 3) of the triangles in radians."""
    corners = positions[triangles]
    to_next = unit(np.roll(corners, -1, axis=1) - corners)
    to_last = unit(np.roll(corners, 1, axis=1) - corners)
    return np.asarray(np.arccos(np.clip((to_next * to_last).sum(axis=2), -1.0, 1.0)))
