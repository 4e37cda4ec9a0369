"""Triangle meshes in the holder's opening; rays by Embree (Wald et al. 2014)."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from simulators.scene import Array, Floats, Hits, Mask, Material

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Mesh:
    """Triangles `faces` (f, 3), counter-clockwise seen from outside, between `vertices` (v, 3) in metres.

    Vertices are float64 numbers that float32 holds too, so that Embree and the exact hit points mean the same mesh.
    `normals` (v, 3) are those of the smooth surface; `surface` (v, 5) is albedo, specular and roughness.
    """

    vertices: Array
    faces: Indices
    normals: Array
    surface: Array


def build_mesh(vertices: Array, faces: Indices, normals: Array, surface: Array) -> Mesh:
    """A mesh whose vertices are rounded to what float32 holds; normals (v, 3) of any length."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(vertices.astype(np.float32).astype(np.float64), faces, normals / length, surface)


def join(*meshes: Mesh) -> Mesh:
    """All of them in one."""
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, first[:-1], strict=True)]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.surface for mesh in meshes]),
    )


def tile(mesh: Mesh, period_m: float, side_m: float) -> Mesh:
    """The mesh repeated along x and y; of it the triangles that reach into the square of this side.

    The mesh may leave its own period by less than half a period.
    """
    corners = mesh.vertices[:, :2][mesh.faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    copies = []
    for step in np.ndindex(3, 3):
        shift = (np.array(step) - 1) * period_m
        inside = ((high + shift > -side_m / 2) & (low + shift < side_m / 2)).all(axis=1)
        copies.append(_moved(mesh, inside, np.append(shift, 0.0)))
    return join(*copies)


def _moved(mesh: Mesh, wanted: Mask, shift: Array) -> Mesh:
    """The wanted faces (f,) alone, elsewhere."""
    faces = mesh.faces[wanted]
    used = np.zeros(len(mesh.vertices), np.bool_)
    used[faces] = True
    renumbered = np.cumsum(used) - 1
    return build_mesh(mesh.vertices[used] + shift, renumbered[faces], mesh.normals[used], mesh.surface[used])


@dataclass(frozen=True)
class MeshSample:
    """Bodies in the holder's opening."""

    mesh: Mesh
    offset_m: float = 2e-5

    @cached_property
    def _embree(self) -> tuple[Any, Any]:
        """Embree's scene, and its mesh, which must live as long."""
        scene = EmbreeScene()
        return scene, TriangleMesh(scene, self.mesh.vertices.astype(np.float32), self.mesh.faces.astype(np.int32))

    def trace(self, starts: Array, ways: Array) -> Hits:
        """First hits on the ways (n, 3) from points (n, 3) outside the bodies.

        Points lie on their triangles to float64's last digits, and beside their rays by a few nanometres, which is
        what Embree's float32 leaves of the place in the triangle.
        """
        found = self._embree[0].run(*_rays(starts, ways), query="INTERSECT", output=True)
        ray = np.flatnonzero(found["primID"] >= 0)
        face = self.mesh.faces[found["primID"][ray]]
        u, v = found["u"][ray].astype(np.float64), found["v"][ray].astype(np.float64)
        share = np.stack([1 - u - v, u, v], axis=1)[:, None, :]
        points, normals, surface = (
            (share @ values[face])[:, 0] for values in (self.mesh.vertices, self.mesh.normals, self.mesh.surface)
        )
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return Hits(ray, points, normals.astype(np.float32), _material(surface.astype(np.float32)))

    def blocks(self, starts: Array, ways: Array) -> Mask:
        """Which ways (n, 3) from points (n, 3) outside the bodies meet one."""
        return np.asarray(self._embree[0].run(*_rays(starts, ways), query="OCCLUDED") >= 0)


def _rays(starts: Array, ways: Array) -> tuple[Floats, Floats, Floats]:
    """Origins, directions and lengths as Embree wants them."""
    length = np.linalg.norm(ways, axis=1)
    directions = ways / np.maximum(length, 1e-12)[:, None]
    return starts.astype(np.float32), directions.astype(np.float32), length.astype(np.float32)


def _material(surface: Floats) -> Material:
    return Material(surface[:, :3].copy(), surface[:, 3].copy(), surface[:, 4].copy())
