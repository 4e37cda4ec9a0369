"""The stone sphere and the matt white card below it."""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from simulators.layout import SphereLayout
from simulators.scene import Array, Hits, Mask, matt

BUMP = 0.11  # how far the unevenness tilts the normal, as a slope


@dataclass(frozen=True)
class SphereScene:
    """The sphere at the origin and the card at x = 0, facing +x; the scene's frame is the rig's, unturned."""

    layout: SphereLayout
    seed: int

    def trace(self, origin: Array, directions: Array) -> Hits:
        """First hits of rays from one origin (3,) along unit directions (n, 3)."""
        sphere_at = self._to_sphere(origin, directions)
        card_at = self._to_card(origin, directions)
        on_sphere, on_card = sphere_at < card_at, card_at < sphere_at
        ray = np.flatnonzero(on_sphere | on_card)
        points = origin + np.minimum(sphere_at, card_at)[ray, None] * directions[ray]
        return self._describe(ray, points, on_sphere[ray])

    def lit(self, hits: Hits, source: Array) -> Mask:
        """Which hits (n,) see the point source (3,)."""
        way = source - hits.points
        distance = np.linalg.norm(way, axis=1)
        way = way / distance[:, None]
        is_sphere = np.linalg.norm(hits.points, axis=1) < self.layout.radius_m * 1.0001
        facing = np.einsum("nk,nk->n", hits.points, way) > 0
        past_sphere = ~(self._to_sphere(hits.points, way) < distance)
        past_card = ~(self._to_card(hits.points, way) < distance)
        visible: Mask = np.where(is_sphere, facing & past_card, past_sphere)
        return visible

    def normal_hits(self, normals: Array) -> Hits:
        """The sphere's points where its own, even normal is this (n, 3)."""
        points = normals * self.layout.radius_m
        return self._describe(np.arange(len(points)), points, np.ones(len(points), bool))

    def _describe(self, ray: NDArray[np.int64], points: Array, on_sphere: Mask) -> Hits:
        material = matt(len(points), self.layout.card_albedo)
        normals = np.tile(np.array([1, 0, 0], np.float32), (len(points), 1))
        own = points[on_sphere] / self.layout.radius_m
        normals[on_sphere], stone = _stone(own, self.seed)
        material.albedo[on_sphere], material.specular[on_sphere] = stone[:, :3], stone[:, 3]
        material.roughness[on_sphere] = stone[:, 4]
        return Hits(ray, points, normals, material)

    def _to_sphere(self, origin: Array, directions: Array) -> Array:
        """Distance to the sphere's near side, infinity where it is missed or behind."""
        along = np.sum(origin * directions, axis=-1)
        square = along**2 - (np.sum(origin * origin, axis=-1) - self.layout.radius_m**2)
        with np.errstate(invalid="ignore"):
            near = -along - np.sqrt(square)
        return np.where((square > 0) & (near > 0), near, np.inf)

    def _to_card(self, origin: Array, directions: Array) -> Array:
        """Distance to the card, infinity where it is missed, behind, or touched by the origin itself."""
        card = self.layout
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = -origin[..., 0] / directions[..., 0]
            y = origin[..., 1] + distance * directions[..., 1] - card.card_y_m
            z = origin[..., 2] + distance * directions[..., 2] - card.card_z_m
        inside = (np.abs(y) <= card.card_width_m / 2) & (np.abs(z) <= card.card_height_m / 2)
        return np.where(inside & (distance > 1e-6), distance, np.inf)


