"""The loop that finds the extremes of an image's tiles, compiled by numba; its twin is in tests/reference."""

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray


@njit(parallel=True, cache=True)
def tile_extremes(
    raw_dn: NDArray[np.uint16], tiles: NDArray[np.intp], tile_px: int, ignored: NDArray[np.bool_]
) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """Least and greatest counts (n,) of square tiles (n, 2) by row and column of tiles, each pixel touched once.

    Pixels of `ignored` (h, w), which may be empty, do not count; a tile without others has the extremes of nothing,
    65535 and 0.
    """
    height = raw_dn.shape[0]
    least, greatest = np.empty(len(tiles), np.uint16), np.empty(len(tiles), np.uint16)
    for n in prange(len(tiles)):
        top, left = tiles[n, 0] * tile_px, tiles[n, 1] * tile_px
        low, high = np.uint16(65535), np.uint16(0)
        for y in range(top, min(top + tile_px, height)):
            row = raw_dn[y, left : left + tile_px]
            if ignored.size == 0:  # a loop without further questions is vectorised
                for dn in row:
                    low = dn if dn < low else low
                    high = dn if dn > high else high
            else:
                for dn, out in zip(row, ignored[y, left : left + tile_px]):  # noqa: B905  numba knows no strict
                    low = dn if dn < low and not out else low
                    high = dn if dn > high and not out else high
        least[n], greatest[n] = low, high
    return least, greatest
