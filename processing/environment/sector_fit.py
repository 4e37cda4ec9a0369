"""Outlines of a frame's reflections to a fraction of a pixel: soft sectors of a ring fitted to both pictures' light.

A reflection hides a share of the scene and adds its own light, the same share in both pictures. In light, not in its
logarithm, a picture is then linear in the share: S (1 - share) + own share. Near a patch the scene S is taken for a
quadratic polynomial and the own light for even, each picture's and channel's being its own; what is left over tells
how well a sector of soft edges explains both pictures.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, find_objects, gaussian_filter, label
from scipy.optimize import least_squares

from processing.environment.frame_sectors import Sector
from processing.environment.ring import RingGrid
from processing.products.arrays import Float64

Mask = NDArray[np.bool_]
_MARGIN = 10  # cells beside a sector from which the scene is told
_REACH = 5.0  # cells by which a side may move
_SOFT = 0.3, 1.0, 2.5  # cells of the logistic edge: least, first, most
_LOCAL = 4.0  # cells: light counts relative to that around it
_HIDDEN = 0.15  # of its middle's share: where a reflection's outline is drawn, a tenth where it hides two thirds
_FLOOR = 1e-3  # of the mean light
_ROBUST = 1.5  # root mean squares of what is left over at first
_TOLERANCE, _STEPS = 1e-3, 20
_GAIN, _MOST = 20.0, 1.0  # log likelihood ratio that a fit adds to that of a sector's sides, per its gain; at most
_BELIEVED = 73.0  # log likelihood ratio of sides and fit together
_APART = 4  # cells between two sectors: what lies beside one has a side of it
_SHARED = 0.5  # of an outline: what a sector covers by more is known
_AGREE, _CLEAR = 0.6, 0.3  # intersection over union of an outline and its sector that replaces it, and its gain
_SKIRT = 2  # cells by which outlines were widened


@dataclass(frozen=True, slots=True)
class SoftSector:
    """Sides in cells of a ring, the azimuth's not wrapped, and the width of their logistic edge."""

    top: float
    bottom: float
    left: float
    right: float
    soft: float

    def outside(self, rows: Float64, columns: Float64, grid: RingGrid) -> Float64:
        """Distance in cells from the outline, negative inside; corners are round outside of them."""
        wider = (grid.radii_px[0] + rows * grid.step_px) * 2 * np.pi / grid.count / grid.step_px
        across = (np.abs(columns - 0.5 * (self.left + self.right)) - 0.5 * (self.right - self.left)) * wider
        along = np.abs(rows - 0.5 * (self.top + self.bottom)) - 0.5 * (self.bottom - self.top)
        beyond = np.hypot(np.maximum(across, 0), np.maximum(along, 0))
        return np.asarray(beyond + np.minimum(np.maximum(across, along), 0))

    def mask(self, grid: RingGrid) -> Mask:
        """Cells (r, count) of which it hides something."""
        middle = 0.5 * (self.left + self.right)
        half = 0.5 * grid.count
        columns = np.asarray((np.arange(grid.count) - middle + half) % grid.count + middle - half, np.float64)
        rows = np.arange(len(grid.radii_px), dtype=np.float64)
        reach = self.soft * np.log(1 / _HIDDEN - 1)
        return np.asarray(self.outside(rows[:, None], columns[None], grid) < reach, np.bool_)


@dataclass(frozen=True, eq=False)
class _Near:
    """Both pictures near a sector: light (2, n, 3) over what is around, `weight` (2, n), and places (n,)."""

    light: Float64
    weight: Float64
    rows: Float64
    columns: Float64
    polynomial: Float64

    def left_over(self, sides: Float64, grid: RingGrid) -> Float64:
        """What of the light (2, n, 3) a sector does not explain."""
        share = 1 / (1 + np.exp(np.clip(SoftSector(*sides).outside(self.rows, self.columns, grid) / sides[4], -40, 40)))
        basis = np.concatenate([self.polynomial, share[:, None] * self.polynomial[:, :3]], axis=1)
        return np.stack([_residual(basis, *one) for one in zip(self.light, self.weight, strict=True)])


def _residual(basis: Float64, light: Float64, weight: Float64) -> Float64:
    weighted, values = basis * weight[:, None], light * weight[:, None]
    normal = weighted.T @ weighted
    normal[np.diag_indices_from(normal)] += 1e-9 * np.trace(normal)
    return np.asarray(values - weighted @ np.linalg.solve(normal, weighted.T @ values))


