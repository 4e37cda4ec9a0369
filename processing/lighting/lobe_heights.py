"""How fine the directions of light have to be told apart for a lobe: nodes as high as one value of it serves."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from processing.lighting.directions import HEIGHT
from processing.products.arrays import Float64

BINS = 256  # of sqrt(1 - N.H), the half angle's half sine but for a factor
HIGHEST = 8  # 256 directions, 14 deg across: the cosine and what moves at the horizon bend the rest
_GRAZING_RAD = 1.3  # half angles from there, where light and eye are low on one side, are as those before
_TOLERANCE = 0.03  # of the lobe's mean over the node


def node_heights(profile: Callable[[Float64], Float64]) -> NDArray[np.uint8]:
    """Heights (BINS,) by half angle; `profile` gives the lobe over half angles (n,) in rad.

    A node of angular radius r moves the half vector by about r / 2. It may stand where, anywhere within r of it, the
    mean of the lobe over +-r / 2 differs from its middle by no more than a share of what is there, or of a thousandth
    of the peak; and closer to the peak no node is higher than further off.
    """
    angles = np.arccos(1 - (np.arange(BINS) / (BINS - 1)) ** 2)
    found = np.zeros(BINS, np.uint8)
    fine = np.linspace(-0.6, 2.2, 2801)
    values = profile(np.abs(fine))
    least = 0.02 * values.max()
    for height in range(HIGHEST, 0, -1):
        radius = np.sqrt(4 * np.pi / 2**HEIGHT * 2**height / np.pi)
        sides = [np.interp(fine + side * radius / 2, fine, values) for side in (-0.8, 0.8)]
        good = np.abs(sum(sides) / 2 - values) <= _TOLERANCE * np.maximum(values, least)
        wrong = np.concatenate([[0], np.cumsum(~good)])
        low, high = (np.searchsorted(fine, angles + side * radius / 2) for side in (-1, 1))
        serves = wrong[np.minimum(high, len(fine))] == wrong[low]
        found = np.where((found == 0) & serves, np.uint8(height), found)
    found[angles > _GRAZING_RAD] = found[angles <= _GRAZING_RAD][-1]
    return np.asarray(np.minimum.accumulate(found[::-1])[::-1], np.uint8)
