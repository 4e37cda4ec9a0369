"""Closed bodies as meshes: rings of points, one behind the other."""

import numpy as np

from simulators.samples.mesh import Indices, Mesh, build_mesh
from simulators.scene import Array


def endless_tubes(rings: Array, surface: Array, period: Array) -> Mesh:
    """Tubes (b, m, n, 3) of m rings of n points, whose ring m would be ring 0 moved by the period (3,).

    The points of a ring run counter-clockwise about the way from ring to ring. `surface` (b, m, n, 5) as in `Mesh`.
    """
    b, m, n, _ = rings.shape
    closed = np.concatenate([rings, rings[:, :1] + period], axis=1)
    faces = _between_rings(b, m + 1, n)
    sums = _normal_sums(closed, faces)
    sums[:, 0] += sums[:, m]
    sums[:, m] = sums[:, 0]
    around = np.concatenate([surface, surface[:, :1]], axis=1)
    return build_mesh(closed.reshape(-1, 3), faces, sums.reshape(-1, 3), around.reshape(-1, 5))


def capped_tubes(rings: Array, surface: Array) -> Mesh:
    """Tubes (b, m, n, 3) of m rings of n points, closed at both ends by a fan; otherwise as `endless_tubes`."""
    b, m, n, _ = rings.shape
    start, end = (np.repeat(rings[:, [k]].mean(axis=2, keepdims=True), n, axis=2) for k in (0, -1))
    closed = np.concatenate([start, rings, end], axis=1)
    faces = _between_rings(b, m + 2, n)
    sums = _normal_sums(closed, faces)
    for pole in (0, -1):  # the n points of a fan's middle are one
        sums[:, pole] = sums[:, pole].sum(axis=1, keepdims=True)
    values = np.concatenate([surface[:, :1], surface, surface[:, -1:]], axis=1)
    mesh = build_mesh(closed.reshape(-1, 3), faces, sums.reshape(-1, 3), values.reshape(-1, 5))
    corners = mesh.vertices[faces]
    flat = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) == 0
    return Mesh(mesh.vertices, faces[~flat], mesh.normals, mesh.surface)


def plate(half_m: float, height_m: float, values: tuple[float, float, float, float, float]) -> Mesh:
    """A square that faces up, of one surface; see `Mesh`."""
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * half_m + [0, 0, height_m]
    up = np.tile([0.0, 0.0, 1.0], (4, 1))
    return build_mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), up, np.tile(values, (4, 1)))


def terrain(heights: Array, surface: Array, period_m: float) -> Mesh:
    """Ground over one period, which faces up: heights (n, n) and surface (n, n, 5), row 0 at the lowest y."""
    n = len(heights)
    place = (np.arange(n + 1) / n - 0.5) * period_m
    x, y = np.meshgrid(place, place)
    z, values = (np.pad(field, [(0, 1), (0, 1)] + [(0, 0)] * (field.ndim - 2), "wrap") for field in (heights, surface))
    around = np.pad(heights, 1, "wrap")
    along_y, along_x = (np.gradient(around, period_m / n, axis=axis)[1:-1, 1:-1] for axis in (0, 1))
    up = np.pad(np.stack([-along_x, -along_y, np.ones_like(heights)], axis=-1), [(0, 1), (0, 1), (0, 0)], "wrap")
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.stack([a, b, d, a, d, c], axis=-1).reshape(-1, 3)
    return build_mesh(
        np.stack([x, y, z], axis=-1).reshape(-1, 3), faces, up.reshape(-1, 3), values.reshape(-1, values.shape[-1])
    )


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) of length 1."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def sweep(centres: Array, tangents: Array, across: Array, profile: Array) -> Array:
    """Rings (b, m, n, 3) about centre lines (b, m, 3).

    `profile` (b, m, n, 2) lies in the plane square to the unit tangents (b, m, 3); its first axis is the part of
    `across` (b, m, 3) in that plane, its second tangent x first.
    """
    first = across - (across * tangents).sum(axis=-1, keepdims=True) * tangents
    first = unit(first)
    second = np.cross(tangents, first)
    rings: Array = centres[:, :, None] + profile[..., :1] * first[:, :, None] + profile[..., 1:] * second[:, :, None]
    return rings


def _between_rings(b: int, m: int, n: int) -> Indices:
    """Triangles (b * (m - 1) * n * 2, 3) between neighbouring rings of b tubes of m rings of n vertices."""
    index = np.arange(b * m * n).reshape(b, m, n)
    near, far = index[:, :-1], index[:, 1:]
    near_next, far_next = np.roll(near, -1, axis=2), np.roll(far, -1, axis=2)
    pairs = np.stack([near, near_next, far, near_next, far_next, far], axis=-1)
    return np.asarray(pairs.reshape(-1, 3), np.int64)


def _normal_sums(points: Array, faces: Indices) -> Array:
    """Sum of the normals of the triangles around each point (b, m, n, 3), each as long as its triangle is large."""
    corners = points.reshape(-1, 3)[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    count = points.size // 3
    sums = np.stack([np.bincount(faces.ravel(), np.repeat(normals[:, k], 3), count) for k in range(3)], axis=-1)
    return np.asarray(sums.reshape(points.shape))
