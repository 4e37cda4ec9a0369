"""How far pictures are from the truth where a relief shows most: along silhouettes, and along the edges of shadows."""

from collections.abc import Iterator
from typing import Any

import flip_evaluator
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from render.picture import Picture, encode_srgb8
from tests.benchmarks.yardsticks.displaced import TruePicture

Array = NDArray[Any]

BAND_PX = 8.0
_BEHIND = 0.18  # of white, behind the bodies: middle grey, before which lit and dark sides both stand out
_WHITE_PERCENTILE = 99.0  # of the true values; what lies above is clipped, as on a screen


def silhouette_band(true: TruePicture) -> Array:
    """Pixels (h, w) at most 8 px from where one body, or nothing, borders on another."""
    return _near(_borders(true.body))


def shadow_band(true: TruePicture) -> Array:
    """Pixels (h, w) of bodies at most 8 px from the edge of a shadow from afar, away from the silhouettes."""
    deep = np.where(np.isfinite(true.shadow), true.shadow > 0.5, -1)
    edge = np.zeros(deep.shape, bool)
    for one, two, pair in _neighbours(deep):
        for place in pair:
            edge[place] |= (one != two) & (one >= 0) & (two >= 0)
    return _near(edge) & ~silhouette_band(true) & (true.picture.coverage > 0.5) & np.isfinite(true.shadow)


def flip_map(true: Picture, other: Picture, behind: float = _BEHIND) -> Array:
    """FLIP (h, w) of two pictures shown with the same white, the true one's, before the same grey."""
    lit = true.radiance[true.coverage > 0.5]
    white = max(float(np.percentile(lit.max(axis=1), _WHITE_PERCENTILE)), 1e-12)
    shown = (_shown(picture, white, behind) for picture in (true, other))
    return np.asarray(flip_evaluator.evaluate(*shown, "LDR", applyMagma=False)[0])[..., 0]


def mask_iou(true: Picture, other: Picture) -> float:
    """Pixels that both show, over those that one of them shows."""
    one, two = true.coverage > 0.5, other.coverage > 0.5
    return float((one & two).sum() / max((one | two).sum(), 1))


def _shown(picture: Picture, white: float, behind: float) -> Array:
    over = picture.radiance / white + (1.0 - picture.coverage[..., None]) * behind
    return np.asarray(encode_srgb8(over) / np.float32(255.0), np.float32)


def _borders(numbers: Array) -> Array:
    """Pixels (h, w) one of whose neighbours to the right and below has another number, and those neighbours."""
    edge = np.zeros(numbers.shape, bool)
    for one, two, pair in _neighbours(numbers):
        for place in pair:
            edge[place] |= one != two
    return edge


def _near(edge: Array) -> Array:
    """Pixels at most `BAND_PX` from an edge."""
    if not edge.any():
        return np.zeros(edge.shape, bool)
    return np.asarray(distance_transform_edt(~edge) <= BAND_PX)


_Pair = tuple[tuple[slice, slice], tuple[slice, slice]]


def _neighbours(values: Array) -> Iterator[tuple[Array, Array, _Pair]]:
    """Values of pixels and of their neighbours, right and then below, with where both stand."""
    whole, first, second = slice(None), slice(None, -1), slice(1, None)
    for pair in (((whole, first), (whole, second)), ((first, whole), (second, whole))):
        yield values[pair[0]], values[pair[1]], pair
