"""Whether a mesh encloses a volume: only then does each ray that enters it leave it again."""

from functools import lru_cache

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from render.arrays import Int32, Rows
from render.mesh import Mesh

# Of the mesh's extent: vertices nearer than this are one. Single precision keeps seven digits.
_SAME_PLACE = 1e-6


@lru_cache(maxsize=8)
def is_closed(mesh: Mesh) -> bool:
    """Whether every edge is run through as often in one direction as in the other.

    Vertices in the same place count as one, so that seams of texture coordinates, mirrored or not, and sharp edges do
    not open a mesh. Triangles of which two corners fall together are ignored; several bodies may touch.
    """
    vertex = same_rows(placed(mesh.positions))
    corners = vertex[mesh.triangles]
    whole = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    start, end = corners[whole].ravel(), np.roll(corners[whole], -1, axis=1).ravel()
    count = int(vertex.max()) + 1
    forth = np.sort(start.astype(np.int64) * count + end)
    back = np.sort(end.astype(np.int64) * count + start)
    return bool(len(forth)) and np.array_equal(forth, back)


def placed(positions: Rows) -> Rows:
    """Positions (n, 3) in units of the distance at which two of them are one."""
    extent = float(np.ptp(positions, axis=0).max())
    return positions / (_SAME_PLACE * extent) if extent > 0.0 else np.zeros_like(positions)


def same_rows(rows: Rows) -> Int32:
    """Numbers (n,) that are equal for rows (n, k) nearer to each other than 1, or joined by such rows."""
    distinct, number = np.unique(rows, axis=0, return_inverse=True)
    pairs = cKDTree(distinct).query_pairs(1.0, output_type="ndarray")
    count = len(distinct)
    linked = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    _, component = connected_components(linked, directed=False)
    return np.asarray(component[number.ravel()], dtype=np.int32)
