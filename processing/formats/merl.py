"""MERL's files of measured isotropic BRDFs: three numbers of cells, then doubles for red, green and blue.

Cells are (half angle, difference angle, difference azimuth) as of Rusinkiewicz 1998: 90 over the root of the first, 90
over the second, 180 over half a turn of the third. Source: Matusik et al. 2003, with the scales of its reader.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from processing.errors import ImageError
from processing.products.arrays import Float64

CELLS = 90, 90, 180
SCALES = np.array([1.0, 1.15, 1.66]) / 1500.0
_HEADER = 12  # bytes: three int32


@dataclass(frozen=True, eq=False)
class MerlBrdf:
    """`table` (90, 90, 90, 3) in 1/sr, as `processing.lighting.brdfs.tabulated` takes it: azimuths 0 to 90 deg.

    `missing` is the share of the cells above the horizon that nothing was measured for.
    """

    table: Float64
    missing: float


def read_merl(path: Path) -> MerlBrdf:
    """A measured BRDF, the second quarter of a turn folded onto the first, as isotropic surfaces are mirrored.

    Cells that are negative or no number were not measured: they count as their mirror image, else as the nearest cell,
    by numbers of cells, that was. Raises ImageError where the file cannot be read, is of another format or size, or
    holds no value at all.
    """
    values = _cells(path)
    known = np.asarray((np.isfinite(values) & (values >= 0)).all(axis=-1))
    both = np.stack([known[:, :, :90], known[:, :, :89:-1]])
    sides = np.stack([values[:, :, :90], values[:, :, :89:-1]])
    count = both.sum(axis=0)
    if not count.any():
        raise ImageError(f"{path}: no cell holds a value; the file is damaged or was never filled")
    table = np.where(both[..., None], sides, 0.0).sum(axis=0) / np.maximum(count, 1)[..., None]
    missing = float((count == 0)[_above_horizon()].mean())
    nearest = distance_transform_edt(count == 0, return_distances=False, return_indices=True)
    return MerlBrdf(np.ascontiguousarray(table[tuple(nearest)]), missing)


def _cells(path: Path) -> Float64:
    """Reflectances (90, 90, 180, 3) as they are in the file, scaled."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ImageError(f"{path}: not a readable MERL file ({error}).") from error
    found = tuple(np.frombuffer(content[:_HEADER], "<i4").tolist()) if len(content) >= _HEADER else ()
    if found != CELLS:
        raise ImageError(f"{path}: not a MERL file: it begins with {found or 'nothing'} instead of 90, 90, 180 cells")
    expected = _HEADER + 3 * 8 * int(np.prod(CELLS))
    if len(content) != expected:
        raise ImageError(f"{path}: {len(content)} bytes, a MERL file has {expected}; copy it again")
    stored = np.frombuffer(content, "<f8", offset=_HEADER).reshape(3, *CELLS)
    return np.moveaxis(stored, 0, -1) * SCALES


def _above_horizon() -> NDArray[np.bool_]:
    """Cells (90, 90, 90) in whose middles light and view are both above the horizon."""
    half = ((np.arange(90) + 0.5) / 90) ** 2 * (np.pi / 2)
    difference = turn = (np.arange(90) + 0.5) / 90 * (np.pi / 2)
    upright = np.cos(half)[:, None] * np.cos(difference)
    aslant = np.sin(half)[:, None] * np.sin(difference)
    return np.asarray(upright[:, :, None] > aslant[:, :, None] * np.cos(turn))
