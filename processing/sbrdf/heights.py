"""The height field of a tile, voted by all views and lights, and what each view sees of it.

A point at height h over the plane of the texels is seen by the view V from texel x' - h t(V), if x' is its texel from
the top: the same h for all views, whatever the light. So one number per texel is asked instead of a vector per view.
Heights and shifts are in texels.
"""

from typing import Protocol

import numba
import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32, Float64
from processing.sbrdf.samples import Samples

Mask = NDArray[np.bool_]

LOWEST = 0.15  # cosine of the lowest views that are asked: 81 deg
LIGHTS = 27  # that are compared, where there are more: the field hardly changes with the rest
_STEPS = 40  # between the lowest height and the highest
_REACH = 0.08  # heights that are tried, over the tile's shorter side
_LEAST_REACH = 2.0
INDISTINCT = 1e-4  # distances of values of which white is 1 that tell nothing
_MISFIT = 1.5  # mean distances of a view's best heights above which it only says that it does not see the point
_FLAT = 1e-3  # of such mean distances: less between the best and the worst height is no preference
_BESIDE, _JUMP = 0.02, 0.1  # cost of a height that differs from its neighbour's by one step, by more
_MARCH = 0.125  # texels from one place of a view's ray to the next


class Reconstruction(Protocol):
    """Values that lobes and shadows of the points seen from the top give, in the domain of `Samples`."""

    def seen_from(self, view: int) -> Float32:
        """Every texel of the top view as this view would see it, (light, y, x, 3)."""


def vote_heights(samples: Samples, reconstruction: Reconstruction) -> Float32:
    """Height (y, x) float32 of what the top view sees, over the plane of the texels.

    Every view's distance between what it sees at x' - h t and what the reconstruction expects of x', over its own
    median of the best ones and cut at 1.5 (a view that does not see the point has no say), is added up; neighbours pay
    for steps between them (semi-global matching, Hirschmueller 2008, four ways around the tile); the minimum is that of
    a parabola. Heights are tried up to 0.08 of the tile's side; 0 where no view tells.
    """
    height, width = samples.shape[2:4]
    reach = max(_REACH * min(height, width), _LEAST_REACH)
    levels = np.linspace(-reach, reach, _STEPS + 1)
    total = np.zeros((height, width, len(levels)), np.float32)
    for view in asked_views(samples):
        seen, drawn = (points(some.seen_from(view), LIGHTS) for some in (samples, reconstruction))
        cost = _mismatch(seen, drawn, -levels[:, None] * slope(samples.view_directions[view]))
        total += _capped(cost)
    smooth = _smoothed(total / np.float32(max(len(asked_views(samples)), 1)))
    return np.where(np.ptp(smooth, axis=-1) < _FLAT, np.float32(0), _minimum(smooth, levels))


def asked_views(samples: Samples) -> list[int]:
    """Views that look down on the sample from beside its top view."""
    cosine = samples.view_directions[:, 2]
    return [view for view in range(len(cosine)) if view != samples.top and cosine[view] > LOWEST]


def slope(view: Float64) -> Float64:
    """Texels right and down (2,) by which a view sees a point of height 1 displaced: its shift to the top view."""
    displaced: Float64 = np.array([view[0], -view[1]]) / view[2]
    return displaced


