"""Reflections of a lens's frame as sectors of a ring, by sides across which both pictures step in light or in colour.

A frame reflects along itself: between two radii and two azimuths. Two scenes have steps of their own everywhere, but
hardly ever both along all four sides of one sector. Which way each picture steps does not matter, so that a reflection
may be brighter than one scene and darker than the other.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from processing.environment.ring import RingGrid
from processing.products.arrays import Float64

_HEIGHTS = np.geomspace(0.03, 0.09, 9)  # of the image radius
_WIDTHS_RAD = np.geomspace(0.1, 0.6, 22)
_NEAREST = 0.75  # image radii: no reflection's middle is nearer to the centre
_ACROSS, _FINE = 3, 1  # cells on both sides of a side: where sectors are looked for, and where sides are then placed
_SLOW = 15.0  # cells: what changes more slowly is the scene's shading, or vignetting
_MOST = 1.5  # log light: a step beyond says no more
_NOISE = 0.03  # log light or colour: steps along a side that differ by less are even
_ALIKE = 4.0  # cells that tell one thing between them
_LONG, _SHORT = 30.0, 15.0  # log likelihood ratios of sides: beyond, a side cannot make up for others
_REST = 0.1  # share of a side's whole ratio that counts beside, so that of sectors that share sides the better one wins
_ENOUGH = 53.0  # for all four sides: to be fitted, not to be believed
_REACH = 6  # cells within which a side is placed
_APART = 6  # cells between two sectors
_COUNT = 16


@dataclass(frozen=True, slots=True)
class Sector:
    """Cells `top` to `top + height` of the radius and, wrapping, `left` to `left + width` of the azimuth."""

    top: int
    height: int
    left: int
    width: int

    def cells(self, shape: tuple[int, ...], grown: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Index of the cells (rows, columns) of a ring of this shape, with that many more on each side."""
        rows = np.arange(max(self.top - grown, 0), min(self.top + self.height + grown, shape[0]))
        columns = np.arange(self.left - grown, self.left + self.width + grown) % shape[1]
        return rows[:, None], columns[None]


def sectors_of_ring(features: Sequence[Float64], grid: RingGrid) -> list[tuple[Sector, float]]:
    """Sectors that two pictures may share, and their log likelihood ratios, the likeliest first.

    `features` (2): each picture's log light and colours (f, r, count) on a ring.
    """
    best, sizes = _likelihoods([_steps(picture, _ACROSS) for picture in features], grid)
    middle = np.arange(best.shape[0])[:, None] + sizes[..., 0] / 2
    best[grid.radii_px[0] + middle * grid.step_px < _NEAREST * grid.outer_px] = 0.0
    fine = [_steps(picture, _FINE) for picture in features]
    taken, found = np.zeros(best.shape, np.bool_), list[tuple[Sector, float]]()
    for place in np.argsort(best, axis=None)[::-1]:
        top, left = map(int, np.unravel_index(place, best.shape))
        if best[top, left] < _ENOUGH or len(found) == _COUNT:
            break
        height, width = map(int, sizes[top, left])
        sector = Sector(top, height, left, width)
        if not taken[sector.cells(best.shape, 0)].any():
            placed = _placed(sector, fine)
            found.append((placed, float(best[top, left])))
            taken[placed.cells(best.shape, _APART)] = True
    return found


def _steps(picture: Float64, across: int) -> tuple[Float64, Float64]:
    """Steps (f, r, count) of each feature outward and along the azimuth, less what the scene changes slowly."""
    outward, along = np.zeros_like(picture), np.zeros_like(picture)
    outward[:, across:-across] = picture[:, 2 * across :] - picture[:, : -2 * across]
    along[:] = np.roll(picture, -across, axis=2) - np.roll(picture, across, axis=2)
    for steps in (outward, along):
        np.clip(steps, -_MOST, _MOST, out=steps)
        steps -= gaussian_filter(steps, (0, _SLOW, _SLOW), mode=("nearest", "nearest", "wrap"))
    outward[:, :across] = outward[:, -across:] = 0.0
    return outward, along


