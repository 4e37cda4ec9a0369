"""A plain weave of thick three-ply yarns: warp along y, weft along x, over and under each other, gaps between."""

import numpy as np

from simulators.layout import HolderLayout
from simulators.samples.bodies import endless_tubes, plate, sweep, unit
from simulators.samples.mesh import Mesh, join, tile
from simulators.samples.noise import Array, smooth_noise

YARNS = 18  # of each direction, even: the pattern repeats after two
RINGS, AROUND = 240, 30  # points along a yarn and around it
HALF_WIDTH_M, HALF_THICKNESS_M = 0.00104, 0.00061
WAVE_M = 0.00072  # of a yarn's middle about the fabric's, enough for the yarns not to meet
MIDDLE_M = -0.0018
PLIES, TURNS = 3, 15  # strands of a yarn, turns of its twist over the period
FLOOR = (0.035, 0.032, 0.030, 0.0, 1.0)
WARP_COLOURS = ((0.68, 0.60, 0.46), (0.64, 0.55, 0.41), (0.70, 0.63, 0.50))
WEFT_COLOURS = ((0.46, 0.155, 0.095), (0.41, 0.13, 0.085), (0.50, 0.19, 0.11))


def weave_mesh(holder: HolderLayout, seed: int) -> Mesh:
    """The fabric over a dark floor; its period is the side of what is measured."""
    rng = np.random.default_rng([seed, 12])
    period_m = holder.opening_m - 2 * holder.margin_m
    weft = _yarns(period_m, np.array(WEFT_COLOURS), rng)
    warp = _yarns(period_m, np.array(WARP_COLOURS), rng)
    upright = Mesh(_turned(warp.vertices), warp.faces, _turned(warp.normals), warp.surface)
    fabric = tile(join(weft, upright), period_m, holder.opening_m)
    return join(fabric, plate(holder.opening_m, -holder.depth_m, FLOOR))


def _turned(vectors: Array) -> Array:
    """A quarter turn about z: what ran along x runs along y."""
    return np.stack([-vectors[:, 1], vectors[:, 0], vectors[:, 2]], axis=1)


def _yarns(period_m: float, colours: Array, rng: np.random.Generator) -> Mesh:
    """Yarns along x over one period, each over the crossings that its neighbours pass under.

    Turned by a quarter they pass under where these pass over, because their number is even.
    """
    pitch_m = period_m / YARNS
    along = np.arange(RINGS) / RINGS
    phase = along * YARNS * np.pi
    sign = (-1.0) ** np.arange(YARNS)[:, None]
    centres = np.empty((YARNS, RINGS, 3))
    centres[..., 0] = (along - 0.5) * period_m
    centres[..., 1] = ((np.arange(YARNS) + 0.5) * pitch_m - period_m / 2)[:, None]
    centres[..., 1] += 0.00007 * smooth_noise(rng, (YARNS, RINGS), (0, 14))
    centres[..., 2] = MIDDLE_M + sign * WAVE_M * np.sin(phase)
    period = np.array([period_m, 0.0, 0.0])
    before, after = np.roll(centres, 1, axis=1), np.roll(centres, -1, axis=1)
    before[:, 0] -= period
    after[:, -1] += period
    tangents = unit(after - before)
    across = np.broadcast_to([0.0, 1.0, 0.0], centres.shape)
    strand = np.abs(np.sin(np.pi * PLIES * np.arange(AROUND) / AROUND))  # 0 where plies meet
    rings = sweep(centres, tangents, across, _profile(along, strand, rng))
    return endless_tubes(rings, _surface(strand, colours, rng), period)


def _profile(along: Array, strand: Array, rng: np.random.Generator) -> Array:
    """Sections (yarns, rings, points, 2), whose points turn with the twist: each keeps its place in its ply."""
    uneven = 0.02 * smooth_noise(rng, (YARNS, RINGS, 1), (0, 9, 0))
    turn = 2 * np.pi * (np.arange(AROUND) / AROUND + TURNS * along[:, None] + rng.uniform(size=(YARNS, 1, 1)) + uneven)
    thick = 1 + 0.035 * smooth_noise(rng, (YARNS, RINGS, 1), (0, 10, 0))
    radius = thick * (0.74 + 0.26 * strand**0.6)
    shape = np.stack([HALF_WIDTH_M * np.cos(turn), HALF_THICKNESS_M * np.sin(turn)], axis=-1)
    return np.asarray(radius[..., None] * shape)


def _surface(strand: Array, colours: Array, rng: np.random.Generator) -> Array:
    """Albedo, specular and roughness (yarns, rings, points, 5): fibres along the plies, darker where plies meet."""
    base = colours[rng.integers(len(colours), size=YARNS)] * rng.uniform(0.93, 1.07, (YARNS, 1))
    grain = smooth_noise(rng, (YARNS, RINGS, AROUND), (0, 3, 0.3))
    stain = smooth_noise(rng, (YARNS, RINGS, AROUND), (0, 12, 4))
    tone = (0.5 + 0.5 * strand**0.6) * (1 + 0.19 * grain + 0.05 * stain)
    surface = np.empty((*tone.shape, 5))
    surface[..., :3] = np.clip(base[:, None, None] * tone[..., None], 0.02, 0.85)
    surface[..., 3] = np.clip(0.035 + 0.012 * grain, 0.01, 0.08)
    surface[..., 4] = np.clip(0.58 + 0.06 * grain, 0.35, 0.9)
    return surface
