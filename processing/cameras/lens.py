"""Lenses: how directions in front of a camera become image points, and back.

A lens first bends the direction of a point (camera frame: x right, y down, z forward) to a place on a plane at unit
distance, then the matrix scales that place to pixels. `Pinhole` and `Fisheye` differ in how they bend.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from processing import geometry

Array = NDArray[np.float64]
_NEWTON_STEPS = 30
_SAME_PX = 1e-3  # a ray that is imaged farther than this from its point is none


@dataclass(frozen=True)
class Lens(ABC):
    """`matrix` (3, 3) with focal lengths and principal point in pixels, `distortion` (coefficients,)."""

    matrix: Array
    distortion: Array

    name: ClassVar[str]
    # One sigma of what is believed of each coefficient before a view is seen.
    distortion_sigma: ClassVar[Array]

    @property
    def parameters(self) -> int:
        """How many numbers describe it: fx fy cx cy and the distortion."""
        return 4 + len(self.distortion)

    def moved(self, step: Array) -> Self:
        """The lens after a step of its parameters."""
        matrix = self.matrix.copy()
        matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += step[:4]
        return replace(self, matrix=matrix, distortion=self.distortion + step[4:])

    @abstractmethod
    def project(self, points_m: NDArray[np.floating]) -> Array:
        """Image points (..., 2) of points (..., 3) in the camera frame; NaN where the lens forms no image of them."""

    @abstractmethod
    def rays(self, uv_px: NDArray[np.floating]) -> Array:
        """Unit directions (..., 3) in the camera frame of image points (..., 2); NaN where nothing is imaged there."""

    def linearised(self, points_m: Array) -> tuple[Array, Array, Array]:
        """Image points (n, 2) and their derivatives by the lens's parameters (n, 2, p) and by the points (n, 2, 3).

        The formula itself, also beyond the field where it no longer describes a lens; NaN where it has no value.
        """
        plane, by_coefficient, by_point = self._bent(points_m)
        focal = self.matrix[[0, 1], [0, 1]]
        by_lens = np.zeros((len(points_m), 2, self.parameters))
        by_lens[:, [0, 1], [0, 1]] = plane
        by_lens[:, [0, 1], [2, 3]] = 1.0
        by_lens[:, :, 4:] = focal[:, None] * by_coefficient
        return self._pixels(plane), by_lens, np.asarray(focal[:, None] * by_point)

    @abstractmethod
    def _bent(self, points: Array) -> tuple[Array, Array, Array]:
        """Places (n, 2) on the plane, derivatives by the coefficients (n, 2, k) and by the points (n, 2, 3)."""

    def _pixels(self, plane: Array) -> Array:
        return np.asarray(plane * self.matrix[[0, 1], [0, 1]] + self.matrix[:2, 2], np.float64)

    def _plane(self, uv_px: Array) -> Array:
        return np.asarray((uv_px - self.matrix[:2, 2]) / self.matrix[[0, 1], [0, 1]], np.float64)


@dataclass(frozen=True)
class Pinhole(Lens):
    """Perspective with radial and tangential distortion k1 k2 p1 p2 k3 (Brown 1966, as in OpenCV's calib3d)."""

    name: ClassVar[str] = "pinhole"
    distortion_sigma: ClassVar[Array] = np.array([0.3, 0.3, 0.005, 0.005, 0.3])

    def project(self, points_m: NDArray[np.floating]) -> Array:
        """NaN behind the camera, and beyond the angle at which the distortion would fold the image back."""
        points = np.asarray(points_m, np.float64).reshape(-1, 3)
        uv_px = geometry.project(points, self.matrix, self.distortion, np.eye(4))
        depth = np.where(points[:, 2] > 0, points[:, 2], np.nan)
        within = np.hypot(points[:, 0], points[:, 1]) <= self._reach * depth
        uv_px[~within] = np.nan
        return np.asarray(uv_px.reshape(*np.shape(points_m)[:-1], 2))

    def rays(self, uv_px: NDArray[np.floating]) -> Array:
        """As of `Lens`; NaN beyond the fold, where the distortion has no inverse."""
        rays = geometry.pixel_rays(uv_px, self.matrix, self.distortion, np.eye(4))
        rays[~(np.linalg.norm(self.project(rays) - uv_px, axis=-1) < _SAME_PX)] = np.nan
        return rays

    @property
    def _reach(self) -> float:
        """Tangent of the angle from the axis up to which points farther out are imaged farther out."""
        k1, k2, _, _, k3 = self.distortion
        return float(np.sqrt(_first_root(np.array([1.0, 3 * k1, 5 * k2, 7 * k3]), np.inf)))

    def _bent(self, points: Array) -> tuple[Array, Array, Array]:
        k1, k2, p1, p2, k3 = self.distortion
        depth = np.where(points[:, 2] > 0, points[:, 2], np.nan)
        x, y = points[:, 0] / depth, points[:, 1] / depth
        xx, xy, yy = x * x, x * y, y * y
        r2 = xx + yy
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))  # by r2, times two
        plane = np.stack([
            x * radial + 2 * p1 * xy + p2 * (r2 + 2 * xx), y * radial + p1 * (r2 + 2 * yy) + 2 * p2 * xy
        ], axis=-1)  # fmt: skip
        straight = np.stack([x, y], axis=-1)
        by_p1, by_p2 = np.stack([2 * xy, r2 + 2 * yy], axis=-1), np.stack([r2 + 2 * xx, 2 * xy], axis=-1)
        by_k1 = straight * r2[:, None]
        by_k2 = by_k1 * r2[:, None]
        by_coefficient = np.stack([by_k1, by_k2, by_p1, by_p2, by_k2 * r2[:, None]], axis=-1)
        cross = xy * slope + 2 * (p1 * x + p2 * y)
        by_x = np.stack([radial + xx * slope + 2 * p1 * y + 6 * p2 * x, cross], axis=-1)
        by_y = np.stack([cross, radial + yy * slope + 6 * p1 * y + 2 * p2 * x], axis=-1)
        by_depth = -(by_x * x[:, None] + by_y * y[:, None])
        return plane, by_coefficient, np.stack([by_x, by_y, by_depth], axis=-1) / depth[:, None, None]


