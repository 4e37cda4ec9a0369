"""Where the points of a periodic sample come to lie when its reference plane is bent around a smooth surface.

The sample lies inside. A point of it at depth h tiles under (u, v) is P(u, v) - s(u, v) h n(u, v), with n the normal
and s the root of a tile's area in the world. With e = s n the point is P - h e, and its derivatives along u and v are
those of P less h times those of e: all of them are tabulated over the surface, and interpolated.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from render.arrays import unit
from render.mesh import Surface
from tests.benchmarks.yardsticks.sample_periods import Period

Array = NDArray[Any]

_STEP = 1e-4  # of the surface's parameters, for differences, whose errors go with its square
# Cells along v and u: where a full turn has 256, a point lies beside the surface by 8e-5 of the radius of its bend.
_CELLS = (256, 512)


@dataclass(frozen=True, eq=False)
class Covered:
    """A body: a surface over u and v in [0, 1], how often the sample repeats along both, and the sample."""

    surface: Surface
    tiles: tuple[int, int]
    sample: Period

    def points(self, local: Array, tile: Array) -> Array:
        """World points (n, 3) of the sample's points (n, 3) in tiles (n or 1, 2), counted along u and v."""
        found = _between(self._places, *self._parameters(local, tile))
        return np.asarray(found[:, :3] + local[:, 2:] * found[:, 3:])

    def upward(self, local: Array, tile: Array) -> Array:
        """The body's normals (n, 3), as long as a tile is in the world."""
        return _between(self._places, *self._parameters(local, tile))[:, 3:]

    def normals(self, local: Array, tile: Array, normal: Array) -> Array:
        """Unit normals (n, 3) in the world of the bent sample, whose own are `normal` (n, 3)."""
        slopes = _between(self._slopes, *self._parameters(local, tile))
        depth = local[:, 2:]
        x, down = slopes[:, :3] + depth * slopes[:, 3:6], slopes[:, 6:9] + depth * slopes[:, 9:]
        y, z = -down, self.upward(local, tile)
        bent = normal[:, :1] * np.cross(y, z) + normal[:, 1:2] * np.cross(z, x) + normal[:, 2:] * np.cross(x, y)
        return unit(bent)

    def _parameters(self, local: Array, tile: Array) -> tuple[Array, Array]:
        """x runs along u, y against v."""
        return (local[:, 0] + 0.5 + tile[..., 0]) / self.tiles[0], (0.5 - local[:, 1] + tile[..., 1]) / self.tiles[1]

    @cached_property
    def _places(self) -> Array:
        """P and s n (rows, columns, 6)."""
        rows, columns = (np.linspace(0.0, 1.0, cells + 1) for cells in _CELLS)
        v, u = (axis.ravel() for axis in np.meshgrid(rows, columns, indexing="ij"))
        positions, normals, _ = self.surface(u, v)
        along_u = (self.surface(u + _STEP, v)[0] - self.surface(u - _STEP, v)[0]) / (2 * _STEP * self.tiles[0])
        along_v = (self.surface(u, v + _STEP)[0] - self.surface(u, v - _STEP)[0]) / (2 * _STEP * self.tiles[1])
        scale = np.sqrt(np.linalg.norm(np.cross(along_u, along_v), axis=1, keepdims=True))
        return np.hstack([positions, scale * unit(normals)]).reshape(len(rows), len(columns), 6)

    @cached_property
    def _slopes(self) -> Array:
        """What `_places` change by over a tile along u and along v (rows, columns, 12)."""
        along = [
            np.gradient(self._places, axis=axis, edge_order=2) * _CELLS[axis] / self.tiles[1 - axis] for axis in (1, 0)
        ]
        return np.concatenate(along, axis=2)


@numba.njit(cache=True)
def _between(table: Array, u: Array, v: Array) -> Array:
    """Bilinear values (n, k) of a table (rows, columns, k) over [0, 1], continued straight beyond."""
    rows, columns, count = table.shape[0] - 1, table.shape[1] - 1, table.shape[2]
    out = np.empty((u.size, count))
    for i in range(u.size):
        x, y = u[i] * columns, v[i] * rows
        c, r = min(max(int(x), 0), columns - 1), min(max(int(y), 0), rows - 1)
        right, down = x - c, y - r
        for k in range(count):
            upper = table[r, c, k] + right * (table[r, c + 1, k] - table[r, c, k])
            lower = table[r + 1, c, k] + right * (table[r + 1, c + 1, k] - table[r + 1, c, k])
            out[i, k] = upper + down * (lower - upper)
    return out
