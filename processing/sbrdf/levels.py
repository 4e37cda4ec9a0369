"""The surface at half the texels, a quarter and so on, each analysed anew: mip levels, so that far surfaces are still.

Lobes, shifts and clusters cannot be averaged as colours are: the mean of two lobes is no lobe, that of two shifts leads
nowhere. What is averaged is the BTF.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from processing.products import Btf, SbrdfPlus
from processing.products.arrays import Float32, Float64
from processing.sbrdf.samples import BtfViews

_ROWS = 8  # made at a time: from 16 rows, as many as a chunk of a stored BTF has
_TAPS = 3  # texels along one side of a coarser one: three at most

_Taps = list[tuple[NDArray[np.intp], Float64]]


def coarser_levels(btf: BtfViews, analyse: Callable[[Btf], SbrdfPlus]) -> tuple[SbrdfPlus, ...]:
    """What `analyse` makes of the BTF at half its texels along each side, then half of that, down to one texel.

    Each level is made from the one before it and lies in memory, float32, while it is analysed. What `analyse` raises
    passes through.
    """
    levels = []
    while max(btf.shape[2:4]) > 1:
        btf = halved(btf)
        levels.append(analyse(btf))
    return tuple(levels)


def halved(btf: BtfViews) -> Btf:
    """Each texel the mean, by area, of those under it: 2 x 2, or up to 3 x 3 where a side is odd and is rounded down.

    Missing samples are left out of the mean; it is missing where all are. The tile stays as large, so texture
    coordinates mean the same places.
    """
    lights, views, height, width, channels = btf.shape
    coarse = np.empty((lights, views, max(height // 2, 1), max(width // 2, 1), channels), np.float32)
    across = _taps(width, coarse.shape[3])
    for start in range(0, coarse.shape[2], _ROWS):
        down = _taps(height, coarse.shape[2], slice(start, start + _ROWS))
        first, last = min(int(i.min()) for i, _ in down), max(int(i.max()) for i, _ in down)
        block = btf.rows(slice(first, last + 1))
        coarse[:, :, start : start + _ROWS] = _mean(block, [(i - first, share) for i, share in down], across)
    return Btf(coarse, btf.light_directions, btf.view_directions)


def _mean(block: Float32, down: _Taps, across: _Taps) -> Float32:
    """Of (light, view, y, x, channel), over y and x, without what is missing."""
    missing = np.isnan(block)
    total = _sum(_sum(block if not missing.any() else np.where(missing, 0, block), across, 3), down, 2)
    if not missing.any():
        return total
    measured = _sum(_sum((~missing).astype(np.float32), across, 3), down, 2)
    # Shares of what is left are far above the rounding of a sum that should be nothing.
    return np.divide(total, measured, out=np.full_like(total, np.nan), where=measured > 1e-3)


def _sum(block: Float32, taps: _Taps, axis: int) -> Float32:
    shape = [-1 if i == axis else 1 for i in range(block.ndim)]
    return np.asarray(sum(block.take(i, axis) * share.astype(np.float32).reshape(shape) for i, share in taps))


def _taps(fine: int, coarse: int, chosen: slice = slice(None)) -> _Taps:
    """Texels under each of the chosen coarse ones along one side, and their shares, which add up to 1."""
    start, step = (np.arange(coarse) * fine / coarse)[chosen], fine / coarse
    taps = []
    for tap in range(_TAPS):
        texel = np.floor(start + 1e-9) + tap
        overlap = np.clip(np.minimum(texel + 1, start + step) - np.maximum(texel, start), 0, None)
        taps.append((np.minimum(texel, fine - 1).astype(np.intp), overlap / step))
    return [(index, share) for index, share in taps if (share > 1e-9).any()]
