"""How far two pictures of linear values look apart: FLIP (Andersson et al. 2020), 0 to 1, and SSIM, 1 where alike.

SSIM is that of Wang et al. 2004 on the luma of the picture as shown: Gaussian windows of 1.5 pixels, K = 0.01 and 0.03.
"""

from collections.abc import Iterator
from typing import Any

import flip_evaluator
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

Array = NDArray[Any]
WHITE_PERCENTILE = 99.0  # of the true values: what lies above is clipped, as on a screen


def mean_flip(true: Array, other: Array) -> float:
    """Mean of FLIP over pictures (picture, y, x, 3), white at the same value for all; NaN is black."""
    pairs = _shown(true, other)
    return float(np.mean([flip_evaluator.evaluate(one, two, "LDR", applyMagma=False)[1] for one, two in pairs]))


def mean_ssim(true: Array, other: Array) -> float:
    """Mean of SSIM over pictures (picture, y, x, 3), as `mean_flip` shows them."""
    luma = np.array([0.299, 0.587, 0.114])
    return float(np.mean([_similarity(one @ luma, two @ luma) for one, two in _shown(true, other)]))


def _similarity(one: Array, two: Array) -> float:
    mean_one, mean_two = _local(one), _local(two)
    variances = _local(one * one) - mean_one**2 + _local(two * two) - mean_two**2
    covariance = _local(one * two) - mean_one * mean_two
    level = (2 * mean_one * mean_two + 0.01**2) / (mean_one**2 + mean_two**2 + 0.01**2)
    return float(np.mean(level * (2 * covariance + 0.03**2) / (variances + 0.03**2)))


def _local(values: Array) -> Array:
    return np.asarray(gaussian_filter(values, 1.5, truncate=3.5))


def _shown(true: Array, other: Array) -> Iterator[tuple[Array, Array]]:
    white = np.nanpercentile(true, WHITE_PERCENTILE)
    return ((_screen(one / white), _screen(two / white)) for one, two in zip(true, other, strict=True))


def _screen(linear: Array) -> Array:
    """sRGB (y, x, 3) float32."""
    clipped = np.clip(np.nan_to_num(linear), 0.0, 1.0)
    curved = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    return np.ascontiguousarray(curved, np.float32)
