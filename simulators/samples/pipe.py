"""Straws: a closed layer side by side, and hollow pieces across it."""

import numpy as np

from simulators.layout import HolderLayout
from simulators.samples.bodies import capped_tubes, endless_tubes, plate, sweep
from simulators.samples.mesh import Mesh, join, tile
from simulators.samples.noise import Array, smooth_noise, smooth_step

LAID = 26  # straws along x
CROSSING, PIECES = 22, 14  # places for pieces along y, and how many of them are taken
AROUND, RINGS = 36, 120  # points around a straw, along one period or one piece
WALL_M, HOLLOW_M = 0.00016, 0.005  # of the pieces: thickness, and how deep one can see in
FLOOR = (0.04, 0.034, 0.028, 0.0, 1.0)
STRAW = ((0.66, 0.50, 0.24), (0.60, 0.46, 0.24), (0.70, 0.57, 0.31), (0.52, 0.42, 0.20))


def pipe_mesh(holder: HolderLayout, seed: int) -> Mesh:
    """The straws over a dark floor; their period is the side of what is measured."""
    rng = np.random.default_rng([seed, 15])
    period_m = holder.opening_m - 2 * holder.margin_m
    place_m = period_m / LAID / 2
    laid = _laid(period_m, place_m, -holder.depth_m, rng)
    pieces = _pieces(period_m, -holder.depth_m + 2 * place_m, rng)
    straws = tile(join(laid, pieces), period_m, holder.opening_m)
    return join(straws, plate(holder.opening_m, -holder.depth_m, FLOOR))


def _laid(period_m: float, place_m: float, floor_m: float, rng: np.random.Generator) -> Mesh:
    """Straws along x over one period, each a little thinner than its place, on the floor."""
    along = np.arange(RINGS) / RINGS
    radii = place_m * rng.uniform(0.9, 0.965, (LAID, 1)) + _knots(along[None], rng.uniform(size=(LAID, 3)))
    centres = np.empty((LAID, RINGS, 3))
    centres[..., 0] = (along - 0.5) * period_m
    centres[..., 1] = ((np.arange(LAID) + 0.5) / LAID - 0.5)[:, None] * period_m
    centres[..., 2] = floor_m + radii.max(axis=1, keepdims=True)
    rings = _rings(centres, radii, np.array([[1.0, 0.0, 0.0]]), rng)
    return endless_tubes(rings, _surface(radii, rng), np.array([period_m, 0.0, 0.0]))


def _pieces(period_m: float, floor_m: float, rng: np.random.Generator) -> Mesh:
    """Hollow pieces nearly along y; those that have room turn more."""
    taken = np.sort(rng.permutation(CROSSING)[:PIECES])
    pitch_m = period_m / CROSSING
    gaps = np.minimum(np.diff(taken, append=taken[0] + CROSSING), np.diff(taken, prepend=taken[-1] - CROSSING))
    length_m = rng.uniform(0.024, 0.042, (len(taken), 1))
    thick_m = rng.uniform(0.00075, 0.00083, (len(taken), 1))
    room_m = gaps[:, None] * pitch_m - 2 * 0.00092
    yaw = rng.uniform(-1, 1, (len(taken), 1)) * room_m / length_m
    axes = np.concatenate([-np.sin(yaw), np.cos(yaw), np.zeros_like(yaw)], axis=1)
    middles = np.empty((len(taken), 3))
    middles[:, 0] = ((taken + 0.5) / CROSSING - 0.5) * period_m
    middles[:, 1] = rng.uniform(-0.5, 0.5, len(taken)) * period_m
    away_m, radii = _hollow(length_m, thick_m, rng.uniform(size=(len(taken), 3)))
    middles[:, 2] = floor_m + radii.max(axis=1)
    centres = middles[:, None] + away_m[..., None] * axes[:, None]
    surface = _surface(radii, rng)
    surface[:, [0, -1], :, :3] *= 0.15  # the dark inside
    return capped_tubes(_rings(centres, radii, axes, rng), surface)


def _hollow(length_m: Array, thick_m: Array, knots: Array) -> tuple[Array, Array]:
    """Places along the axis and radii (pieces, rings): from inside over one lip, the outside, to the other inside."""
    share = np.linspace(0, 1, RINGS)[None]
    outside = thick_m + _knots(share, knots)
    inner, lip = thick_m - WALL_M, thick_m - WALL_M / 2
    edge = np.full_like(length_m, 0.00003)
    deep = np.full_like(length_m, HOLLOW_M)
    near = np.concatenate([deep, 2 * edge, 0 * edge], axis=1) - length_m / 2
    place = np.concatenate([near, edge + share * (length_m - 2 * edge) - length_m / 2, -near[:, ::-1]], axis=1)
    return place, np.concatenate([inner, inner, lip, outside, lip, inner, inner], axis=1)


def _knots(share: Array, places: Array) -> Array:
    """What the knots at these places (straws, knots) of the length add to the radius (straws, rings)."""
    away = (share[:, None] - places[..., None] + 0.5) % 1.0 - 0.5
    return np.asarray((0.00005 * np.exp(-((away / 0.008) ** 2))).sum(axis=1))


def _rings(centres: Array, radii: Array, axes: Array, rng: np.random.Generator) -> Array:
    """Rings about straight axes (straws or 1, 3), a little oval."""
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    oval = (
        0.03 * rng.uniform(0.2, 1, (len(radii), 1, 1)) * (1 + np.cos(2 * angle + rng.uniform(0, 6, (len(radii), 1, 1))))
    )
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    profile = (radii[..., None] * (1 - oval))[..., None] * circle
    along = np.broadcast_to(axes[:, None], centres.shape)
    return sweep(centres, along, np.broadcast_to([0.0, 0.0, 1.0], centres.shape), profile)


def _surface(radii: Array, rng: np.random.Generator) -> Array:
    """Albedo, specular and roughness (straws, rings, points, 5): streaks along the straw, knots darker."""
    count, rings = radii.shape
    base = np.array(STRAW)[rng.integers(len(STRAW), size=count)] * rng.uniform(0.85, 1.12, (count, 1))
    streaks = smooth_noise(rng, (count, rings, AROUND), (0, 25, 0.5))
    spots = smooth_step(1.6, 2.6, smooth_noise(rng, (count, rings, AROUND), (0, 1.5, 1.2)))
    knot = smooth_step(0.00001, 0.00004, radii - np.median(radii, axis=1, keepdims=True))[..., None]
    tone = (1 + 0.16 * streaks) * (1 - 0.4 * knot) * (1 - 0.5 * spots)
    surface = np.empty((*tone.shape, 5))
    surface[..., :3] = np.clip(base[:, None, None] * tone[..., None], 0.02, 0.85)
    surface[..., 3] = np.clip(0.045 + 0.01 * streaks - 0.02 * knot, 0.01, 0.09)
    surface[..., 4] = np.clip(0.36 + 0.07 * streaks + 0.3 * knot, 0.25, 0.9)
    return surface
