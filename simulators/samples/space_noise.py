"""Noise of places in space, and bumps of it: for surfaces around which no texture is wrapped."""

from collections.abc import Callable

import numba
import numpy as np

from simulators.scene import Array, Floats

STEP = 1e-3  # between the places of which a gradient is the difference, in radii


def tilted_normals(unit: Array, height: Callable[[Array], Array], amount: Array) -> Floats:
    """Normals (n, 3) of a unit sphere at places (n, 3) of it, raised by amount (n,) times a height of the place.

    `height` maps places (n, 3) near the sphere to numbers (n,); the amount's own slope is left out.
    """
    gradient = np.empty_like(unit)
    for k in range(3):
        shift = np.zeros(3)
        shift[k] = STEP
        ahead, behind = (height(unit + sign * shift) for sign in (1, -1))
        gradient[:, k] = (ahead - behind) / (2 * STEP)
    along = np.einsum("nk,nk->n", gradient, unit)
    tilted = unit - amount[:, None] * (gradient - along[:, None] * unit)
    unit_length: Array = tilted / np.linalg.norm(tilted, axis=1, keepdims=True)
    return unit_length.astype(np.float32)


@numba.njit(cache=True)
def fractal(points: Array, seed: int, octaves: int) -> Array:
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
