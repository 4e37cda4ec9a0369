"""Heights of a grid whose neighbours are joined by springs of any strength: a solver of its equations.

Conjugate gradients, preconditioned by a cycle over grids that halve: 2 x 2 pixels move as one, and the springs between
two blocks add up, so that every coarser grid is springs again. Source: Braess 1995, whose factor makes up for blocks
that are stiffer than what they stand for.
"""

from math import sqrt

import numpy as np
from numba import njit

from processing.products.arrays import Float64

OVERCORRECTION = 1.8
ITERATIONS = 200

Springs = tuple[Float64, Float64]  # to the right (y, x - 1) and down (y - 1, x)


def solve(springs: Springs, load: Float64, start: Float64, precision: float) -> Float64:
    """Heights (y, x) at which the springs bear the `load`, to a `precision` relative to it; free where none hold.

    The load of each connected piece must add up to 0; its mean height then stays that of the start.
    """
    levels = _levels(springs)
    height = start.copy()
    residual = load - apply(springs[0], springs[1], height)
    goal = precision * _length(load)
    direction, last = np.zeros_like(height), 1.0
    for _ in range(ITERATIONS):
        smooth = _cycle(levels, residual, 0)
        product = float((residual * smooth).sum())
        if _length(residual) <= goal or not product > 0:
            break
        direction = smooth + (product / last) * direction
        last = product
        image = apply(springs[0], springs[1], direction)
        length = product / float((direction * image).sum())
        height += length * direction
        residual -= length * image
    return height


def _length(load: Float64) -> float:
    return sqrt(float((load * load).sum()))


def _levels(springs: Springs) -> list[Springs]:
    levels = [springs]
    while levels[-1][0].shape[0] > 2 or levels[-1][1].shape[1] > 2:
        levels.append(_halved(*levels[-1]))
    return levels


def _halved(right: Float64, down: Float64) -> Springs:
    """The springs between blocks of 2 x 2."""
    across, along = right[:, 1::2], down[1::2]
    return _paired(across), np.ascontiguousarray(_paired(along.T).T)


def _paired(rows: Float64) -> Float64:
    """Sums of two rows each; the last alone where their number is odd."""
    return np.asarray(np.add.reduceat(rows, np.arange(0, len(rows), 2), axis=0), np.float64)


def _cycle(levels: list[Springs], residual: Float64, level: int) -> Float64:
    """Roughly the heights that this residual asks for: smoothed before and after what the coarser grids say."""
    right, down = levels[level]
    height = np.zeros_like(residual)
    sweep(right, down, residual, height, 1)
    if level + 1 < len(levels):
        left = residual - apply(right, down, height)
        coarse = _cycle(levels, np.ascontiguousarray(_paired(_paired(left).T).T), level + 1)
        blocks = np.repeat(np.repeat(coarse, 2, axis=0), 2, axis=1)
        height += OVERCORRECTION * blocks[: height.shape[0], : height.shape[1]]
    sweep(right, down, residual, height, -1)
    return height


@njit(cache=True)
def apply(right: Float64, down: Float64, height: Float64) -> Float64:
    """The load (y, x) under which the springs stand at these heights."""
    rows, columns = height.shape
    load = np.zeros((rows, columns))
    for y in range(rows):
        for x in range(columns):
            if x + 1 < columns:
                force = right[y, x] * (height[y, x + 1] - height[y, x])
                load[y, x] -= force
                load[y, x + 1] += force
            if y + 1 < rows:
                force = down[y, x] * (height[y + 1, x] - height[y, x])
                load[y, x] -= force
                load[y + 1, x] += force
    return load


@njit(cache=True)
def sweep(right: Float64, down: Float64, load: Float64, height: Float64, order: int) -> None:
    """One pass of Gauss and Seidel over the heights, in place, from the first pixel (order 1) or the last (-1)."""
    rows, columns = height.shape
    for i in range(rows):
        y = i if order > 0 else rows - 1 - i
        for j in range(columns):
            x = j if order > 0 else columns - 1 - j
            strength, pull = 0.0, load[y, x]
            if x > 0:
                strength += right[y, x - 1]
                pull += right[y, x - 1] * height[y, x - 1]
            if x + 1 < columns:
                strength += right[y, x]
                pull += right[y, x] * height[y, x + 1]
            if y > 0:
                strength += down[y - 1, x]
                pull += down[y - 1, x] * height[y - 1, x]
            if y + 1 < rows:
                strength += down[y, x]
                pull += down[y, x] * height[y + 1, x]
            if strength > 0:
                height[y, x] = pull / strength
