"""Two fish-eye pictures, back to back, as samples of the whole sphere."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from processing.cameras.lens import Fisheye
from processing.environment.area_average import area_averages, cube_targets
from processing.products.arrays import Float32, Float64
from processing.products.light_environment import cube_directions, cube_solid_angles

_BAND = 0.06  # of the field's half: over which a picture fades out towards its rim
_FILLED, _BEYOND = 1e-3, 1e-9  # weight of what was made anew, and of the rim where neither picture sees
_TABLE = 4096
_UNCOVERED = 32  # texels of the cubemap by which uncovered directions are measured


@dataclass(frozen=True, eq=False)
class FisheyeView:
    """One picture (h, w, 3), finite, its lens, how far from the axis it sees, its frame and its true pixels (h, w)."""

    picture: NDArray[np.floating]
    lens: Fisheye
    reach_rad: float
    world_from_camera: Float64
    true: NDArray[np.bool_]

    @cached_property
    def _radii(self) -> tuple[Float64, Float64]:
        """Angles from the axis and their distances from the image's centre, in units of the plane at distance 1."""
        polar = np.linspace(0.0, min(self.lens.reach_rad, np.pi - 1e-6), _TABLE)
        rays = np.stack([np.sin(polar), 0 * polar, np.cos(polar)], axis=-1)
        rays[0] = [1e-9, 0, 1]
        return polar, (self.lens.project(rays)[:, 0] - self.lens.matrix[0, 2]) / self.lens.matrix[0, 0]

    @cached_property
    def polar_rad(self) -> Float64:
        """Angle from the axis (h, w) of each pixel, NaN where the lens forms no image."""
        rows, columns = np.indices(self.picture.shape[:2])
        matrix = self.lens.matrix
        radius = np.hypot((columns - matrix[0, 2]) / matrix[0, 0], (rows - matrix[1, 2]) / matrix[1, 1])
        polar, radii = self._radii
        return np.asarray(np.interp(radius, radii, polar, right=np.nan), np.float64)

    @cached_property
    def solid_angles(self) -> Float64:
        """Solid angle (h, w) of each pixel: sin(theta) over radius, times the derivative of theta by the radius."""
        polar, radii = self._radii
        stretch = np.gradient(polar, radii) * np.sin(polar) / np.maximum(radii, 1e-12)
        stretch[0] = stretch[1]
        matrix = self.lens.matrix
        found = np.interp(np.nan_to_num(self.polar_rad), polar, stretch) / (matrix[0, 0] * matrix[1, 1])
        return np.where(np.isfinite(self.polar_rad), found, 0.0)

    def weights(self, polar_rad: Float64, true: Float64) -> Float64:
        """How much a picture counts at angles from its axis, where that share of it is true."""
        fade = np.clip((self.reach_rad - polar_rad) / (_BAND * self.reach_rad), 0.0, 1.0)
        inside = np.maximum(fade * fade * (3 - 2 * fade) * true, _FILLED * np.maximum(fade, 1e-3))
        return np.where(polar_rad <= self.reach_rad, inside, _BEYOND * (1.0 + np.cos(polar_rad)))

    def look(self, directions: Float64) -> tuple[NDArray[np.intp], Float64, Float64]:
        """Pixels and weights (k, 4) at world directions (k, 3), as far out as the picture sees; and its own weight."""
        local = directions @ self.world_from_camera
        across = np.hypot(local[:, 0], local[:, 1])
        polar = np.arctan2(across, local[:, 2])
        held = np.minimum(polar, self.reach_rad)
        outward = local[:, :2] / np.maximum(across, 1e-12)[:, None]
        angles, radii = self._radii
        matrix = self.lens.matrix
        place = outward * np.interp(held, angles, radii)[:, None] * matrix[[0, 1], [0, 1]] + matrix[:2, 2]
        height, width = self.true.shape
        place = np.clip(place, 0, np.array([width - 1.001, height - 1.001]))
        first = place.astype(np.intp)
        part = place - first
        index = (first[:, 1] * width + first[:, 0])[:, None] + np.array([0, 1, width, width + 1])
        along, down = part.T
        taps = np.stack([(1 - along) * (1 - down), along * (1 - down), (1 - along) * down, along * down], axis=-1)
        true = (taps * self.true.ravel()[index]).sum(axis=1)
        return index, taps, self.weights(polar, true)

    @property
    def directions(self) -> Float64:
        """World directions (h w, 3) of the pixels; the axis where there is none."""
        rows, columns = np.indices(self.picture.shape[:2])
        matrix = self.lens.matrix
        x, y = (columns - matrix[0, 2]) / matrix[0, 0], (rows - matrix[1, 2]) / matrix[1, 1]
        polar = np.nan_to_num(self.polar_rad)
        level = np.sin(polar) / np.maximum(np.hypot(x, y), 1e-12)
        local = np.stack([level * x, level * y, np.cos(polar)], axis=-1).reshape(-1, 3)
        return np.asarray(local @ self.world_from_camera.T)


