"""The fit of a whole sweep on all cores: the dark is skipped, what is clear goes through lanes, the rest one by one."""

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from processing.laser import pulse
from processing.laser.block_maxima import TILE
from processing.laser.pulse import NOT_WANTED, OK, TOO_DARK, UNWANTED, Camera, Limits, Settings, Sweep, Width, fit_pixel
from processing.laser.pulse_lanes import AMPLITUDE, TIME, UNCLEAR, VARIANCE, WIDTH, fit_lanes

_FEW = 40  # frames up to which the mean is much of the pulse itself
_PART = 64  # pixels of which a core fits one after the other


def fit_sweep(
    sweep: Sweep, camera: Camera, width: Width, limits: Limits
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Fit every pixel: (4, pixels) TIME, VARIANCE, AMPLITUDE, WIDTH, of pulse_lanes, and status (pixels,).

    Where the status is not OK the results are NaN, but for the amplitude where a pulse could be fitted.
    """
    results, status = np.empty((4, sweep[2].size), np.float32), np.empty(sweep[2].size, np.uint8)
    _fit_tiles(sweep, camera, width, limits, results, status)
    unclear = np.flatnonzero(status == UNCLEAR)
    if unclear.size:
        _fit_carefully(unclear, sweep, (*camera, *width, *limits), results, status)
    return results, status


@njit(parallel=True, cache=True)
def _fit_tiles(
    sweep: Sweep,
    camera: Camera,
    width: Width,
    limits: Limits,
    results: NDArray[np.float32],
    status: NDArray[np.uint8],
) -> None:
    for tile in prange((status.size + TILE - 1) // TILE):
        low, high = tile * TILE, min((tile + 1) * TILE, status.size)
        chosen = np.empty(high - low, np.int32)
        count = _bright(low, sweep, (camera, width, limits), chosen, status)
        for pixel in range(low, high):
            results[AMPLITUDE, pixel] = 0.0
        fit_lanes(chosen[:count], sweep, (camera, width, limits), results, status)
        for pixel in range(low, high):
            if status[pixel] != OK:
                results[TIME, pixel] = results[VARIANCE, pixel] = results[WIDTH, pixel] = np.nan


@njit(nogil=True, cache=True, error_model="numpy")
def _bright(low: int, sweep: Sweep, settings: Settings, chosen: NDArray[np.int32], status: NDArray[np.uint8]) -> int:
    """Choose those pixels, from `low` on, whose maximum can be that of a significant pulse; return their number.

    An amplitude of a pulse of width w is known to sigma / sqrt(sqrt(pi) w), where sigma is that of a sample.
    """
    _, _, brightest, maxima, total, _, times = sweep
    camera, width, limits = settings
    least = np.float32(0.8 * limits[0] / math.sqrt(math.sqrt(math.pi) * max(width[0], 0.5)))
    least = np.float32(0.0) if times.size < _FEW else least * least
    black, gain, dark = np.float32(camera[0]), np.float32(camera[1]), np.float32(camera[2])
    share, none = np.float32(camera[1] / times.size), np.float32(0.0)
    count = 0
    for pixel in range(low, low + chosen.size):
        mean = np.float32(total[pixel]) * share - black * gain
        above = (np.float32(maxima[0, pixel]) - black) * gain - mean
        noise = (mean if mean > none else none) + dark
        status[pixel] = NOT_WANTED if brightest[pixel] == UNWANTED else TOO_DARK
        chosen[count] = pixel
        count += (brightest[pixel] >= 0) & (above * above >= least * noise)
    return count


@njit(parallel=True, cache=True)
def _fit_carefully(
    pixels: NDArray[np.int64],
    sweep: Sweep,
    settings: tuple[float, float, float, float, float, float, float, float, float],
    results: NDArray[np.float32],
    status: NDArray[np.uint8],
) -> None:
    for part in prange((pixels.size + _PART - 1) // _PART):
        row = np.empty(pulse.FIELDS)
        apart = (settings[:4], settings[4:7], settings[7:])
        for pixel in pixels[part * _PART : (part + 1) * _PART]:
            fit_pixel(pixel, sweep, apart, row)
            status[pixel] = int(row[pulse.STATUS])
            found = status[pixel] == OK
            results[TIME, pixel] = row[pulse.TIME] if found else np.nan
            results[VARIANCE, pixel] = row[pulse.VARIANCE] if found else np.nan
            results[WIDTH, pixel] = row[pulse.WIDTH] if found else np.nan
            results[AMPLITUDE, pixel] = row[pulse.AMPLITUDE]
