"""Where the fits of Lafortune lobes begin, and how narrow a lobe the samples can tell."""

import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float64

SMALLEST_EXPONENT = 0.5  # a broader lobe imitates the diffuse term
_LARGEST_EXPONENT = 1e4
_LEFT = 0.01  # of a lobe's peak at its second nearest samples: a narrower one would be told by its peak alone
_NEAREST = 8  # samples in a lobe
_DISTINCT_RAD = 1e-2
_PEAKS = (np.array([-1.0, -1.0, 1.0]), np.array([1.0, 1.0, 1.0]))  # C of a mirror, and straight back
_MORE, _NEAR_RAD = 20.0, np.radians(16.0)

_HEIGHTS, _EXPONENTS = (0.3, 0.6, 1.0), (1.5, 4.0, 10.0, 25.0, 70.0)
_STEEP, _STEEP_EXPONENTS = 0.6, (2.0, 8.0, 30.0)  # |C_x| = |C_y| where C_z is 1
_UPRIGHT_EXPONENTS = (1.0, 2.0, 4.0, 15.0)
_ASKEW, _ASKEW_EXPONENTS = ((1.0, 0.75), (0.75, 1.0)), (4.0, 25.0)  # |C_x| and |C_y|
_ASKEW_HEIGHTS = (0.4, 0.9)
_SHARED = ((-1.0, 1.0), (-1.0, 0.6), (1.0, 0.8), (0.0, 1.0))  # C_x = C_y, C_z
_SHARED_EXPONENTS = (2.0, 10.0, 50.0)


def candidate_lobes() -> Float64:
    """Lobes (k, 4) as C and log n, forward, back and up, k a multiple of four: one is near any that samples tell."""
    lobes = []
    for across in (-1.0, 1.0):
        lobes += [(across, across, height, n) for height in _HEIGHTS for n in _EXPONENTS]
        lobes += [(across * _STEEP, across * _STEEP, 1.0, n) for n in _STEEP_EXPONENTS]
        lobes += [(across * x, across * y, z, n) for x, y in _ASKEW for z in _ASKEW_HEIGHTS for n in _ASKEW_EXPONENTS]
    lobes += [(0.0, 0.0, 1.0, n) for n in _UPRIGHT_EXPONENTS]
    return _with_logarithm(np.array(lobes))


def shared_starts(lobes: int) -> Float64:
    """Starts (k, j, 4) as C and log n whose lobes have one C."""
    return _with_logarithm(
        np.array([[(a, a, z, n) for n in _SHARED_EXPONENTS[:lobes]] for a, z in _SHARED], np.float64)
    )


def _with_logarithm(lobes: Float64) -> Float64:
    return np.concatenate([lobes[..., :3], np.log(lobes[..., 3:])], axis=-1)


def mixed_order(light: Float64, view: Float64) -> NDArray[np.int64]:
    """An order of samples (s,) of which any first part is a fair choice, with more of where narrow lobes peak.

    That is by drawing without putting back (Efraimidis and Spirakis 2006), always the same for the same directions.
    """
    angle = np.minimum(*(np.arccos(np.clip((light * view) @ axis, -1.0, 1.0)) for axis in _PEAKS))
    weight = 1.0 + _MORE * np.exp(-((angle / _NEAR_RAD) ** 2))
    return np.argsort(-(np.random.default_rng(0).random(len(weight)) ** (1.0 / weight)), kind="stable")


def exponent_bounds(light: Float64, view: Float64) -> tuple[float, float]:
    """Range of exponents that samples under these directions (s, 3) can tell apart.

    The narrowest lobe, the better sampled of a mirror's and of one straight back, still has a hundredth of its peak at
    its eighth sample, and at the second distinct angle to its peak under the median light.
    """
    above = (light[:, 2] > 0) & (view[:, 2] > 0)
    if not above.any():
        return SMALLEST_EXPONENT, 2 * SMALLEST_EXPONENT
    group = np.unique(np.round(light[above], 4), axis=0, return_inverse=True)[1].reshape(-1)
    products = light[above] * view[above]
    width = min(_width(np.arccos(np.clip(products @ axis, -1.0, 1.0)), group) for axis in _PEAKS)
    largest = float(np.log(_LEFT) / np.log(np.cos(np.clip(width, 1e-3, 1.5))))
    return SMALLEST_EXPONENT, min(max(largest, 2 * SMALLEST_EXPONENT), _LARGEST_EXPONENT)


def _width(angle: Float64, group: NDArray[np.intp]) -> float:
    """Angle from the peak at which samples tell how narrow a lobe is."""
    ordered = np.sort(angle)
    nearest = np.full(group.max() + 1, np.inf)
    np.minimum.at(nearest, group, angle)
    second = np.full(len(nearest), np.inf)
    beyond = angle > nearest[group] + _DISTINCT_RAD
    np.minimum.at(second, group[beyond], angle[beyond])
    second = second[np.isfinite(second)]
    apart = float(np.median(second)) if len(second) else float(ordered[-1])
    return max(float(ordered[min(_NEAREST, len(ordered)) - 1]), apart)
