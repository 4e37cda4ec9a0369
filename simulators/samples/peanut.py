"""Peanuts in their shells: bumpy bodies of two lobes that lie close together on dark ground."""

import numpy as np

from simulators.layout import HolderLayout
from simulators.samples.bodies import capped_tubes, sweep, unit
from simulators.samples.mesh import Mesh, join, tile
from simulators.samples.noise import Array, smooth_noise, smooth_step
from simulators.samples.soil import soil

COUNT = 94
RINGS, AROUND = 54, 45  # points along a shell and around it
RIBS, CELLS = 9, 13  # ribs around a shell, pits along it between two of them
SIZES_M = (0.00155, 0.00177)  # radius of a shell's thicker lobe
SHELLS = ((0.62, 0.46, 0.28), (0.56, 0.40, 0.23), (0.66, 0.51, 0.33), (0.50, 0.35, 0.20))


def peanut_mesh(holder: HolderLayout, seed: int) -> Mesh:
    """The peanuts and the ground; their period is the side of what is measured."""
    rng = np.random.default_rng([seed, 13])
    period_m = holder.opening_m - 2 * holder.margin_m
    radius_m = rng.uniform(*SIZES_M, COUNT)
    half_m = radius_m * rng.uniform(2.3, 2.8, COUNT)
    places, turns = _settle(period_m, radius_m, half_m, rng)
    middles = np.column_stack([places, -holder.depth_m + 1.06 * radius_m])
    shells = _shells(middles, turns, np.column_stack([radius_m, half_m]), rng)
    ground = soil(period_m, -holder.depth_m, rng)
    return tile(join(ground, shells), period_m, holder.opening_m)


def _settle(period_m: float, radius_m: Array, half_m: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Places (n, 2) and azimuths (n,) of bodies that push each other away while they grow; each is three discs."""
    side = int(np.ceil(np.sqrt(COUNT)))
    cells = rng.permutation(side * side)[:COUNT]
    places = (np.column_stack([cells % side, cells // side]) + rng.uniform(0.2, 0.8, (COUNT, 2))) / side * period_m
    turns = rng.uniform(-np.pi, np.pi, COUNT)
    offsets = np.stack([-(half_m - radius_m), 0 * half_m, half_m - radius_m], axis=1)  # of the discs' middles
    size = np.stack([radius_m, 0.85 * radius_m, radius_m], axis=1).ravel() * 1.03
    body = np.repeat(np.arange(COUNT), 3)
    other = body[:, None] != body
    for growth in np.minimum(np.linspace(0.3, 1.6, 260), 1.0):
        way = growth * np.column_stack([np.cos(turns), np.sin(turns)])
        discs = (places[:, None] + offsets[..., None] * way[:, None]).reshape(-1, 2)
        apart = discs[:, None] - discs
        apart -= period_m * np.round(apart / period_m)
        distance = np.maximum(np.linalg.norm(apart, axis=-1), 1e-9)
        overlap = np.where(other, np.maximum(growth * (size[:, None] + size) - distance, 0.0), 0.0)
        push = (apart * (overlap / distance)[..., None]).sum(axis=1).reshape(COUNT, 3, 2)
        places = places + 0.25 * push.sum(axis=1)
        torque = ((way[:, :1] * push[..., 1] - way[:, 1:] * push[..., 0]) * offsets).sum(axis=1)
        turns = turns + 0.25 * torque / (offsets**2).sum(axis=1)
    return (places / period_m) % 1.0 * period_m - period_m / 2, turns


def _shells(middles: Array, turns: Array, sizes: Array, rng: np.random.Generator) -> Mesh:
    """The shells, each a little curved and turned about its own axis; `sizes` (n, 2) are radius and half length."""
    radius_m, half_m = sizes.T[..., None]
    share = -np.cos(np.pi * (np.arange(RINGS) + 0.35) / (RINGS - 0.3))  # from -1 to 1, dense at the ends
    axis = np.column_stack([np.cos(turns), np.sin(turns), np.zeros(COUNT)])[:, None]
    aside = np.column_stack([-np.sin(turns), np.cos(turns), np.zeros(COUNT)])[:, None]
    bend = rng.uniform(-0.16, 0.16, (COUNT, 1)) * radius_m
    centres = middles[:, None] + (half_m * share)[..., None] * axis + (bend * (2 * share**2 - 1))[..., None] * aside
    tangents = unit(half_m[..., None] * axis + (4 * bend * share)[..., None] * aside)
    waist = rng.uniform(0.14, 0.30, (COUNT, 1)) * np.exp(-(((share - rng.uniform(-0.1, 0.1, (COUNT, 1))) / 0.3) ** 2))
    taper = 1 - rng.uniform(0, 0.14, (COUNT, 1)) * (1 + rng.choice([-1, 1], (COUNT, 1)) * share) / 2
    outline = radius_m * (1 - waist) * taper * (1 - np.abs(share) ** 2.7) ** 0.5
    veins = _veins(share, rng)
    relief = (
        1 - 0.085 * (1 - veins) * (1 - np.abs(share) ** 8)[:, None] + 0.016 * smooth_noise(rng, veins.shape, (0, 5, 5))
    )
    angle = 2 * np.pi * np.arange(AROUND) / AROUND + rng.uniform(0, 2 * np.pi, (COUNT, 1, 1))
    profile = (outline[..., None] * relief)[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    up = np.broadcast_to([0.0, 0.0, 1.0], centres.shape)
    return capped_tubes(sweep(centres, tangents, up, profile), _surface(veins, rng))


def _veins(share: Array, rng: np.random.Generator) -> Array:
    """The net of ribs along the shell and veins across (n, rings, points): 1 on it, 0 in the pits."""
    around = np.arange(AROUND) / AROUND
    wander = 0.16 * smooth_noise(rng, (COUNT, RINGS, AROUND), (0, 4, 2.5))
    place = RIBS * around + wander
    along = 0.5 * CELLS * share[:, None] + 0.5 * np.floor(place) + 1.2 * wander
    rib, vein = (np.abs(np.cos(np.pi * value)) for value in (place, along))
    return np.maximum(rib**1.5, 0.85 * vein**2)


def _surface(veins: Array, rng: np.random.Generator) -> Array:
    """Albedo, specular and roughness (n, rings, points, 5): pits darker, blotches of earth."""
    base = np.array(SHELLS)[rng.integers(len(SHELLS), size=COUNT)] * rng.uniform(0.85, 1.12, (COUNT, 1))
    blotch = smooth_step(0.6, 2.2, smooth_noise(rng, veins.shape, (0, 5, 4)))
    grain = smooth_noise(rng, veins.shape, (0, 0.6, 0.6))
    tone = (0.62 + 0.38 * veins) * (1 + 0.09 * grain) * (1 - 0.35 * blotch)
    surface = np.empty((*tone.shape, 5))
    surface[..., :3] = np.clip(base[:, None, None] * tone[..., None], 0.02, 0.85)
    surface[..., 3] = np.clip(0.022 + 0.006 * grain - 0.01 * blotch, 0.005, 0.05)
    surface[..., 4] = np.clip(0.72 + 0.05 * grain, 0.5, 0.95)
    return surface
