"""Where a body is all but touched: there its visibility is found at the vertices themselves, not between sample points.

Between sample points that are a gap apart, what hides a direction at distance d is out of place by gap / d: too much
close to the surface, however fine the points are. How far "close" reaches is a share of the body's radius, the same for
all fields, so that finer fields are never worse.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from processing.lighting.rays import Bool
from processing.lighting.triangle_body import TriangleBody
from processing.products.arrays import Float64

CONTACT = 0.1  # of the radius
_CELLS = 4  # of the grid along that distance
_POINTS = 1 << 20  # in memory at a time


@dataclass(frozen=True, eq=False)
class ContactZone:
    """A grid of cubes of side `cell_m` from `low` (3,) on in a body's frame; in those `close` (i, j, k) it is near."""

    low: Float64
    cell_m: float
    close: Bool

    def holds(self, points: Float64) -> Bool:
        """Points (n, 3) in cells that are close."""
        place = np.floor((points - self.low) / self.cell_m).astype(np.int64)
        inside = np.flatnonzero(((place >= 0) & (place < self.close.shape)).all(axis=1))
        found = np.zeros(len(points), np.bool_)
        found[inside] = self.close[tuple(place[inside].T)]
        return found


def contact_zone(body: TriangleBody) -> ContactZone:
    """The cells within a tenth of the radius of a body's triangles, to a cell's diagonal."""
    reach = CONTACT * body.radius
    cell = reach / _CELLS
    used = body.vertices[body.triangles]
    low = used.min(axis=(0, 1)) - reach - cell
    shape = np.ceil((used.max(axis=(0, 1)) + reach + cell - low) / cell).astype(np.int64) + 1
    free = np.ones(shape, np.bool_)
    for corners in _equally_long(used, cell):
        place = ((corners - low) / cell).astype(np.int64)
        free[place[:, 0], place[:, 1], place[:, 2]] = False
    return ContactZone(low, cell, np.asarray(distance_transform_edt(free) <= _CELLS))


def _equally_long(triangles: Float64, step: float) -> Iterator[Float64]:
    """Points (n, 3) on triangles, no further than a step apart, of some triangles that need as many at a time."""
    longest = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=-1).max(axis=1)
    counts = np.maximum(np.ceil(longest / step), 1).astype(np.int64)
    for count in np.unique(counts):
        u, v = np.meshgrid(np.arange(count + 1) / count, np.arange(count + 1) / count, indexing="ij")
        inside = u + v <= 1 + 1e-9
        shares = np.column_stack([u[inside], v[inside], 1 - u[inside] - v[inside]])
        those, part = triangles[counts == count], max(_POINTS // len(shares), 1)
        for start in range(0, len(those), part):
            yield np.einsum("sk,tki->tsi", shares, those[start : start + part]).reshape(-1, 3)
