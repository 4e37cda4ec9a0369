"""Pixels that show no scene, made anew by cloning a clean place of the same photograph."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, find_objects, label, map_coordinates

from processing.environment.poisson import fill
from processing.products.arrays import Float64

Mask = NDArray[np.bool_]
_TURNS_DEG = (8, 12, 17, 23, 30, 40, 55)  # about the image's centre: what is as far from it is bent alike
_BAND_PX = 3
_MARGIN_PX = 6
_FLOOR = 1e-4  # of the mean light


def clone_clean(picture: NDArray[np.floating], mask: Mask, seen: Mask, centre_px: Float64) -> Float64:
    """The linear picture (h, w, 3) with every part of `mask` (h, w) cloned from beside it, seamlessly.

    The logarithm of light is cloned, so that it stays positive and the scene's range does not matter. Of places turned
    about `centre_px`, that are `seen` (h, w) and not masked, the one counts that differs most evenly from what lies
    around the part; where there is none the part is filled smoothly. NaN in the mask is as good as any value.
    """
    values = np.asarray(picture, np.float64)
    known = ~mask & np.isfinite(values).all(axis=-1)
    mean = values[known & seen].mean(axis=0) if (known & seen).any() else np.ones(3)
    floor = np.maximum(_FLOOR * mean, np.finfo(float).tiny)
    log = np.log(np.maximum(np.where(known[..., None], values, floor), floor))
    result = values.copy()
    numbers, _ = label(mask)
    for number, (rows, columns) in enumerate(find_objects(numbers), start=1):
        box = _widened(rows, mask.shape[0]), _widened(columns, mask.shape[1])
        part, usable = numbers[box] == number, (known & seen)[box]
        guide = _clean_place(log, known & seen, box, part, centre_px)
        # Neighbours that are no scene, as those beyond the rim, are made anew too and then left as they were.
        unknown = part | (~usable & binary_dilation(part, iterations=1))
        filled = fill(log[box], unknown, guide) if not unknown.all() else log[box]
        result[box][part] = np.exp(filled[part])
    return result


def _widened(part: slice, size: int) -> slice:
    return slice(max(part.start - _MARGIN_PX, 0), min(part.stop + _MARGIN_PX, size))


def _clean_place(log: Float64, clean: Mask, box: tuple[slice, slice], part: Mask, centre_px: Float64) -> Float64 | None:
    """The log picture (h, w, 3) of the box turned to where it shows no mask; None where no turn does."""
    rows, columns = np.mgrid[box]
    x, y = columns - centre_px[0], rows - centre_px[1]
    near = binary_dilation(part, iterations=_BAND_PX)
    band = near & ~part & clean[box]
    best, least = None, np.inf
    for turn in np.radians([way * step for step in _TURNS_DEG for way in (1, -1)]):
        c, s = np.cos(turn), np.sin(turn)
        at = [centre_px[1] + s * x + c * y, centre_px[0] + c * x - s * y]
        if map_coordinates(clean.astype(np.float32), at, order=1, cval=0.0)[part | band].min(initial=1.0) < 0.99:
            continue
        guide = np.stack([map_coordinates(log[..., i], at, order=1, mode="nearest") for i in range(3)], axis=-1)
        uneven = float((log[box] - guide)[band].std(axis=0).mean()) if band.any() else 0.0
        if uneven < least:
            best, least = guide, uneven
    return best