def _near(lights: Float64, first: SoftSector, grid: RingGrid) -> _Near:
    top, bottom = max(int(first.top) - _MARGIN, 0), min(int(first.bottom) + _MARGIN + 1, len(grid.radii_px))
    rows, columns = np.mgrid[top:bottom, int(first.left) - _MARGIN : int(first.right) + _MARGIN + 1]
    part = lights[:, :, rows, columns % grid.count]
    around = gaussian_filter(part.mean(axis=1), (0, _LOCAL, _LOCAL))
    weight = 1 / np.maximum(around, _FLOOR)
    y, x = (2 * (place - place.mean()) / np.ptp(place) for place in (rows.ravel(), columns.ravel()))
    polynomial = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    light = np.moveaxis(part, 1, -1).reshape(2, -1, 3)
    return _Near(light, weight.reshape(2, -1), rows.ravel().astype(float), columns.ravel().astype(float), polynomial)


@dataclass(frozen=True, slots=True)
class SectorFit:
    """A soft sector, and the log of what is left over without it over what is left with it: the worse picture's."""

    sector: SoftSector
    gain: float

    @property
    def settled(self) -> bool:
        """Whether its edge is one: what only shades off has none."""
        return self.sector.soft < 0.96 * _SOFT[2]


def fit_sector(lights: Float64, first: SoftSector, grid: RingGrid) -> SectorFit:
    """The soft sector near a first one that explains both pictures' light (2, 3, r, count), in their means, best."""
    near = _near(lights, first, grid)
    start = np.array([first.top, first.bottom, first.left, first.right, first.soft])
    low, high = _bounds(start)
    origin = np.append(low[:4] - 1, 0.0)  # steps of derivatives are in proportion to values, which azimuths are not
    scale = np.sqrt((near.left_over(start, grid) ** 2).mean(axis=(1, 2), keepdims=True)) + 1e-9

    def left_over(sides: Float64) -> Float64:
        return np.asarray((near.left_over(origin + sides, grid) / scale).ravel(), np.float64)

    found = least_squares(
        left_over, start - origin, bounds=(low - origin, high - origin), loss="soft_l1", f_scale=_ROBUST,
        x_scale=[1, 1, 1, 1, 0.5], diff_step=[0.01] * 5, max_nfev=_STEPS, ftol=_TOLERANCE, xtol=_TOLERANCE,
    )  # fmt: skip
    best = origin + found.x
    without = np.stack([_residual(near.polynomial, *one) for one in zip(near.light, near.weight, strict=True)])
    least = [np.maximum((left**2).sum(axis=(1, 2)), _FLOOR**2) for left in (without, near.left_over(best, grid))]
    return SectorFit(SoftSector(*map(float, best)), float(np.log(least[0] / least[1]).min()))


def _bounds(start: Float64) -> tuple[Float64, Float64]:
    """Of the four sides and the edge: opposite sides never meet."""
    low, high = start - _REACH, start + _REACH
    for one, other in ((0, 1), (2, 3)):
        low[other] = max(low[other], 0.5 * (start[one] + start[other]) + 1)
        high[one] = min(high[one], low[other] - 1)
    low[4], high[4] = _SOFT[0], _SOFT[2]
    return low, high


def sectors_and_outlines(
    lights: Float64, sectors: Sequence[tuple[Sector, float]], outlined: Mask, grid: RingGrid
) -> Mask:
    """Cells (r, count) of sectors whose sides and fit together are believed, and of outlines that are none of these.

    Sectors come with the log likelihood ratio of their sides. An outline that a sector explains as well becomes one.
    """
    mask = np.zeros(outlined.shape, np.bool_)
    fits = [(fit_sector(lights, _first(sector), grid), ratio) for sector, ratio in sectors]
    likely = [(ratio + _GAIN * min(fit.gain, _MOST), fit.sector) for fit, ratio in fits if fit.settled]
    for ratio, sector in sorted(likely, key=lambda one: -one[0]):
        cells = sector.mask(grid)
        if ratio > _BELIEVED and not (cells & binary_dilation(mask, iterations=_APART)).any():
            mask |= cells
    numbers, _ = label(outlined)
    for number, (rows, columns) in enumerate(find_objects(numbers), start=1):
        outline = np.asarray(numbers == number, np.bool_)
        if (outline & mask).sum() < _SHARED * outline.sum():
            mask |= _sharpened(lights, outline, rows, columns, grid)
    return mask


def _first(sector: Sector) -> SoftSector:
    return SoftSector(sector.top, sector.top + sector.height, sector.left, sector.left + sector.width, _SOFT[1])


def _sharpened(lights: Float64, outline: Mask, rows: slice, columns: slice, grid: RingGrid) -> Mask:
    """The sector that an outline, in its box, is; or the outline where it is none."""
    if min(rows.stop - rows.start, columns.stop - columns.start) < 4 * _SKIRT:
        return outline
    sides = rows.start + _SKIRT, rows.stop - _SKIRT, columns.start + _SKIRT, columns.stop - _SKIRT
    fit = fit_sector(lights, SoftSector(*sides, _SOFT[1]), grid)
    cells = fit.sector.mask(grid)
    agree = (cells & outline).sum() > _AGREE * (cells | outline).sum()
    return cells if agree and fit.settled and fit.gain > _CLEAR else outline