def _likelihoods(steps: Sequence[tuple[Float64, Float64]], grid: RingGrid) -> tuple[Float64, NDArray[np.intp]]:
    """The best sector that begins at each cell: log likelihood ratio (r, count), height and width (r, count, 2)."""
    rows, columns = len(grid.radii_px), grid.count
    heights = np.unique(np.rint(_HEIGHTS * grid.outer_px / grid.step_px).astype(int))
    widths = np.unique(np.rint(_WIDTHS_RAD * columns / (2 * np.pi)).astype(int))
    best, sizes = np.zeros((rows, columns)), np.zeros((rows, columns, 2), np.intp)
    ends = {height: _side([along for _, along in steps], height, 1)[0] for height in heights}
    for width in widths:
        arcs, means = _side([outward for outward, _ in steps], width, 2)
        for height in heights:
            count = rows - height
            inner, outer = arcs[:count], arcs[height:]
            # What is brighter, or bluer, inside is so across both arcs.
            opposed = [(one[:, :count] * one[:, height:]).sum(axis=0) < 0 for one in means]
            short = np.minimum(ends[height], np.roll(ends[height], -width, axis=1))[:count]
            weaker = np.minimum(np.minimum(inner, outer), _LONG) + np.minimum(short, _SHORT)
            ratio = np.where(np.logical_and(*opposed), 2 * weaker + _REST * (inner + outer), 0.0)
            better = ratio > best[:count]
            best[:count][better] = ratio[better]
            sizes[:count][better] = height, width
    return best, sizes


def _side(steps: Sequence[Float64], length: int, axis: int) -> tuple[Float64, list[Float64]]:
    """Log likelihood ratio of an even step against none along sides from each cell: the less certain picture's.

    Beside it each picture's mean steps (f, ...). Sides along the radius (axis 1) end within the ring.
    """
    ratios, means = [], []
    for picture in steps:
        mean, square = (_running_mean(values, length, axis) for values in (picture, picture**2))
        variance = np.maximum(square - mean**2, 0) + _NOISE**2
        ratios.append((0.5 * length / _ALIKE * np.log1p(mean**2 / variance)).sum(axis=0))
        means.append(mean)
    return np.minimum(*ratios), means


def _running_mean(values: Float64, length: int, axis: int) -> Float64:
    """Means of that many cells from each on; wraps along the azimuth (axis 2)."""
    more = values[..., :length] if axis == 2 else values[:, :0]
    sums = np.cumsum(np.concatenate([np.zeros_like(values.take([0], axis)), values, more], axis=axis), axis=axis)
    count = values.shape[axis] + (0 if axis == 2 else 1 - length)
    later, earlier = (sums.take(range(start, start + count), axis) for start in (length, 0))
    return np.asarray((later - earlier) / length)


def _placed(sector: Sector, fine: Sequence[tuple[Float64, Float64]]) -> Sector:
    """Each side moved by some cells to where both pictures' steps are steepest."""
    rows, columns = fine[0][0].shape[1:]
    top, bottom, left, right = sector.top, sector.top + sector.height, sector.left, sector.left + sector.width
    for _ in range(2):
        across = np.arange(left, right + 1) % columns
        arcs = _strength([outward[:, :, across].mean(axis=2) for outward, _ in fine])
        top = _steepest(arcs, top, 1, bottom - 4)
        bottom = _steepest(arcs, bottom, top + 4, rows - 2)
        ends = _strength([along[:, top : bottom + 1].mean(axis=1) for _, along in fine])
        left = _steepest(ends, left, left - _REACH, right - 8)
        right = _steepest(ends, right, left + 8, right + _REACH)
    return Sector(top, bottom - top, left, right - left)


def _strength(means: Sequence[Float64]) -> Float64:
    """The smaller of both pictures' steps, over all features."""
    return np.asarray(np.minimum(*[np.linalg.norm(mean, axis=0) for mean in means]))


def _steepest(strength: Float64, place: int, low: int, high: int) -> int:
    near = range(max(place - _REACH, low), min(place + _REACH, high) + 1)
    return max(near, key=lambda at: float(strength[at % len(strength)]), default=place)
