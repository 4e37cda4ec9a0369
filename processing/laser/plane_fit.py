"""A plane through 3D points of which some may be wrong."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.errors import ImageError
from processing.robust import biweight, bulk_deviation, principal_axes

Array = NDArray[np.float64]
_ROUNDS = 20
_LEAST_SCALE_M = 1e-12  # of exact points, whose scatter is rounding


@dataclass(frozen=True)
class Plane:
    """The plane normal . p = offset_m with a unit normal, the RMS distance of the points that make it, their number."""

    normal: Array
    offset_m: float
    rms_m: float
    points: int

    @classmethod
    def of_board(cls, camera_from_board: Array) -> "Plane":
        """The plane z = 0 of a board, camera frame; no points made it."""
        normal = camera_from_board[:3, 2]
        return cls(normal, float(normal @ camera_from_board[:3, 3]), np.nan, 0)

    def distance(self, points_m: Array) -> Array:
        """Signed distances (...) of points (..., 3)."""
        return np.asarray(points_m @ self.normal - self.offset_m)

    def cut(self, rays: Array) -> Array:
        """Points (..., 3) where rays from the origin meet the plane; NaN where they do not."""
        return geometry.intersect_plane(np.zeros(3), rays, self.normal, self.offset_m)

    def towards(self, direction: Array) -> "Plane":
        """The same plane with its normal on the side of `direction`."""
        if self.normal @ direction >= 0:
            return self
        return Plane(-self.normal, -self.offset_m, self.rms_m, self.points)


def fit_plane(points_m: Array) -> Plane:
    """Total least squares plane through points (n, 3), reweighted (Tukey) against outliers.

    Raises ImageError where fewer than three finite points are given or they lie on a line.
    """
    points = np.asarray(points_m, np.float64).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    weight = np.ones(len(points))
    for _ in range(_ROUNDS):
        if np.count_nonzero(weight) < 3:
            raise ImageError(f"{len(points)} points do not make a plane.")
        centre, spread, axes = principal_axes(points, weight)
        if spread[1] <= 1e-12 * spread[2] or spread[2] == 0.0:
            raise ImageError("the points lie on a line: more than one pose of the board is needed.")
        distance = (points - centre) @ axes[:, 0]
        weight = biweight(distance, max(bulk_deviation(distance), _LEAST_SCALE_M))
    used = weight > 0.0
    normal = axes[:, 0]
    return Plane(normal, float(normal @ centre), float(np.sqrt(np.mean(distance[used] ** 2))), int(used.sum()))


def plane_angle(a: Plane, b: Plane) -> float:
    """Angle in radians between two planes, 0 to pi/2."""
    return float(np.arctan2(np.linalg.norm(np.cross(a.normal, b.normal)), abs(float(a.normal @ b.normal))))