@dataclass(frozen=True, eq=False)
class FisheyePair:
    """Front and back as `Samples`: where both see, they are blended; where neither does, the nearest rim counts."""

    front: FisheyeView
    back: FisheyeView

    @property
    def radiance(self) -> Float64:
        """As of `Samples`: the front's pixels, then the back's."""
        return np.concatenate([view.picture.reshape(-1, 3).astype(np.float64) for view in (self.front, self.back)])

    @cached_property
    def solid_angles(self) -> Float64:
        """As of `Samples`: each pixel's own, shared where both see; and what the rim stands in for."""
        shares = []
        for view, other in ((self.front, self.back), (self.back, self.front)):
            own = view.weights(np.nan_to_num(view.polar_rad, nan=np.pi).ravel(), view.true.ravel().astype(np.float64))
            others = other.look(view.directions)[2]
            seen = np.nan_to_num(view.polar_rad, nan=np.pi).ravel() <= view.reach_rad
            shares.append(np.where(seen, view.solid_angles.ravel() * own / (own + others), 0.0))
        found = np.concatenate(shares)
        directions, angles = self._uncovered
        if len(directions):
            index, weight = self.taps(directions)
            found += np.bincount(index.ravel(), (weight * angles[:, None]).ravel(), minlength=len(found))
        return np.asarray(found, np.float64)

    @cached_property
    def _uncovered(self) -> tuple[Float64, Float64]:
        directions = cube_directions(_UNCOVERED).reshape(-1, 3)
        angles = np.tile(cube_solid_angles(_UNCOVERED).ravel(), 6)
        out = np.all([
            (directions @ view.world_from_camera)[:, 2] < np.cos(view.reach_rad) for view in (self.front, self.back)
        ], axis=0)  # fmt: skip
        return directions[out], angles[out]

    @property
    def uncovered(self) -> float:
        """Share of the sphere that neither picture sees."""
        return float(self._uncovered[1].sum() / (4 * np.pi))

    @property
    def groups(self) -> NDArray[np.intp]:
        """As of `Samples`: each its own."""
        return np.arange(2 * self.front.true.size)

    @property
    def spacing_rad(self) -> float:
        """As of `Samples`: a pixel near the centre; those at the rim are no closer by much."""
        return float(1.0 / self.front.lens.matrix[0, 0])

    def taps(self, directions: Float64) -> tuple[NDArray[np.intp], Float64]:
        """As of `Samples`: four pixels of each picture."""
        one, other = self.front.look(directions), self.back.look(directions)
        share = (one[2] / (one[2] + other[2]))[:, None]
        index = np.concatenate([one[0], other[0] + self.front.true.size], axis=1)
        return index, np.concatenate([one[1] * share, other[1] * (1 - share)], axis=1)


def cubemap_of_pair(pair: FisheyePair, size: int) -> Float32:
    """Radiance (6, n, n, 3) straight from the photographs' pixels, each giving its own light and no more."""
    return area_averages(pair, cube_targets(size, pair.spacing_rad)).reshape(6, size, size, 3)