def points(values: Float32, most: int | None = None) -> Float32:
    """(light, y, x, channel) as (y, x, light * channel), contiguous; of `most` lights spread over them."""
    step = 1 if most is None else max(-(-len(values) // most), 1)
    chosen = np.moveaxis(values[::step], 0, 2)
    return np.ascontiguousarray(chosen).reshape(*chosen.shape[:2], -1)


def visible(heights: Float32, view: Float64) -> Float32:
    """Height (y, x) of the first place at which each texel's ray down from a view meets the field between its texels.

    The field repeats and is bilinear. `view` is a unit vector with z > 0.
    """
    field, way = np.asarray(heights, np.float64), slope(view)
    step = _MARCH / max(float(np.abs(way).max()), 1.0)
    return _first_meeting(field, way, float(field.max()), step)


def _capped(cost: Float32) -> Float32:
    """Distances over the median of the best, cut; those that compare nothing say as much as those that do not match."""
    best = np.min(np.where(np.isfinite(cost), cost, np.inf), axis=-1)
    usual = np.median(best[np.isfinite(best)]) if np.isfinite(best).any() else 0.0
    relative = cost / max(float(usual), INDISTINCT)
    return np.minimum(np.where(np.isfinite(cost), relative, np.inf), _MISFIT).astype(np.float32)


def _smoothed(cost: Float32) -> Float32:
    total = np.zeros_like(cost)
    for turned in (cost, np.ascontiguousarray(cost.transpose(1, 0, 2))):
        both = np.zeros_like(turned)
        _along_rows(turned, both, False)
        _along_rows(turned, both, True)
        total += both if turned is cost else both.transpose(1, 0, 2)
    return total


def _minimum(cost: Float32, levels: Float64) -> Float32:
    """Where the parabola through the least cost and its neighbours is least, within half a step."""
    best = np.argmin(cost, axis=-1)
    middle = np.clip(best, 1, len(levels) - 2)
    before, here, after = (
        np.take_along_axis(cost, (middle + by)[..., None], -1)[..., 0].astype(np.float64) for by in (-1, 0, 1)
    )
    bend = before + after - 2 * here
    by = np.where(bend > 0, 0.5 * (before - after) / np.where(bend > 0, bend, 1.0), 0.0)
    inside = np.where(middle == best, np.clip(by, -0.5, 0.5), 0.0)
    return np.asarray(levels[best] + inside * (levels[1] - levels[0]), np.float32)


@numba.njit(cache=True, inline="always")
def _taps(right: float, down: float, height: int, width: int) -> tuple[int, int, int, int, float, float]:
    """Row, next row, column, next column of a tile that repeats, and how far a place is between them."""
    column, row = np.floor(right), np.floor(down)
    fx, fy = right - column, down - row
    row, column = int(row) % height, int(column) % width
    return row, (row + 1) % height, column, (column + 1) % width, fx, fy


@numba.njit(cache=True, fastmath={"reassoc", "contract"})
def _apart(point, corners, weights):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Mean absolute difference of a point to the weighted mean of four others, over what all know; NaN of nothing."""
    a, b, c, d = corners
    wa, wb, wc, wd = weights
    total, known = np.float32(0), np.float32(0)
    for k in range(len(point)):
        apart = abs(point[k] - (wa * a[k] + wb * b[k] + wc * c[k] + wd * d[k]))
        there = apart < np.float32(np.inf)
        total += apart if there else np.float32(0)
        known += np.float32(1) if there else np.float32(0)
    return total / known if known > 0 else np.float32(np.nan)


@numba.njit(cache=True)
def between(point, field, right, down):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Mean absolute difference of a point (values,) to `field` (y, x, values) at a place between its texels."""
    row, below, column, beside, fx, fy = _taps(right, down, field.shape[0], field.shape[1])
    corners = field[row, column], field[row, beside], field[below, column], field[below, beside]
    ax, ay, bx, by = np.float32(1 - fx), np.float32(1 - fy), np.float32(fx), np.float32(fy)
    return _apart(point, corners, (ax * ay, bx * ay, ax * by, bx * by))


@numba.njit(cache=True, parallel=True)
def _mismatch(seen: Float32, drawn: Float32, moves: Float64) -> Float32:
    """Distance (y, x, move) of `drawn` to `seen`, both (y, x, values), at x + move (right, down)."""
    height, width, _ = drawn.shape
    out = np.empty((height, width, len(moves)), np.float32)
    for y in numba.prange(height):
        for x in range(width):
            for k in range(len(moves)):
                out[y, x, k] = between(drawn[y, x], seen, x + moves[k, 0], y + moves[k, 1])
    return out


@numba.njit(cache=True)
def _along_rows(cost: Float32, total: Float32, backward: bool) -> None:
    """Add to `total` the least cost (y, x, level) of paths along rows, twice around: the first round is the start."""
    height, width, levels = cost.shape
    before, here = np.zeros(levels, np.float32), np.zeros(levels, np.float32)
    for y in range(height):
        before[:] = 0
        for step in range(2 * width):
            x = (-1 - step if backward else step) % width
            least = before.min()
            for k in range(levels):
                path = min(before[k], least + np.float32(_JUMP))
                if k > 0:
                    path = min(path, before[k - 1] + np.float32(_BESIDE))
                if k < levels - 1:
                    path = min(path, before[k + 1] + np.float32(_BESIDE))
                here[k] = cost[y, x, k] + path - least
            before, here = here, before
            if step >= width:
                total[y, x] += before


@numba.njit(cache=True, parallel=True)
def _first_meeting(field: Float64, way: Float64, highest: float, step: float) -> Float32:
    height, width = field.shape
    lowest = field.min()
    out = np.empty((height, width), np.float32)
    for y in numba.prange(height):
        for x in range(width):
            level, above, under = highest, 0.0, -1.0
            while under < 0 and level >= lowest - step:
                row, below, column, beside, fx, fy = _taps(x + level * way[0], y + level * way[1], height, width)
                upper = field[row, column] * (1 - fx) + field[row, beside] * fx
                lower = field[below, column] * (1 - fx) + field[below, beside] * fx
                under = upper * (1 - fy) + lower * fy - level
                if under < 0:
                    above = -under
                    level -= step
            out[y, x] = level + step * under / (under + above) if under + above > 0 else level
    return out
