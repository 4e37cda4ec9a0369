"""Loops over the tiles of an image, compiled by numba; the twin of the one that computes is in tests/reference.

They run at the speed of memory on one thread; a second one would cost more to wake than it saves.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True)
def tile_extremes(
    raw_dn: NDArray[np.uint16], corners: NDArray[np.intp], tile_px: int, ignored: NDArray[np.bool_]
) -> NDArray[np.uint16]:
    """Least and greatest counts (2, n) of square tiles at these corners (n, 2), each pixel touched once.

    Pixels of `ignored` (h, w), which may be empty, do not count; a tile without others has the extremes of nothing,
    65535 and 0.
    """
    found = np.empty((2, len(corners)), np.uint16)
    least, greatest = np.empty(tile_px, np.uint16), np.empty(tile_px, np.uint16)
    for n in range(len(corners)):
        top, left = corners[n]
        least[:] = 65535
        greatest[:] = 0
        for y in range(top, min(top + tile_px, raw_dn.shape[0])):
            row = raw_dn[y, left : left + tile_px]
            if ignored.size == 0:
                for x in range(row.size):  # by column, which is vectorised
                    least[x] = row[x] if row[x] < least[x] else least[x]
                    greatest[x] = row[x] if row[x] > greatest[x] else greatest[x]
            else:
                out = ignored[y, left : left + tile_px]
                for x in range(row.size):
                    least[x] = row[x] if row[x] < least[x] and not out[x] else least[x]
                    greatest[x] = row[x] if row[x] > greatest[x] and not out[x] else greatest[x]
        found[0, n], found[1, n] = least.min(), greatest.max()
    return found


@njit(cache=True)
def gather_tiles(image: NDArray[np.generic], corners: NDArray[np.intp], pixels: NDArray[np.generic]) -> None:
    """Copy the tiles at these corners (n, 2) of an image (h, w) into `pixels` (n, rows, columns)."""
    for n in range(len(corners)):
        top, left = corners[n]
        for y in range(pixels.shape[1]):
            pixels[n, y] = image[top + y, left : left + pixels.shape[2]]


@njit(cache=True)
def scatter_tiles(pixels: NDArray[np.generic], corners: NDArray[np.intp], image: NDArray[np.generic]) -> None:
    """Copy `pixels` (n, rows, columns) to the tiles at these corners (n, 2) of an image (h, w)."""
    for n in range(len(corners)):
        top, left = corners[n]
        for y in range(pixels.shape[1]):
            image[top + y, left : left + pixels.shape[2]] = pixels[n, y]
