"""Bayer mosaics: their channels, and the colour or grey images made of them."""

import cv2
import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError

_RED_BLUE = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], np.float64) / 4
_GREEN = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]], np.float64) / 4


def cfa_channels(cfa: NDArray[np.uint8], shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Channel index (0 red, 1 green, 2 blue) of every pixel (h, w) of a mosaic with the 2x2 pattern `cfa`."""
    rows, columns = np.indices(shape, sparse=True)
    channels: NDArray[np.uint8] = np.asarray(cfa, np.uint8)[rows % 2, columns % 2]
    return channels


def demosaic(
    mosaic: NDArray[np.floating], variance: NDArray[np.floating], cfa: NDArray[np.uint8]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Colour image (h, w, 3) and variance of a linear Bayer mosaic (h, w), by normalised bilinear convolution.

    Missing samples (NaN) take no part: a pixel is NaN only where no neighbour has its channel. The variance is that
    of the weighted mean; neighbours share samples, so it is not independent between pixels.
    Raises ImageError where the shapes disagree or the pattern is not 2x2 of 0, 1, 2.
    """
    _check_mosaic(mosaic, variance, cfa)
    channels = cfa_channels(cfa, (mosaic.shape[0], mosaic.shape[1]))
    valid = np.isfinite(mosaic) & np.isfinite(variance)
    planes = [
        _interpolate(np.where(use, mosaic, 0.0), np.where(use, variance, 0.0), use, _GREEN if c == 1 else _RED_BLUE)
        for c, use in ((c, valid & (channels == c)) for c in range(3))
    ]
    return np.stack([p[0] for p in planes], -1), np.stack([p[1] for p in planes], -1)


def _check_mosaic(mosaic: NDArray[np.floating], variance: NDArray[np.floating], cfa: NDArray[np.uint8]) -> None:
    if mosaic.ndim != 2 or mosaic.shape != variance.shape:
        raise ImageError(f"mosaic {mosaic.shape} and variance {variance.shape} must be one (h, w).")
    if np.shape(cfa) != (2, 2) or not np.isin(cfa, (0, 1, 2)).all():
        raise ImageError(f"not a Bayer pattern: {np.asarray(cfa).tolist()}")


def _interpolate(
    value: NDArray[np.floating], variance: NDArray[np.floating], use: NDArray[np.bool_], kernel: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    total = _filter(use.astype(np.float64), kernel)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(total > 0, _filter(value, kernel) / total, np.nan)
        spread = np.where(total > 0, _filter(variance, kernel**2) / total**2, np.nan)
    return mean.astype(np.float32), spread.astype(np.float32)


def _filter(image: NDArray[np.floating], kernel: NDArray[np.float64]) -> NDArray[np.float64]:
    image64 = np.ascontiguousarray(image, np.float64)
    return np.asarray(cv2.filter2D(image64, cv2.CV_64F, kernel, borderType=cv2.BORDER_CONSTANT), np.float64)


def grey_mosaic(mosaic: NDArray[np.floating], cfa: NDArray[np.uint8]) -> NDArray[np.float64]:
    """A linear mosaic (h, w) of a scene without colour as a grey image: each channel scaled to the same brightness.

    Unlike demosaicing it keeps every pixel's own sample, so that small markers stay legible. The scale is the 95th
    percentile of each channel. Raises ImageError where a channel has no light or no finite sample.
    """
    _check_mosaic(mosaic, mosaic, cfa)
    channels = cfa_channels(cfa, (mosaic.shape[0], mosaic.shape[1]))
    known = [mosaic[(channels == c) & np.isfinite(mosaic)] for c in range(3)]
    level = np.array([np.percentile(values, 95) if values.size else 0.0 for values in known])
    if not (level > 0).all():
        raise ImageError("a mosaic without light, or saturated everywhere; check the lamp and the exposure.")
    return np.asarray(mosaic / level[channels], np.float64)


def white_balance(
    image: NDArray[np.floating], variance: NDArray[np.floating], multipliers: NDArray[np.floating]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Image and variance (..., 3) with each channel times its multiplier (3,), normalised so that green stays."""
    factors = np.asarray(multipliers, np.float64) / multipliers[1]
    return (image * factors).astype(np.float32), (variance * factors**2).astype(np.float32)
