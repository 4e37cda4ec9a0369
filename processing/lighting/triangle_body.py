"""A rigid body of triangles, checked: what rays are traced from and against."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from processing.errors import GeometryError
from processing.lighting.rays import Bool, Occluder
from processing.products.arrays import Float64, Int32

_OFF_SURFACE = 1e-4  # of the radius: what float32 rays need so as not to meet the surface that they leave


@dataclass(frozen=True, eq=False)
class TriangleBody:
    """Triangles (m, 3), counterclockwise from outside, between vertices (n, 3), with unit normals (n, 3) outward.

    A normal of zeros is of a vertex that belongs to no triangle with an area. Bodies may be open: both sides of a
    triangle block light.
    """

    vertices: Float64
    normals: Float64
    triangles: Int32

    @cached_property
    def centre(self) -> Float64:
        """Middle (3,) of the bounding box of the triangles."""
        used = self.vertices[self.triangles]
        return np.asarray((used.min(axis=(0, 1)) + used.max(axis=(0, 1))) / 2)

    @cached_property
    def radius(self) -> float:
        """Of the smallest sphere around `centre` that holds all triangles."""
        return float(np.linalg.norm(self.vertices[self.triangles] - self.centre, axis=-1).max())

    @cached_property
    def occluder(self) -> Occluder:
        """The triangles, ready to block rays."""
        return Occluder(self.vertices, self.triangles)

    @property
    def without_normal(self) -> Bool:
        """Vertices (n,) that no light is known to reach: their normals are zeros."""
        return np.asarray(~self.normals.any(axis=1))

    @property
    def origins(self) -> Float64:
        """Where the rays (n, 3) of the vertices begin: off the surface by 1e-4 of the radius."""
        return self.vertices + _OFF_SURFACE * self.radius * self.normals


def triangle_body(vertices: Float64, triangles: Int32, normals: Float64 | None = None) -> TriangleBody:
    """A body of what can be used: triangles without an area are left out.

    Where `normals` (n, 3, of any length) are not given, zero or not finite, the triangles around count by their angles.
    Raises GeometryError where vertices are not finite, triangles name vertices that are not there, or none has an area.
    """
    vertices, triangles = np.asarray(vertices, np.float64), np.asarray(triangles)
    _check(vertices, triangles)
    triangles = triangles.astype(np.int32)
    triangles = triangles[_has_area(vertices[triangles])]
    if not len(triangles):
        raise GeometryError("body: no triangle has an area; nothing could cast or catch light")
    around = _normals_around(vertices, triangles)
    return TriangleBody(vertices, around if normals is None else _given_or(normals, around), triangles)


def _check(vertices: Float64, triangles: Int32) -> None:
    if vertices.ndim != 2 or vertices.shape[1] != 3 or triangles.ndim != 2 or triangles.shape[1] != 3:
        raise GeometryError(
            f"body: vertices {vertices.shape} and triangles {triangles.shape} must be (n, 3) and (m, 3)"
        )
    if triangles.size and not np.issubdtype(triangles.dtype, np.integer):
        raise GeometryError(f"body: triangles must name vertices by whole numbers, not {triangles.dtype}")
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        raise GeometryError(f"body: {len(bad)} vertices are not finite, the first is number {bad[0]}; repair the mesh")
    if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(vertices):
        raise GeometryError(f"body: triangles name vertices {triangles.min()} to {triangles.max()} of {len(vertices)}")


def _has_area(corners: Float64) -> Bool:
    """Triangles (m,) whose height is more than rounding against their longest side."""
    sides = corners - np.roll(corners, 1, axis=1)
    longest = np.square(sides).sum(axis=2).max(axis=1)
    doubled = np.linalg.norm(np.cross(sides[:, 1], sides[:, 2]), axis=1)
    return np.asarray((doubled > 1e-12 * longest) & (longest > 0))


def _normals_around(vertices: Float64, triangles: Int32) -> Float64:
    """Unit normals (n, 3) of the triangles around each vertex, by their angles there; zeros where there are none."""
    corners = vertices[triangles]
    face = _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    total = np.zeros_like(vertices)
    for k in range(3):
        one, two = (_unit(corners[:, (k + step) % 3] - corners[:, k]) for step in (1, 2))
        angle = np.arccos(np.clip((one * two).sum(axis=1), -1, 1))
        np.add.at(total, triangles[:, k], angle[:, None] * face)
    return _unit(total)


def _given_or(normals: Float64, around: Float64) -> Float64:
    given = np.asarray(normals, np.float64)
    if given.shape != around.shape:
        raise GeometryError(f"body: normals {given.shape} must be as many as vertices {around.shape}")
    usable = np.asarray(np.isfinite(given).all(axis=1) & given.any(axis=1))
    return np.where(usable[:, None], _unit(np.where(usable[:, None], given, 1.0)), around)


def _unit(rows: Float64) -> Float64:
    length = np.linalg.norm(rows, axis=1, keepdims=True)
    return np.asarray(np.divide(rows, length, out=np.zeros_like(rows), where=length > 1e-300))
