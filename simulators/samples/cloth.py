"""Coarse plain-woven cloth drawn over a ball: six pieces sewn together like the sides of a cube."""

import numpy as np

from simulators.layout import rotation
from simulators.samples.noise import smooth_step
from simulators.samples.space_noise import fractal, tilted_normals
from simulators.scene import Array, Floats, Material

THREADS = 34  # over a quarter turn: 2.3 mm each on a ball of 50 mm radius
THICK, WAVE, PLY = 0.22, 0.20, 0.03  # of threads: roundness, how far they go up and down, and the groove of their twist
WARP, WEFT = (0.10, 0.12, 0.24), (0.42, 0.17, 0.10)  # albedo
SHEEN = 0.22


def cloth(unit: Array, seed: int) -> tuple[Floats, Material]:
    """Threads over and under each other, each of two plies, with a sheen of fibres; a seed turns the ball."""
    place = unit @ _turn(seed)
    side = np.argmax(np.abs(place), axis=1)
    normals = tilted_normals(place, lambda near: _relief(near, side)[0], np.ones(len(unit)))
    height, warp_is_up = _relief(place, side)
    pitch = np.pi / 2 / THREADS
    deep = 0.45 + 0.55 * smooth_step(-0.35 * pitch, 0.25 * pitch, height)
    dye = 1 + 0.25 * fractal(place * 9.0, seed + 30, 3)
    colour = np.where(warp_is_up[:, None], WARP, WEFT) * (deep * dye)[:, None]
    count = len(unit)
    material = Material(
        np.clip(colour, 0.01, 0.85).astype(np.float32),
        np.full(count, 0.02, np.float32),
        np.full(count, 0.75, np.float32),
        sheen=(SHEEN * deep).astype(np.float32),
    )
    return np.asarray(normals @ _turn(seed).T, np.float32), material


def _turn(seed: int) -> Array:
    """A rotation (3, 3) drawn from the seed, so small that cameras on the axes look at the middle of a piece."""
    return rotation(np.random.default_rng([seed, 16]).uniform(-0.3, 0.3, 3))


def _relief(place: Array, side: Array) -> tuple[Array, np.ndarray]:
    """Height (n,), in radii, of what is on top at places near the unit sphere, and whether that is a warp thread.

    On each side of the cube threads follow great circles, evenly by angle.
    """
    rows = np.arange(len(place))
    outward = np.abs(place[rows, side])
    along, across = (np.arctan(place[rows, (side + k) % 3] / outward) / (np.pi / 2) * THREADS for k in (1, 2))
    warp, weft = _thread(along, across, 0.0), _thread(across, along, 1.0)
    return np.maximum(warp, weft) * np.pi / 2 / THREADS, warp > weft


def _thread(beside: Array, along: Array, phase: float) -> Array:
    """Height (n,), in threads, of threads numbered by the whole part of `beside` that go up and down along `along`."""
    number = np.floor(beside)
    off_centre = beside - number - 0.5
    up = np.cos(np.pi * (along - 0.5 + number + phase))
    twist = np.cos(2 * np.pi * (1.5 * along + off_centre)) * np.cos(np.pi * off_centre)
    height: Array = THICK * np.cos(np.pi * off_centre) + WAVE * up + PLY * twist
    return height
