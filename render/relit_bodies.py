"""Bodies that are drawn with the radiance of their vertices: their meshes as one, and what lies behind them."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from render.arrays import Float32, Float64, Int32
from render.environment import Environment
from render.errors import SceneError
from render.mesh import Mesh

_RIGID = 1e-6


@dataclass(frozen=True, eq=False)
class Background:
    """An environment behind all bodies, turned by the rotation (3, 3) `world_from_light`."""

    environment: Environment
    world_from_light: Float64 = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True, eq=False)
class RelitBodies:
    """Meshes one after another: `positions` (n, 3) in their own frames, `triangles` (m, 3) that number all vertices.

    Body k has the vertices from `first_vertex[k]` and the triangles from `first_triangle[k]` to those of the next one.
    """

    positions: Float64
    triangles: Int32
    first_vertex: NDArray[np.int64]
    first_triangle: NDArray[np.int64]

    @classmethod
    def of(cls, meshes: Sequence[Mesh]) -> "RelitBodies":
        """Raises SceneError where there is none."""
        if not meshes:
            raise SceneError("no body: nothing would be seen")
        first_vertex = np.cumsum([0, *(len(mesh.positions) for mesh in meshes)])
        first_triangle = np.cumsum([0, *(len(mesh.triangles) for mesh in meshes)])
        triangles = [mesh.triangles + first for mesh, first in zip(meshes, first_vertex[:-1], strict=True)]
        positions = np.concatenate([mesh.positions for mesh in meshes])
        return cls(positions, np.concatenate(triangles).astype(np.int32), first_vertex, first_triangle)

    def checked_poses(self, poses: Sequence[Float64]) -> list[Float64]:
        """A rigid transform (4, 4) for each body. Raises SceneError where their number is another, or one is not."""
        count = len(self.first_vertex) - 1
        if len(poses) != count:
            raise SceneError(f"{len(poses)} poses for {count} bodies: each takes one")
        return [_rigid(pose, number) for number, pose in enumerate(poses)]

    def checked_radiance(self, radiance: Float32) -> Float32:
        """Raises SceneError where radiance is not (n, 3)."""
        count = len(self.positions)
        if np.shape(radiance) != (count, 3):
            raise SceneError(f"radiance {np.shape(radiance)} must have three channels of {count} vertices")
        return np.ascontiguousarray(radiance, np.float32)

    def vertices_in(self, image: Int32) -> NDArray[np.int64]:
        """Corners of the triangles in an image of their numbers, -1 for none; ascending, each once."""
        seen = np.zeros(len(self.triangles) + 1, np.bool_)
        seen[image] = True
        needed = np.zeros(len(self.positions), np.bool_)
        needed[self.triangles[seen[:-1]]] = True
        return np.flatnonzero(needed)

    def in_world(self, poses: Sequence[Float64]) -> Float64:
        """Positions (n, 3) of all vertices."""
        parts = np.split(self.positions, self.first_vertex[1:-1])
        return np.concatenate([part @ pose[:3, :3].T + pose[:3, 3] for part, pose in zip(parts, poses, strict=True)])


def _rigid(pose: Float64, number: int) -> Float64:
    found = np.asarray(pose, np.float64)
    if found.shape != (4, 4) or not np.isfinite(found).all():
        raise SceneError(f"body {number}: a pose is 4 x 4 finite numbers, not {found.tolist()}")
    turn = found[:3, :3]
    if np.abs(turn @ turn.T - np.eye(3)).max() > _RIGID or np.linalg.det(turn) < 0:
        raise SceneError(f"body {number}: a pose turns and shifts without stretch or mirror, unlike {found.tolist()}")
    return found
