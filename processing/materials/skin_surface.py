"""The surface that a skin grows on: welded where the mesh is split, and fine enough to be laid out patch by patch."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from processing.products.arrays import Float64

Int32 = NDArray[np.int32]

# Corners closer than this share of the mesh's extent are one vertex: float32 files round at 1e-7.
_WELD = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Triangles whose neighbours share vertices, whatever the texture does there.

    `positions` and unit `normals` (n, 3), `triangles` (m, 3) counterclockwise from outside, `corner_uv` (m, 3, 2) in
    texels of the atlas. The first vertices are those of the mesh as welded, later ones lie within its edges.
    """

    positions: Float64
    normals: Float64
    triangles: Int32
    corner_uv: Float64

    def neighbours(self) -> tuple[Int32, Int32]:
        """Vertices that share an edge with each vertex: CSR `start` (n + 1,) and `index`."""
        edges = directed_edges(self.triangles)
        n = len(self.positions)
        ones = np.ones(2 * len(edges), np.int8)
        both = np.concatenate([edges, edges[:, ::-1]])
        matrix = sparse.csr_matrix((ones, (both[:, 0], both[:, 1])), shape=(n, n))
        return matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32)

    def triangles_around(self) -> tuple[Int32, Int32]:
        """Triangles at each vertex: CSR `start` (n + 1,) and `index`."""
        return grouped(self.triangles.ravel(), len(self.positions), 3)


def weld(positions: Float64, normals: Float64, triangles: Int32) -> tuple[Int32, Float64, Float64]:
    """For each vertex (n,) the place it belongs to, with the places' positions and mean unit normals."""
    extent = max(float(np.ptp(positions, axis=0).max()), 1e-300)
    rounded = np.round((positions - positions.min(axis=0)) / (_WELD * extent)).astype(np.int64)
    _, first, place = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    # The two sides of a sheet without thickness lie at the same places, and are not one surface.
    averted = np.sum(normals * normals[first][place.ravel()], axis=1) < -0.5
    _, first, place = np.unique(2 * place.ravel() + averted, return_index=True, return_inverse=True)
    place = place.astype(np.int32)
    total = np.zeros((len(first), 3))
    used = np.unique(triangles)
    np.add.at(total, place[used], normals[used])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    # Normals that cancel leave any direction: one of them; places of triangles without area have none.
    mean = np.where(length > 1e-6, total / np.maximum(length, 1e-300), normals[first])
    mean[~mean.any(axis=1)] = [0.0, 0.0, 1.0]
    return np.asarray(place, np.int32), positions[first], np.asarray(mean, np.float64)


def refine(surface: Surface, longest: float) -> Surface:
    """The same surface with every edge halved until none is longer than `longest`; no vertex lies on another's edge."""
    while True:
        edges = surface.positions[surface.triangles] - surface.positions[np.roll(surface.triangles, -1, axis=1)]
        marked = np.linalg.norm(edges, axis=2) > longest
        if not marked.any():
            return surface
        surface = _split(surface, marked)


def directed_edges(triangles: Int32) -> Int32:
    """The three edges (3 m, 2) of every triangle: all first ones, all second ones, all third ones."""
    return np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])


def grouped(keys: Int32, groups: int, per_row: int = 1) -> tuple[Int32, Int32]:
    """Rows by key as CSR `start` (groups + 1,) and `index`, where `per_row` neighbouring keys belong to one row."""
    order = np.argsort(keys, kind="stable")
    start = np.zeros(groups + 1, np.int32)
    np.cumsum(np.bincount(keys, minlength=groups), out=start[1:])
    return start, (order // per_row).astype(np.int32)


def _split(surface: Surface, marked: NDArray[np.bool_]) -> Surface:
    """Every marked edge halved; triangles become two, three or four."""
    triangles, n = surface.triangles, len(surface.positions)
    ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), axis=-1)
    halved, middle = np.unique(ends[marked], axis=0, return_inverse=True)
    vertex = np.full(triangles.shape, -1, np.int32)
    vertex[marked] = n + middle.ravel().astype(np.int32)
    normals = surface.normals[halved].sum(axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    uv = surface.corner_uv
    points = np.concatenate([triangles, vertex], axis=1)
    coordinates = np.concatenate([uv, 0.5 * (uv + np.roll(uv, -1, axis=1))], axis=1)
    pieces = [(points[~marked.any(axis=1), :3], coordinates[~marked.any(axis=1), :3])]
    for turn in range(3):
        # Corners a b c and the middles of a b, b c, c a, seen from each corner in turn.
        seen = [(k + turn) % 3 + 3 * (k // 3) for k in range(6)]
        pattern = np.roll(marked, -turn, axis=1)
        for wanted, parts in _PARTS.items():
            rows = (pattern == wanted).all(axis=1)
            if all(wanted) and turn:
                continue
            for part in parts:
                corners = [seen[k] for k in part]
                pieces.append((points[rows][:, corners], coordinates[rows][:, corners]))
    return Surface(
        np.concatenate([surface.positions, surface.positions[halved].mean(axis=1)]),
        np.concatenate([surface.normals, normals]),
        np.concatenate([piece for piece, _ in pieces]),
        np.concatenate([piece for _, piece in pieces]),
    )


# Corners 0 1 2, middles 3 of 0-1, 4 of 1-2, 5 of 2-0: which triangles come of which halved edges.
_PARTS = {
    (True, False, False): ((0, 3, 2), (3, 1, 2)),
    (True, True, False): ((3, 1, 4), (0, 3, 4), (0, 4, 2)),
    (True, True, True): ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),
}
