"""Plain twins of the vote over lights and of the refinement of hidden points."""

import numpy as np


def count_votes(flows, meets, agree=0.7):
    """Mean of the largest group of vectors within `agree` of one of them (y, x, 2), and the share that did not meet."""
    _, height, width, _ = flows.shape
    shift, ratio = np.zeros((height, width, 2)), np.zeros((height, width))
    for y, x in np.ndindex(height, width):
        kept = flows[meets[:, y, x], y, x].astype(np.float64)
        ratio[y, x] = 1 - len(kept) / len(flows)
        if len(kept):
            near = np.linalg.norm(kept[:, None] - kept, axis=-1) <= agree
            shift[y, x] = kept[near[np.argmax(near.sum(axis=1))]].mean(axis=0)
    return shift, ratio


def apart(one, other):
    """Mean absolute difference over the last axis of what both know."""
    return np.nanmean(np.abs(one - other), axis=-1)


def moved(drawn, shift):
    """`drawn` (y, x, values) between its texels at x + shift (y, x, 2); the tile repeats."""
    height, width, _ = drawn.shape
    rows, columns = np.mgrid[:height, :width]
    right, down = columns + shift[..., 0], rows + shift[..., 1]
    column, row = np.floor(right).astype(int), np.floor(down).astype(int)
    fx, fy = (right - column)[..., None], (down - row)[..., None]

    def at(r, c):
        return drawn[r % height, c % width]

    upper = at(row, column) * (1 - fx) + at(row, column + 1) * fx
    lower = at(row + 1, column) * (1 - fx) + at(row + 1, column + 1) * fx
    return upper * (1 - fy) + lower * fy


def best_match(point, drawn):
    """Row, column and distance of the texel of `drawn` (y, x, values) that is least apart from a point (values,)."""
    distance = apart(drawn, point)
    row, column = np.unravel_index(np.argmin(distance), distance.shape)
    return row, column, distance[row, column]


def first_meeting(heights, view, step=0.001):
    """Height (y, x) at which each texel's ray down from a view meets the bilinear field, in small steps."""
    out = np.full(heights.shape, np.nan)
    for level in np.arange(heights.max(), heights.min() - step, -step):
        way = np.broadcast_to(level * np.array([view[0], -view[1]]) / view[2], (*heights.shape, 2))
        met = np.isnan(out) & (moved(heights[..., None].astype(float), way)[..., 0] >= level)
        out[met] = level
    return np.where(np.isnan(out), heights.min(), out)
