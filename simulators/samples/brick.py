"""Bricks in mortar: a height field. Noise and pattern are periodic, so that it can be tiled without a seam."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from simulators.samples.noise import band_noise, smooth_step
from simulators.samples.relief import Relief

Array = NDArray[np.float64]

COURSES, BRICKS = 6, 3  # rows of bricks over the field, bricks per row
GAP_M = 0.0018  # width of the mortar joints


def brick_relief(side_m: float, seed: int, n: int = 512) -> Relief:
    """Weathered bricks in running bond: rounded, uneven, glazed in places, in recessed sandy mortar."""
    rng = np.random.default_rng([seed, 11])
    pattern = _lay_bricks(side_m, n, rng)
    inside = pattern.inside
    height = _heights(pattern, n, rng)
    albedo = pattern.inside[..., None] * _brick_colour(pattern, n, rng) + (1 - inside)[..., None] * _mortar_colour(
        n, rng
    )
    gloss = inside * smooth_step(-0.2, 0.9, band_noise(rng, n, (2, 12), 1.0))  # glazed patches
    roughness = np.clip(0.85 - 0.25 * inside - 0.22 * gloss + 0.03 * band_noise(rng, n, (10, 80), 0.5), 0.3, 1.0)
    specular = np.clip(0.006 + 0.03 * inside * pattern.per_brick(rng.uniform(0.5, 1.3, 18)) + 0.03 * gloss, 0.0, 0.12)
    return Relief(side_m, height, np.clip(albedo, 0.02, 0.85), specular, roughness)


@dataclass(frozen=True)
class _Pattern:
    """Which brick each texel belongs to, where in it, and how far from its edge (metres, positive inside)."""

    brick: NDArray[np.int64]
    along_m: Array
    across_m: Array
    edge_m: Array
    inside: Array  # 1 in bricks, 0 in mortar, soft between

    def per_brick(self, values: Array) -> Array:
        """One value per brick, spread over its texels."""
        spread: Array = values[self.brick]
        return spread


def _lay_bricks(side_m: float, n: int, rng: np.random.Generator) -> _Pattern:
    centre = (np.arange(n) + 0.5) / n * side_m
    x, y = np.meshgrid(centre, centre)
    x = x + 0.00022 * band_noise(rng, n, (2, 24), 1.0)
    y = y + 0.00022 * band_noise(rng, n, (2, 24), 1.0)
    length, width = side_m / BRICKS, side_m / COURSES
    course = np.floor(y / width).astype(int)
    x = x + 0.5 * length * (course % 2)
    column = np.floor(x / length).astype(int)
    along, across = x - (column + 0.5) * length, y - (course + 0.5) * width
    brick = (course % COURSES) * BRICKS + column % BRICKS
    corner = 0.0012
    dx = np.abs(along) - (length - GAP_M) / 2 + corner
    dy = np.abs(across) - (width - GAP_M) / 2 + corner
    outside = np.hypot(np.maximum(dx, 0), np.maximum(dy, 0)) + np.minimum(np.maximum(dx, dy), 0) - corner
    edge = -outside + 0.00012 * band_noise(rng, n, (12, 60), 1.0)
    return _Pattern(brick, along, across, edge, smooth_step(-0.0001, 0.00025, edge))


def _heights(pattern: _Pattern, n: int, rng: np.random.Generator) -> Array:
    count = COURSES * BRICKS
    top = pattern.per_brick(rng.uniform(-0.00105, -0.00055, count))
    top = top + pattern.per_brick(rng.uniform(-0.012, 0.012, count)) * pattern.along_m
    top = top + pattern.per_brick(rng.uniform(-0.03, 0.03, count)) * pattern.across_m
    top = top + 0.00007 * band_noise(rng, n, (3, 20), 1.0) + 0.000018 * band_noise(rng, n, (18, 80), 0.9)
    pits = smooth_step(1.3, 2.3, band_noise(rng, n, (12, 50), 0.5))
    chips = smooth_step(0.9, 1.9, band_noise(rng, n, (4, 18), 0.8)) * np.exp(-np.maximum(pattern.edge_m, 0) / 0.0012)
    top = top - 0.0003 * pits - 0.0007 * chips
    mortar = -0.0027 + 0.00016 * band_noise(rng, n, (3, 16), 0.8) + 0.00006 * band_noise(rng, n, (30, 120), 0.3)
    across_edge = np.clip(pattern.edge_m / 0.0011, 0, 1)
    rounded = np.sqrt(np.maximum(1 - (1 - across_edge) ** 2, 0))  # a quarter of an ellipse
    height = mortar + (top - mortar) * (0.35 * smooth_step(-0.0002, 0.0002, pattern.edge_m) + 0.65 * rounded)
    return np.clip(gaussian_filter(height, 1.0 * n / 512, mode="wrap"), -0.0039, -0.0003)


def _brick_colour(pattern: _Pattern, n: int, rng: np.random.Generator) -> Array:
    palette = np.array([
        [0.44, 0.155, 0.085], [0.38, 0.125, 0.075], [0.50, 0.205, 0.110], [0.33, 0.105, 0.070], [0.55, 0.260, 0.150],
        [0.27, 0.110, 0.085],
    ])  # fmt: skip
    count = COURSES * BRICKS
    base = palette[rng.integers(len(palette), size=count)] * rng.uniform(0.85, 1.15, (count, 1))
    colour = base[pattern.brick]
    cloud = band_noise(rng, n, (2, 30), 1.2)
    grain = band_noise(rng, n, (40, 200), 0.2)
    colour = colour * (1 + 0.13 * cloud + 0.10 * grain)[..., None]
    iron = smooth_step(1.5, 2.1, band_noise(rng, n, (25, 90), 0.3))
    colour = colour * (1 - 0.72 * iron)[..., None]
    lime = (
        0.55 * smooth_step(0.5, 2.0, band_noise(rng, n, (3, 40), 1.0)) * np.exp(-np.maximum(pattern.edge_m, 0) / 0.002)
    )
    burnt = 0.25 * np.exp(-np.maximum(pattern.edge_m, 0) / 0.0008)
    colour = colour * (1 - burnt)[..., None]
    mixed: Array = colour * (1 - lime)[..., None] + lime[..., None] * np.array([0.62, 0.56, 0.50])
    return mixed


def _mortar_colour(n: int, rng: np.random.Generator) -> Array:
    sand = 1 + 0.12 * band_noise(rng, n, (30, 220), 0.1) + 0.08 * band_noise(rng, n, (2, 12), 1.0)
    dark = smooth_step(1.6, 2.2, band_noise(rng, n, (40, 140), 0.2))
    colour: Array = (sand * (1 - 0.6 * dark))[..., None] * np.array([0.50, 0.45, 0.385])
    return colour
