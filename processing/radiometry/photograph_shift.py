"""Whether photographs of a bracket show the same framing: the shift between two exposures."""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from processing.radiometry.alignment import Shift
from processing.radiometry.response import Response
from processing.robust import bulk_deviation

Array = NDArray[np.float64]
_INSIDE = 20, 235  # codes whose light both exposures know
_BLUR_PX = 2.0
_TILE_PX = 48
_KNOWN = 0.5  # share of a tile that both exposures must show
_FLAT = 1e-4  # mean squared slope of log light per pixel under which a tile has no edges
_LEAST_TILES = 6


def photograph_shift(codes: NDArray[np.uint8], response: Response, pair: tuple[int, int]) -> Shift:
    """By how much the picture of the second of two photographs (2, h, w, channels) lies right of and under the first.

    Their logarithmic light differs by the shift times its slope, and by a constant; solved by least squares in tiles,
    whose median counts, since parts of a scene may move, and whose scatter is the deviation. Shifts of several pixels
    come out too short. `pair` are the numbers that the result names.
    """
    channel = codes.shape[-1] // 2
    light = response.log_exposure[:, channel]
    frames = [cv2.GaussianBlur(light[frame[..., channel]], (0, 0), _BLUR_PX) for frame in codes]
    inside = ((codes[..., channel] >= _INSIDE[0]) & (codes[..., channel] <= _INSIDE[1])).all(axis=0)
    known = cv2.erode(np.asarray(inside, np.uint8), np.ones((9, 9), np.uint8), borderValue=0) > 0
    mean, difference = 0.5 * (frames[0] + frames[1]), frames[1] - frames[0]
    slopes = np.stack([-np.gradient(mean, axis=1), -np.gradient(mean, axis=0), np.ones_like(mean)], axis=-1)
    found = np.array(_tile_shifts(slopes, difference, known)).reshape(-1, 2)
    if len(found) < _LEAST_TILES:
        return Shift(*pair, np.zeros(2), np.full(2, np.inf), 1.0)
    shift = np.median(found, axis=0)
    # The median of n normal values scatters by 1.25 times their mean.
    sigma = np.array([1.25 * bulk_deviation(found[:, i] - shift[i]) for i in range(2)]) / np.sqrt(len(found))
    sigma = np.maximum(sigma, 1e-3)
    return Shift(*pair, shift, sigma, float(chi2.sf(((shift / sigma) ** 2).sum(), 2)))


def _tile_shifts(slopes: Array, difference: Array, known: NDArray[np.bool_]) -> list[Array]:
    found: list[Array] = []
    for top in range(0, known.shape[0] - _TILE_PX + 1, _TILE_PX):
        for left in range(0, known.shape[1] - _TILE_PX + 1, _TILE_PX):
            tile = np.s_[top : top + _TILE_PX, left : left + _TILE_PX]
            use = known[tile]
            if use.mean() < _KNOWN:
                continue
            design = slopes[tile][use]
            normal = design.T @ design
            free = normal[:2, :2] - np.outer(normal[:2, 2], normal[2, :2]) / normal[2, 2]
            if np.linalg.eigvalsh(free)[0] > _FLAT * normal[2, 2]:
                found.append(np.asarray(np.linalg.solve(normal, design.T @ difference[tile][use])[:2], np.float64))
    return found