@dataclass(frozen=True)
class Fisheye(Lens):
    """The angle from the axis, bent by k1 k2 k3 k4, is the distance from the centre (Kannala and Brandt 2006).

    theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8), as in OpenCV's `fisheye`, but of the true angle, so
    that points beside and behind the camera are imaged too: lenses of more than 180 deg have them.
    """

    name: ClassVar[str] = "fisheye"
    distortion_sigma: ClassVar[Array] = np.array([0.1, 0.1, 0.1, 0.1])

    def project(self, points_m: NDArray[np.floating]) -> Array:
        """NaN beyond the angle at which the formula turns back; straight behind and in the centre no side is known."""
        points = np.asarray(points_m, np.float64).reshape(-1, 3)
        across = np.hypot(points[:, 0], points[:, 1])
        theta = np.arctan2(across, points[:, 2])
        scale = np.divide(self._radius(theta), across, out=np.ones_like(across), where=across > 0)
        plane = points[:, :2] * scale[:, None]
        plane[~(theta <= self.reach_rad) | (theta == np.pi) | ((across == 0) & (points[:, 2] == 0))] = np.nan
        return self._pixels(plane).reshape(*np.shape(points_m)[:-1], 2)

    def rays(self, uv_px: NDArray[np.floating]) -> Array:
        """As of `Lens`; NaN outside of the image circle."""
        plane = self._plane(np.asarray(uv_px, np.float64).reshape(-1, 2))
        radius = np.hypot(plane[:, 0], plane[:, 1])
        theta = self._angle(radius)
        scale = np.divide(np.sin(theta), radius, out=np.ones_like(radius), where=radius > 0)
        local = np.concatenate([plane * scale[:, None], np.cos(theta)[:, None]], axis=1)
        return local.reshape(*np.shape(uv_px)[:-1], 3)

    @property
    def reach_rad(self) -> float:
        """Angle from the axis up to which the formula describes a lens: points farther out are imaged farther out."""
        slope = np.concatenate([[1.0], np.array([3, 5, 7, 9]) * self.distortion])
        return float(np.sqrt(_first_root(slope, np.pi**2)))

    def _radius(self, theta: Array) -> Array:
        s = theta * theta
        k1, k2, k3, k4 = self.distortion
        return np.asarray(theta * (1 + s * (k1 + s * (k2 + s * (k3 + s * k4)))), np.float64)

    def _slope(self, theta: Array) -> Array:
        s = theta * theta
        k1, k2, k3, k4 = self.distortion
        return np.asarray(1 + s * (3 * k1 + s * (5 * k2 + s * (7 * k3 + s * 9 * k4))), np.float64)

    def _angle(self, radius: Array) -> Array:
        """Inverse of `_radius` below `reach_rad` by Newton's method kept between bounds; NaN beyond."""
        low, high = np.zeros_like(radius), np.full_like(radius, self.reach_rad)
        outside = ~(radius <= self._radius(high))
        theta = np.clip(radius, 0, self.reach_rad)
        for _ in range(_NEWTON_STEPS):
            excess = self._radius(theta) - radius
            low, high = np.where(excess <= 0, theta, low), np.where(excess >= 0, theta, high)
            with np.errstate(divide="ignore", invalid="ignore"):
                newton = theta - excess / self._slope(theta)
            theta = np.where((newton >= low) & (newton <= high), newton, (low + high) / 2)
        theta[outside] = np.nan
        return theta

    def _bent(self, points: Array) -> tuple[Array, Array, Array]:
        across2 = points[:, 0] ** 2 + points[:, 1] ** 2
        across, depth, distance2 = np.sqrt(across2), points[:, 2], across2 + points[:, 2] ** 2
        theta = np.arctan2(across, depth)
        theta = np.where(theta < np.pi, theta, np.nan)
        on_axis = across2 < 1e-20 * distance2
        safe = np.where(on_axis, 1.0, across)
        radius, slope = self._radius(theta), self._slope(theta)
        scale = np.where(on_axis, 1 / np.where(depth > 0, depth, np.nan), radius / safe)
        outward = points[:, :2] / safe[:, None]
        powers = theta[:, None] ** np.array([3, 5, 7, 9])
        by_coefficient = outward[:, :, None] * powers[:, None, :]
        rise = slope * depth / distance2 - scale  # how much the derivative along the radius exceeds that across it
        by_point = np.zeros((len(points), 2, 3))
        by_point[:, :, :2] = outward[:, :, None] * outward[:, None, :] * rise[:, None, None]
        by_point[:, [0, 1], [0, 1]] += scale[:, None]
        by_point[:, :, 2] = -outward * (slope * across / distance2)[:, None]
        return points[:, :2] * scale[:, None], by_coefficient, by_point


LENSES: dict[str, type[Lens]] = {lens.name: lens for lens in (Pinhole, Fisheye)}


def _first_root(coefficients: Array, end: float) -> float:
    """Smallest positive root of a polynomial, lowest power first, or `end` where none lies before it."""
    roots = np.polynomial.polynomial.polyroots(np.trim_zeros(coefficients, "b"))
    real = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
    return min(float(real.min()), end) if real.size else end
