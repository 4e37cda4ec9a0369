"""How far two pictures of linear values look apart: FLIP (Andersson et al. 2020), 0 for none to 1."""

from typing import Any

import flip_evaluator
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
WHITE_PERCENTILE = 99.0  # of the true values: what lies above is clipped, as on a screen


def mean_flip(true: Array, other: Array) -> float:
    """Mean of FLIP over pictures (picture, y, x, 3), white at the same value for all; NaN is black."""
    white = np.nanpercentile(true, WHITE_PERCENTILE)
    pairs = ((_screen(one / white), _screen(two / white)) for one, two in zip(true, other, strict=True))
    return float(np.mean([flip_evaluator.evaluate(one, two, "LDR", applyMagma=False)[1] for one, two in pairs]))


def _screen(linear: Array) -> Array:
    """sRGB (y, x, 3) float32."""
    clipped = np.clip(np.nan_to_num(linear), 0.0, 1.0)
    curved = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    return np.ascontiguousarray(curved, np.float32)