def _stone(unit: Array, seed: int) -> tuple[NDArray[np.float32], Array]:
    """Bumpy normals (n, 3) and [red, green, blue, specular, roughness] (n, 5) of the stone at unit vectors."""
    cloud = _fractal(unit * 2.2 + 3.1, seed, 5)
    warped = unit * 3.0 + 0.9 * np.column_stack([_fractal(unit * 2.0 + k * 7.7, seed + 1 + k, 3) for k in range(3)])
    vein = np.exp(-((_fractal(warped, seed + 5, 4) / 0.035) ** 2)) * _step(-0.3, 0.25, cloud)
    patch = _step(0.08, 0.32, _fractal(unit * 3.7 + 1.3, seed + 6, 4))
    warm = _fractal(unit * 11.0, seed + 10, 3)
    grain = _fractal(unit * 38.0, seed + 7, 2)
    colour = _mix(np.array([0.085, 0.115, 0.095]), np.array([0.33, 0.36, 0.29]), _step(-0.45, 0.5, cloud))
    ochre = _mix(np.array([0.28, 0.17, 0.10]), np.array([0.52, 0.38, 0.22]), _step(-0.4, 0.4, warm))
    colour = colour * (1 - 0.85 * patch[:, None]) + 0.85 * patch[:, None] * ochre
    colour = _mix(colour, np.array([0.74, 0.71, 0.64]), vein) * (1 + 0.55 * grain)[:, None]
    mica = _step(0.42, 0.55, _fractal(unit * 26.0 + 5.0, seed + 8, 1))
    polish = _step(-0.25, 0.25, _fractal(unit * 2.6 + 9.0, seed + 9, 3))
    specular = 0.028 + 0.022 * polish + 0.035 * mica - 0.015 * vein
    roughness = np.clip(0.54 - 0.16 * polish + 0.12 * patch + 0.1 * vein, 0.2, 1.0)
    stone = np.column_stack([np.clip(colour, 0.02, 0.85), specular, roughness])
    return _bumpy(unit, seed, vein), stone


def _bumpy(unit: Array, seed: int, vein: Array) -> NDArray[np.float32]:
    """Normals (n, 3) tilted by the gradient of a noise of the place."""
    step = 1e-3
    gradient = np.empty_like(unit)
    for k in range(3):
        shift = np.zeros(3)
        shift[k] = step
        ahead, behind = (_fractal((unit + sign * shift) * 8.0, seed + 12, 2) for sign in (1, -1))
        gradient[:, k] = (ahead - behind) / (2 * step * 8.0)
    along = np.einsum("nk,nk->n", gradient, unit)
    tilted = unit - (BUMP * (1 - 0.6 * vein))[:, None] * (gradient - along[:, None] * unit)
    unit_length: Array = tilted / np.linalg.norm(tilted, axis=1, keepdims=True)
    return unit_length.astype(np.float32)


def _mix(first: Array, second: Array, share: Array) -> Array:
    mixed: Array = first * (1 - share[:, None]) + second * share[:, None]
    return mixed


def _step(low: float, high: float, values: Array) -> Array:
    share = np.clip((values - low) / (high - low), 0, 1)
    smooth: Array = share * share * (3 - 2 * share)
    return smooth


@numba.njit(cache=True)
def _fractal(points: Array, seed: int, octaves: int) -> Array:
    """Gradient noise of space (n,), about -0.7 to 0.7, summed over octaves of half the amplitude each."""
    out = np.zeros(len(points))
    for i in range(len(points)):
        scale, weight = 1.0, 1.0
        for octave in range(octaves):
            x, y, z = points[i, 0] * scale, points[i, 1] * scale, points[i, 2] * scale
            out[i] += weight * _gradient_noise((x, y, z), seed * 31 + octave)
            scale, weight = scale * 2.03, weight * 0.5
    return out


@numba.njit(cache=True)
def _gradient_noise(point: tuple[float, float, float], seed: int) -> float:
    """Random slopes at the corners of the unit lattice, blended by fifth-degree fades."""
    total = 0.0
    for corner in range(8):
        weight, slope = 1.0, 0.0
        state = np.uint64(seed)
        for k in range(3):
            state = _scramble(state ^ np.uint64(np.int64(np.floor(point[k])) + ((corner >> k) & 1)))
        for k in range(3):
            offset = point[k] - np.floor(point[k]) - ((corner >> k) & 1)
            away = abs(offset)
            weight *= 1 - away * away * away * (away * (away * 6 - 15) + 10)
            slope += offset * (float((state >> np.uint64(21 * k)) & np.uint64(0x1FFFFF)) / 2.0**20 - 1.0)
        total += weight * slope
    return total


@numba.njit(cache=True)
def _scramble(state: np.uint64) -> np.uint64:
    """The finaliser of SplitMix64 (Steele, Lea and Flood 2014)."""
    state = state + np.uint64(0x9E3779B97F4A7C15)
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return state ^ (state >> np.uint64(31))
