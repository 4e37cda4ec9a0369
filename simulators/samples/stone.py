"""Veined, uneven stone: matt and dark with ochre patches, polished in places."""

import numpy as np

from simulators.samples.noise import smooth_step
from simulators.samples.space_noise import fractal, tilted_normals
from simulators.scene import Array, Floats, Material

BUMP = 0.11  # how far the unevenness tilts the normal, as a slope


def stone(unit: Array, seed: int) -> tuple[Floats, Material]:
    """Bumpy normals (n, 3) and the material at unit vectors (n, 3)."""
    cloud = fractal(unit * 2.2 + 3.1, seed, 5)
    warped = unit * 3.0 + 0.9 * np.column_stack([fractal(unit * 2.0 + k * 7.7, seed + 1 + k, 3) for k in range(3)])
    vein = np.exp(-((fractal(warped, seed + 5, 4) / 0.035) ** 2)) * smooth_step(-0.3, 0.25, cloud)
    patch = smooth_step(0.08, 0.32, fractal(unit * 3.7 + 1.3, seed + 6, 4))
    warm = fractal(unit * 11.0, seed + 10, 3)
    grain = fractal(unit * 38.0, seed + 7, 2)
    colour = _mix(np.array([0.085, 0.115, 0.095]), np.array([0.33, 0.36, 0.29]), smooth_step(-0.45, 0.5, cloud))
    ochre = _mix(np.array([0.28, 0.17, 0.10]), np.array([0.52, 0.38, 0.22]), smooth_step(-0.4, 0.4, warm))
    colour = colour * (1 - 0.85 * patch[:, None]) + 0.85 * patch[:, None] * ochre
    colour = _mix(colour, np.array([0.74, 0.71, 0.64]), vein) * (1 + 0.55 * grain)[:, None]
    mica = smooth_step(0.42, 0.55, fractal(unit * 26.0 + 5.0, seed + 8, 1))
    polish = smooth_step(-0.25, 0.25, fractal(unit * 2.6 + 9.0, seed + 9, 3))
    specular = 0.028 + 0.022 * polish + 0.035 * mica - 0.015 * vein
    roughness = np.clip(0.54 - 0.16 * polish + 0.12 * patch + 0.1 * vein, 0.2, 1.0)
    normals = tilted_normals(unit, lambda place: fractal(place * 8.0, seed + 12, 2) / 8.0, BUMP * (1 - 0.6 * vein))
    surface = np.column_stack([np.clip(colour, 0.02, 0.85), specular, roughness]).astype(np.float32)
    return normals, Material(surface[:, :3].copy(), surface[:, 3].copy(), surface[:, 4].copy())


def _mix(first: Array, second: Array, share: Array) -> Array:
    mixed: Array = first * (1 - share[:, None]) + second * share[:, None]
    return mixed
