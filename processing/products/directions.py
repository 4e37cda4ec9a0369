"""A triangulated set of directions, to interpolate a measured material between them."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay, QhullError

from processing.errors import ImageError
from processing.products.arrays import Float64, Int32

CELLS = 64


@dataclass(frozen=True, eq=False)
class DirectionMesh:
    """Directions over the upper hemisphere, triangulated over the (x, y) disc.

    `directions` (n, 3) are unit vectors away from the sample, `triangles` (m, 3) index them (Delaunay).
    `cells` (64, 64), row = y and column = x over [-1, 1], names for each cell the triangle that its centre
    lies in, or the nearest one outside the hull: a shader needs no search.
    """

    directions: Float64
    triangles: Int32
    cells: Int32

    @classmethod
    def from_directions(cls, directions: Float64) -> "DirectionMesh":
        """Triangulate; raises ImageError for fewer than three directions or all of them on one line of the disc."""
        directions = np.asarray(directions, np.float64)
        try:
            triangles = Delaunay(directions[:, :2]).simplices.astype(np.int32)
        except (QhullError, ValueError) as error:
            raise ImageError(
                f"{len(directions)} directions do not span an area of the disc: three or more, not on one line, are "
                "needed of lights and of views alike."
            ) from error
        return cls(directions, triangles, _cell_table(directions[:, :2], triangles))

    def weights(self, direction: Float64) -> tuple[Int32, Float64]:
        """Indices (n, 3) of three measured directions and their weights (n, 3), for directions (n, 3).

        Cell, then triangle, then barycentric coordinates of the exact point, clamped at 0 and renormalised.
        """
        xy = np.asarray(direction, np.float64)[:, :2]
        cell = np.clip(np.floor((xy + 1) * (CELLS / 2)).astype(np.intp), 0, CELLS - 1)
        indices = self.triangles[self.cells[cell[:, 1], cell[:, 0]]]
        weights = np.maximum(_barycentric(self.directions[:, :2][indices], xy), 0.0)
        return indices, weights / weights.sum(axis=1, keepdims=True)


def _barycentric(corners: Float64, xy: Float64) -> Float64:
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    area = _cross(b - a, c - a)
    second = _cross(xy - a, c - a) / area
    third = _cross(b - a, xy - a) / area
    return np.stack([1 - second - third, second, third], axis=-1)


def _cross(a: Float64, b: Float64) -> Float64:
    product: Float64 = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product


def _cell_table(xy: Float64, triangles: Int32) -> Int32:
    centre = (np.arange(CELLS) + 0.5) * (2 / CELLS) - 1
    points = np.stack(np.meshgrid(centre, centre), axis=-1).reshape(-1, 2)
    distance = np.stack([_squared_distance(points, xy[triangle]) for triangle in triangles])
    nearest: Int32 = np.argmin(distance, axis=0).astype(np.int32)
    return nearest.reshape(CELLS, CELLS)


def _squared_distance(points: Float64, corners: Float64) -> Float64:
    inside = np.min(_barycentric(corners, points), axis=-1) >= 0
    distance = np.full(len(points), np.inf)
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        edge = end - start
        along = np.clip((points - start) @ edge / (edge @ edge), 0, 1)
        distance = np.minimum(distance, ((start + along[:, None] * edge - points) ** 2).sum(axis=-1))
    return np.where(inside, 0.0, distance)


def toward(points: Float64, direction: Float64, distance: float) -> Float64:
    """Unit vectors (..., 3) from points (..., 3) to what lies `distance` from their origin in a unit direction (3,)."""
    if np.isinf(distance):
        return np.broadcast_to(np.asarray(direction, np.float64), points.shape).copy()
    vector = direction * distance - points
    return np.asarray(vector / np.linalg.norm(vector, axis=-1, keepdims=True), np.float64)


def falloff(points: Float64, direction: Float64, distance: float) -> Float64:
    """Irradiance at normal incidence at points (..., 3) over that at the origin, (...); arguments as in `toward`."""
    if np.isinf(distance):
        return np.ones(points.shape[:-1])
    way = direction * distance - points
    return np.asarray(distance**2 / (way * way).sum(axis=-1), np.float64)
