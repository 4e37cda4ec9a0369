"""Where the fits of Lafortune lobes begin, and how narrow a lobe the samples can tell."""

import numpy as np

from processing.products.arrays import Float64

SMALLEST_EXPONENT = 0.5  # a broader lobe imitates the diffuse term
_LARGEST_EXPONENT = 1e4
_LEFT = 0.01  # of a lobe's peak at its second nearest samples: a narrower one would be told by its peak alone
_NEAREST = 8  # samples in a lobe
_DISTINCT_RAD = 1e-2

_FORWARD, _BACK, _UP = (-1.0, -1.0), (1.0, 1.0), (0.0, 0.0)
# C_x and C_y, C_z, n of three lobes
_STARTS = (
    ((*_FORWARD, 1.0, 10.0), (*_FORWARD, 0.6, 30.0), (*_BACK, 0.8, 3.0)),
    ((*_FORWARD, 0.8, 20.0), (*_BACK, 0.8, 20.0), (*_UP, 1.0, 2.0)),
    ((*_FORWARD, 0.9, 4.0), (*_FORWARD, 0.5, 40.0), (*_FORWARD, 1.0, 40.0)),
    ((*_BACK, 0.9, 4.0), (*_BACK, 0.5, 20.0), (*_FORWARD, 0.8, 20.0)),
)


def default_starts(lobes: int, shared: bool) -> Float64:
    """Lobes (k, j, 4) as C and log n."""
    starts = np.array(_STARTS)[:, :lobes]
    if shared:
        starts[:, :, :3] = starts[:, :1, :3]
    starts[..., 3] = np.log(starts[..., 3])
    return starts


def exponent_bounds(light: Float64, view: Float64) -> tuple[float, float]:
    """Range of exponents that samples under these directions (s, 3) can tell apart.

    The narrowest lobe, the better sampled of a mirror's and of one straight back, still has a hundredth of its peak at
    its eighth sample and at its second distinct angle.
    """
    above = (light[:, 2] > 0) & (view[:, 2] > 0)
    products = light[above] * view[above]
    if len(products) == 0:
        return SMALLEST_EXPONENT, 2 * SMALLEST_EXPONENT
    width = min(_width(products @ np.array(axis)) for axis in ((-1.0, -1.0, 1.0), (1.0, 1.0, 1.0)))
    largest = float(np.log(_LEFT) / np.log(np.cos(np.clip(width, 1e-3, 1.5))))
    return SMALLEST_EXPONENT, min(max(largest, 2 * SMALLEST_EXPONENT), _LARGEST_EXPONENT)


def _width(cosine: Float64) -> float:
    angles = np.sort(np.arccos(np.clip(cosine, -1.0, 1.0)))
    distinct = angles[angles > angles[0] + _DISTINCT_RAD]
    second = distinct[0] if len(distinct) else angles[-1]
    return float(max(angles[min(_NEAREST, len(angles)) - 1], second))
