"""A smooth, organic body with hollows in which it shades itself; no sphere and no height field."""

import numpy as np

from simulators.samples.bodies import capped_tubes
from simulators.samples.mesh import Mesh
from simulators.samples.noise import smooth_step
from simulators.samples.space_noise import fractal
from simulators.scene import Array

RADIUS_M = 0.045  # of its furthest point
RINGS, AROUND = 420, 640  # 0.2 to 0.4 mm between vertices
KNOBS = 9
CLAY, LEAF, PALE = (0.42, 0.20, 0.11), (0.10, 0.23, 0.17), (0.72, 0.66, 0.52)


def figure_mesh(seed: int) -> Mesh:
    """The body about the origin; a ray from there leaves it once. Its poles lie on the y axis."""
    polar, turn = np.meshgrid(
        np.pi * (np.arange(RINGS) + 0.5) / RINGS, 2 * np.pi * np.arange(AROUND) / AROUND, indexing="ij"
    )
    unit = np.stack([np.sin(polar) * np.cos(turn), -np.cos(polar), -np.sin(polar) * np.sin(turn)], axis=-1)
    flat = unit.reshape(-1, 3)
    distance, hollow = _outline(flat, seed)
    rings = (RADIUS_M * distance / distance.max())[:, None] * flat
    surface = _surface(flat, hollow, seed)
    return capped_tubes(rings.reshape(1, RINGS, AROUND, 3), surface.reshape(1, RINGS, AROUND, 5))


def _outline(unit: Array, seed: int) -> tuple[Array, Array]:
    """Distance from the middle (n,), and in [0, 1] how deep between the knobs it is (n,)."""
    rng = np.random.default_rng([seed, 17])
    raised = np.zeros(len(unit))
    for centre, width in zip(_spread_out(KNOBS, rng), rng.uniform(0.42, 0.62, KNOBS), strict=True):
        angle = np.arccos(np.clip(unit @ centre, -1, 1))
        raised += rng.uniform(0.5, 1.0) * np.exp(-((angle / width) ** 2))
    soft = fractal(unit * 1.7 + 2.3, seed + 40, 2)
    return 0.68 + 0.36 * raised + 0.10 * soft, 1 - smooth_step(0.25, 0.7, raised)


def _spread_out(count: int, rng: np.random.Generator) -> Array:
    """Unit vectors (count, 3), evenly spread by a spiral, then moved a little and turned by chance."""
    share = (np.arange(count) + 0.5) / count
    azimuth, z = np.pi * (1 + 5**0.5) * np.arange(count), 1 - 2 * share
    places = np.column_stack([np.sqrt(1 - z**2) * np.cos(azimuth), np.sqrt(1 - z**2) * np.sin(azimuth), z])
    places = places @ np.linalg.qr(rng.standard_normal((3, 3)))[0] + 0.12 * rng.standard_normal((count, 3))
    unit: Array = places / np.linalg.norm(places, axis=1, keepdims=True)
    return unit


def _surface(unit: Array, hollow: Array, seed: int) -> Array:
    """Albedo, specular and roughness (n, 5): clay, a glossy green glaze that ran into the hollows, pale spots."""
    mottle = fractal(unit * 9.0 + 1.1, seed + 41, 4)
    glazed = smooth_step(0.3, 0.6, hollow + 0.5 * fractal(unit * 3.1, seed + 42, 3))
    spots = smooth_step(0.16, 0.24, fractal(unit * 6.0 + 8.0, seed + 43, 2)) * (1 - glazed)
    colour = np.array(CLAY) + glazed[:, None] * (np.array(LEAF) - CLAY)
    colour = colour + spots[:, None] * (np.array(PALE) - colour)
    surface = np.empty((len(unit), 5))
    surface[:, :3] = np.clip(colour * (1 + 0.6 * mottle)[:, None], 0.02, 0.85)
    surface[:, 3] = 0.025 + 0.025 * glazed
    surface[:, 4] = np.clip(0.65 - 0.35 * glazed + 0.1 * mottle, 0.2, 1.0)
    return surface
