"""Hot pixels of a merged mosaic, told from what a lens can draw.

A lens spreads the finest point of light over adjacent pixels, a hot pixel is alone. On a mosaic the adjacent pixels
have another colour, but no light is seen by one colour only. A hot pixel therefore stands out from its like-coloured
neighbours, two pixels away, while the four adjacent pixels are as theirs.
"""

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.radiometry.hdr import PixelStatus, Radiance

Float32 = NDArray[np.float32]

PEAK_RATIO = 1.5  # to the brightest like-coloured neighbour, and
PEAK_SIGMA = 20.0  # standard deviations above it
# Largest mean deviation of the adjacent pixels, in shares of the pixel's own. A point under a lens of 0.5 px (standard
# deviation) lends them 14 %, 7 % where the colours' responses differ by two.
ADJACENT_SHARE = 0.03
ADJACENT_SIGMA = 2.0  # of noise, and
TEXTURE_SIGMA = 2.0  # of the differences among their neighbours, are allowed for
FRAME_PX = 3

_ADJACENT = np.array([(-1, 0), (1, 0), (0, -1), (0, 1)])
_ALIKE = np.array([(y, x) for y in (-2, 0, 2) for x in (-2, 0, 2) if (y, x) != (0, 0)])
_RATIO, _SQUARED_SIGMA, _LOWEST = np.float32(PEAK_RATIO), np.float32(PEAK_SIGMA**2), np.float32(-np.inf)


def find_hot_pixels(mosaic: Radiance) -> NDArray[np.bool_]:
    """Pixels (h, w) of a merged Bayer mosaic that no image under a lens can hold: True where hot.

    Found are pixels over 1.5 times their brightest like-coloured neighbour whose excess is also over some sixty
    standard deviations of an adjacent pixel; in rough texture it must be larger still. False alarms: fewer than one
    in a million pixels of noise, none behind a lens of 0.5 px (standard deviation) or softer. A dot of one pure
    colour, finer than the lens, would be mistaken. The outermost three pixels are not judged.
    Raises ImageError where the image is no mosaic (h, w).
    """
    if mosaic.value.ndim != 2:
        raise ImageError(f"image of shape {mosaic.value.shape}; hot pixels are found on the mosaic (h, w).")
    hot = np.zeros(mosaic.value.shape, np.bool_)
    _find(mosaic.value, mosaic.variance, hot)
    return hot


def without_hot_pixels(mosaic: Radiance) -> Radiance:
    """The mosaic with the hot pixels that it shows unknown: NaN, status HOT."""
    hot = find_hot_pixels(mosaic)
    value, variance, status = mosaic.value.copy(), mosaic.variance.copy(), mosaic.status.copy()
    value[hot], variance[hot], status[hot] = np.nan, np.nan, PixelStatus.HOT
    return Radiance(value, variance, status)


def fill_hot_pixels(mosaic: Radiance) -> Radiance:
    """The mosaic (h, w) with a guess in each pixel of status HOT, for pictures: the mean of like-coloured neighbours.

    Its variance is that of their mean, and what their spread beyond their noise lets expect of one more. Fewer than
    two neighbours give no guess. The status stays.
    """
    value, variance = mosaic.value.copy(), mosaic.variance.copy()
    places = np.argwhere(mosaic.status == PixelStatus.HOT)
    near = places[:, None] + _ALIKE
    inside = ((near >= 0) & (near < mosaic.value.shape)).all(axis=-1)
    y, x = np.moveaxis(np.where(inside[..., None], near, places[:, None]), -1, 0)
    neighbours = np.ma.masked_invalid(mosaic.value[y, x])
    noise = np.ma.masked_invalid(mosaic.variance[y, x]).mean(axis=1)
    known = neighbours.count(axis=1)
    texture = np.ma.maximum(neighbours.var(axis=1, ddof=1) - noise, 0)  # none where fewer than two are known
    spread = (texture * (known + 1) + noise) / np.maximum(known, 1)
    value[tuple(places.T)] = np.ma.masked_where(spread.mask, neighbours.mean(axis=1)).filled(np.nan)
    variance[tuple(places.T)] = spread.filled(np.nan)
    return Radiance(value, variance, mosaic.status)


@njit(parallel=True, cache=True, error_model="numpy")
def _find(value: Float32, variance: Float32, hot: NDArray[np.bool_]) -> None:
    for y in prange(FRAME_PX, len(value) - FRAME_PX):
        _suspect((value[y - 2], value[y], value[y + 2]), variance[y], hot[y])
        for x in np.flatnonzero(hot[y]):
            own = value[y, x] - np.nanmax(_alike(value, y, int(x)))
            hot[y, x] = _adjacent(value, variance, y, int(x)) < ADJACENT_SHARE * own


@njit(error_model="numpy", inline="always")
def _brightest(known: np.float32, line: Float32, x: int) -> np.float32:
    """The largest of what is known and of the like-coloured pixels of a line but its middle; NaN does not count."""
    known = line[x - 2] if line[x - 2] > known else known
    return line[x + 2] if line[x + 2] > known else known


@njit(error_model="numpy")
def _suspect(rows: tuple[Float32, Float32, Float32], variance: Float32, suspect: NDArray[np.bool_]) -> None:
    """Mark what stands out from its like-coloured neighbours, two pixels away; those that are NaN do not count."""
    above, row, below = rows
    for x in range(FRAME_PX, row.size - FRAME_PX):
        brightest = _brightest(_brightest(_brightest(_LOWEST, above, x), row, x), below, x)
        brightest = above[x] if above[x] > brightest else brightest
        brightest = below[x] if below[x] > brightest else brightest
        own = row[x] - brightest
        suspect[x] = (own > 0) & (row[x] > _RATIO * brightest) & (own * own > _SQUARED_SIGMA * variance[x])


@njit(error_model="numpy")
def _alike(value: Float32, y: int, x: int) -> Float32:
    """The like-coloured neighbours (8,)."""
    found = np.empty(len(_ALIKE), np.float32)
    for k in range(len(_ALIKE)):
        found[k] = value[y + _ALIKE[k, 0], x + _ALIKE[k, 1]]
    return found


@njit(error_model="numpy")
def _adjacent(value: Float32, variance: Float32, y: int, x: int) -> float:
    """Upper bound of the mean by which the adjacent pixels depart from the median of their like-coloured neighbours.

    A dip counts like an excess: it is structure, in which a bright point may be as well. Where an adjacent pixel is
    unknown, for it may be saturated, nothing is bounded.
    """
    excess, spread = 0.0, 0.0
    for k in range(len(_ADJACENT)):
        v, u = y + _ADJACENT[k, 0], x + _ADJACENT[k, 1]
        alike = _alike(value, v, u)
        middle = np.nanmedian(alike)
        excess += abs(value[v, u] - middle)
        spread += ADJACENT_SIGMA**2 * variance[v, u] + TEXTURE_SIGMA**2 * np.nanmean((alike - middle) ** 2)
    bound = (excess + math.sqrt(spread)) / len(_ADJACENT)
    return bound if bound == bound else np.inf
