"""From pixels to texels: the displacement along the view ray through every texel of the reference plane.

A texel's view ray is the pixel ray through the image of its reference point, so this is interpolation in the image at
known places, and one resampling in all.
"""

import numpy as np
from numpy.typing import NDArray

from processing.laser.local_surface import Samples, edge_level, predict_surface

Array = NDArray[np.float64]
_REACH_PX = 2.6  # of the pixels that speak for a texel
_PIXELS = int(np.pi * _REACH_PX**2)
_NEAR_PX = 1.5  # within which one must be measured: between four measured ones the nearest is 0.71 away
_INSIDE = 0.3  # pixels, about, from the edge of what was measured: two standard deviations of where it runs
_CHUNK = 4096  # texels whose samples are held at a time, and which share one prior


def texel_displacement(
    displacement_m: NDArray[np.floating], variance_m2: NDArray[np.floating], uv_px: Array, pitch_m: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Displacement (n, n) and variance at texels `pitch_m` apart, seen at image points `uv_px` (n, n, 2).

    The measured pixels around a texel's image point are samples of one surface there, or of two where one hides part
    of the other: `local_surface` predicts it from them. The variance is that of the prediction: large on steep or
    ragged places, and where it is open which of two surfaces lies on the ray. NaN where no measured pixel is near.
    """
    places, pixel_m = uv_px.reshape(-1, 2), pixel_extent(uv_px, pitch_m)
    values = np.asarray(displacement_m, np.float64) / pixel_m
    variances = np.asarray(variance_m2, np.float64) / pixel_m**2
    found = np.full((len(places), 2), np.nan)
    telling = _telling(np.isfinite(values))
    seen = np.flatnonzero(((places > -1.0) & (places < np.array(values.shape[::-1]))).all(axis=1))
    for start in range(0, len(seen), _CHUNK):
        part = seen[start : start + _CHUNK]
        samples, expected = _around(values, variances, telling, places[part])
        within = _on_measured(samples, expected)
        if within.any():
            found[part[within]] = predict_surface(samples.chosen(within)) * (pixel_m, pixel_m**2)
    grid = found.reshape(*uv_px.shape[:2], 2).astype(np.float32)
    return grid[..., 0], grid[..., 1]


def _telling(measured: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels (h, w) of which one that was not measured means that there is nothing: blue ones hardly see the laser.

    Those at the places of the 2 x 2 mosaic where at least half as many were measured as at the best one.
    """
    shares = np.array([[measured[row::2, column::2].sum() for column in (0, 1)] for row in (0, 1)])
    cell = shares >= 0.5 * shares.max()
    row, column = (np.arange(size) % 2 for size in measured.shape)
    return np.asarray(cell[row[:, None], column])


def _on_measured(samples: Samples, expected: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which places (n,) have a measured pixel close by and lie within what was measured.

    Pixels that were and those that were `expected` (n, k) but were not are two sides of an edge, as two surfaces are.
    """
    label = np.where(samples.measured, 1.0, -1.0)
    near = (samples.measured & (np.linalg.norm(samples.offset, axis=-1) < _NEAR_PX)).any(axis=1)
    level = edge_level(samples.offset, label, samples.measured | expected)
    return np.asarray(near & (level > _INSIDE))


def pixel_extent(uv_px: Array, pitch_m: float) -> float:
    """Side in metres of a square as large as a pixel on the reference plane, seen at `uv_px` (n, n, 2)."""
    steps = [np.diff(uv_px, axis=axis).reshape(-1, 2) for axis in (0, 1)]
    known = [step[np.isfinite(step).all(axis=1)] for step in steps]
    if min(len(step) for step in known) == 0:
        return pitch_m
    down, right = (np.median(step, axis=0) for step in known)
    pixels = abs(down[0] * right[1] - down[1] * right[0])
    return float(pitch_m / np.sqrt(max(pixels, 1e-6)))


def _around(
    values: Array, variances: Array, telling: NDArray[np.bool_], places: Array
) -> tuple[Samples, NDArray[np.bool_]]:
    """The pixels nearest to every image point (n, 2), and which of them (n, k) are expected to be measured."""
    reach = int(np.ceil(_REACH_PX))
    square = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2), axis=-1).reshape(-1, 2)
    pixel = np.rint(places).astype(int)[:, None] + square
    distance = np.linalg.norm(pixel - places[:, None], axis=-1)
    nearest = np.argsort(distance, axis=1, kind="stable")[:, :_PIXELS]
    pixel = np.take_along_axis(pixel, nearest[..., None], axis=1)
    inside = np.all((pixel >= 0) & (pixel < np.array(values.shape[::-1])), axis=-1)
    column, row = np.moveaxis(np.where(inside[..., None], pixel, 0), -1, 0)
    value, variance = values[row, column], variances[row, column]
    measured = inside & np.isfinite(value) & np.isfinite(variance) & (variance > 0.0)
    return Samples(pixel - places[:, None], value, variance, measured), telling[row, column] | ~inside
