"""Which way a material runs over a surface: upward as far as that goes, and smoothly."""

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import cg

from processing.materials.skin_surface import Int32, Surface, directed_edges
from processing.products.arrays import Float64

# b runs toward +Z; where that is the normal, as on a plate that lies flat, toward +Y.
_UPWARD = np.array([0.0, 0.1, 1.0])


def tangent_field(surface: Surface, length: float) -> Float64:
    """Unit tangents t (n, 3) of the vertices such that b = n x t runs upward, bent over no less than `length`.

    Minimises |grad b|^2 + |b - p|^2 / length^2, p the part of +Z along the surface and grad b its change against
    parallel transport. Zeros, which every closed surface but a torus has, lie where p has them.
    Source: Knoppel et al., Globally Optimal Direction Fields, 2013, 3 and 4.2.
    """
    normals = surface.normals
    first, second = tangent_axes(normals)
    edges = np.unique(np.sort(directed_edges(surface.triangles), axis=1), axis=0)
    weights = _cotangents(surface, edges)
    i, j = edges.T
    turn = _transport(normals, first, second, i, j)
    n = len(normals)
    mass = _vertex_areas(surface)
    # The least share keeps vertices without triangles out of a division by zero.
    mass = np.maximum(mass, 1e-9 * mass.max())
    diagonal = np.bincount(i, weights, n) + np.bincount(j, weights, n) + mass / length**2
    rows, columns = np.concatenate([i, j, np.arange(n)]), np.concatenate([j, i, np.arange(n)])
    values = np.concatenate([-weights * np.conj(turn), -weights * turn, diagonal])
    matrix = sparse.csr_matrix((values, (rows, columns)), shape=(n, n))
    wanted = (first @ _UPWARD + 1j * (second @ _UPWARD)) * mass / length**2
    # Only directions count: four digits of them are far below what can be seen.
    upward, _ = cg(matrix, wanted, rtol=1e-4, maxiter=2000, M=sparse.diags(1.0 / diagonal))
    upward /= np.maximum(np.abs(upward), 1e-300)
    b = upward.real[:, None] * first + upward.imag[:, None] * second
    return np.asarray(np.where(np.abs(upward)[:, None] > 0.5, np.cross(b, normals), first))


def tangent_axes(normals: Float64) -> tuple[Float64, Float64]:
    """Two unit vectors (n, 3) each that make a right-handed frame with the unit normals."""
    axis = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    first = np.cross(axis, normals)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normals, first)


def _transport(normals: Float64, first: Float64, second: Float64, i: Int32, j: Int32) -> Float64:
    """Unit complex numbers that take components at vertices i to those at j by the least rotation of n_i to n_j."""
    ni, nj, along = normals[i], normals[j], first[i]
    # R v = v + (n_i x n_j) x v + (n_i x n_j) x ((n_i x n_j) x v) / (1 + n_i . n_j)
    axis = np.cross(ni, nj)
    cosine = np.maximum(1.0 + np.sum(ni * nj, axis=1, keepdims=True), 1e-6)
    once = np.cross(axis, along)
    moved = along + once + np.cross(axis, once) / cosine
    turn = np.sum(moved * first[j], axis=1) + 1j * np.sum(moved * second[j], axis=1)
    return np.asarray(turn / np.maximum(np.abs(turn), 1e-300))


def _cotangents(surface: Surface, edges: Int32) -> Float64:
    """Half the cotangents opposite to each edge, at least a hundredth: obtuse triangles would push instead of pull."""
    corners = surface.positions[surface.triangles]
    keys, values = [], []
    n = len(surface.positions)
    for k in range(3):
        a, b, c = (corners[:, (k + s) % 3] for s in range(3))
        cross = np.linalg.norm(np.cross(a - c, b - c), axis=1)
        values.append(0.5 * np.sum((a - c) * (b - c), axis=1) / np.maximum(cross, 1e-300))
        ends = np.sort(surface.triangles[:, [k, (k + 1) % 3]], axis=1).astype(np.int64)
        keys.append(ends[:, 0] * n + ends[:, 1])
    position = np.searchsorted(edges[:, 0].astype(np.int64) * n + edges[:, 1], np.concatenate(keys))
    total = np.bincount(position, np.concatenate(values), len(edges))
    return np.asarray(np.clip(total, 0.01, 100.0))


def _vertex_areas(surface: Surface) -> Float64:
    """A third of the area of the triangles around each vertex."""
    a, b, c = (surface.positions[surface.triangles[:, k]] for k in range(3))
    third = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6.0
    return np.asarray(np.bincount(surface.triangles.ravel(), np.repeat(third, 3), len(surface.positions)), np.float64)
