"""Blades of grass, bent in all directions, that grow out of soil."""

import numpy as np

from simulators.layout import HolderLayout
from simulators.samples.bodies import capped_tubes, sweep
from simulators.samples.mesh import Mesh, join, tile
from simulators.samples.noise import Array, smooth_noise, smooth_step
from simulators.samples.soil import soil

BLADES = 1800
RINGS = 15  # points along a blade
SECTION = np.array([(1, 0), (0.9, 0.44), (0, 1), (-0.9, 0.44), (-1, 0), (-0.9, -0.44), (0, -1), (0.9, -0.44)]).T
HIGHEST_M = -0.0003  # of the tallest blade
GREENS = ((0.16, 0.26, 0.07), (0.20, 0.31, 0.08), (0.25, 0.33, 0.10), (0.13, 0.22, 0.08))
DRY = (0.46, 0.37, 0.19)


def grass_mesh(holder: HolderLayout, seed: int) -> Mesh:
    """The meadow; its period is the side of what is measured."""
    rng = np.random.default_rng([seed, 14])
    period_m = holder.opening_m - 2 * holder.margin_m
    ground = soil(period_m, -holder.depth_m, rng)
    return tile(join(ground, _blades(period_m, holder.depth_m, rng)), period_m, holder.opening_m)


def _blades(period_m: float, depth_m: float, rng: np.random.Generator) -> Mesh:
    share = np.linspace(0, 1, RINGS)  # of the way from the root to the tip
    lean, turn = _bends(share, rng)
    step = np.stack([np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), np.cos(lean)], axis=-1)
    path = np.cumsum(0.5 * (step[:, :-1] + step[:, 1:]), axis=1) / (RINGS - 1)
    path = np.concatenate([np.zeros((BLADES, 1, 3)), path], axis=1)
    tallest_m = depth_m + HIGHEST_M - 0.0002  # the root is in the soil, a blade's edge above its middle
    height_m = tallest_m * rng.uniform(0.55, 1.0, BLADES) ** 0.5
    length_m = np.minimum(height_m / path[..., 2].max(axis=1), rng.uniform(0.0045, 0.0085, BLADES))
    roots = np.empty((BLADES, 3))
    roots[:, :2] = (_scattered(rng) - 0.5) * period_m
    roots[:, 2] = -depth_m + 0.0001
    centres = roots[:, None] + length_m[:, None, None] * path
    sideways = np.stack([-np.sin(turn), np.cos(turn), np.zeros_like(turn)], axis=-1)
    return capped_tubes(sweep(centres, step, sideways, _sections(share, rng)), _surface(share, rng))


def _scattered(rng: np.random.Generator) -> Array:
    """Places (BLADES, 2) in the unit square, more even than chance: one in each cell of a grid."""
    side = int(np.ceil(np.sqrt(BLADES)))
    cells = rng.permutation(side * side)[:BLADES]
    return (np.stack([cells % side, cells // side], axis=1) + rng.uniform(size=(BLADES, 2))) / side


def _bends(share: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Angle from upright and azimuth of the blades' way (blades, rings)."""
    start, end = np.radians(rng.uniform(4, 40, (BLADES, 1))), np.radians(rng.uniform(55, 125, (BLADES, 1)))
    lean = start + (end - start) * share ** rng.uniform(0.9, 1.9, (BLADES, 1))
    turn = rng.uniform(-np.pi, np.pi, (BLADES, 1)) + rng.normal(0, 0.5, (BLADES, 1)) * share
    return lean, turn


def _sections(share: Array, rng: np.random.Generator) -> Array:
    """Flat lenses folded along the midrib (blades, rings, points, 2), pointed at the tip."""
    half_m = rng.uniform(0.00026, 0.00048, (BLADES, 1)) * (0.55 + 0.45 * smooth_step(0, 0.35, share))
    half_m = np.maximum(half_m * (1 - share**2.5) ** 0.8, 4e-6)
    thick_m = np.minimum(0.00005 * (1.6 - share), half_m)
    fold = rng.uniform(0.15, 0.5, (BLADES, 1, 1))
    across = half_m[..., None] * SECTION[0]
    up = thick_m[..., None] * SECTION[1] + fold * (np.abs(across) - 0.5 * half_m[..., None])
    return np.stack([across, up], axis=-1)


def _surface(share: Array, rng: np.random.Generator) -> Array:
    """Albedo, specular and roughness (blades, rings, points, 5): pale at the root, some dry at the tip or all over."""
    green = np.array(GREENS)[rng.integers(len(GREENS), size=BLADES)] * rng.uniform(0.8, 1.2, (BLADES, 1))
    dry = np.where(
        rng.uniform(size=(BLADES, 1)) < 0.12, 1.0, smooth_step(0.75, 1.3, share + rng.normal(0, 0.12, (BLADES, 1)))
    )
    pale = 0.6 * (1 - smooth_step(0.0, 0.3, share)) * np.ones((BLADES, 1))
    colour = green[:, None] + dry[..., None] * (np.array(DRY) - green[:, None])
    colour = colour + pale[..., None] * (np.array([0.40, 0.38, 0.20]) - colour)
    veins = smooth_noise(rng, (BLADES, RINGS, SECTION.shape[1]), (0, 3, 0.4))
    rib = 1 + 0.25 * (SECTION[0] == 0)
    tone = rib * (1 + 0.12 * veins)
    surface = np.empty((*tone.shape, 5))
    surface[..., :3] = np.clip(colour[:, :, None] * tone[..., None], 0.02, 0.85)
    surface[..., 3] = np.clip(0.04 + 0.01 * veins - 0.015 * dry[..., None], 0.01, 0.08)
    surface[..., 4] = np.clip(0.45 + 0.25 * dry[..., None] + 0.05 * veins, 0.3, 0.9)
    return surface
