"""Mesostructures by formula, with the depths of their rays found by stepping along them."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from processing.products import FactoredBtf, Mesostructure
from tests.render.synthetic import bricks

Profile = Callable[[np.ndarray], np.ndarray]


def level(depth: float, texels: int = 4) -> Mesostructure:
    """A sample whose surface lies everywhere at one depth."""
    return relief(lambda uv: np.full(len(uv), depth), texels, deepest=depth or 1.0)


def relief(profile: Profile, texels: int, deepest: float, plane: float = 0.0, steps: int = 400) -> Mesostructure:
    """The sample whose surface lies `profile(uv)` under the reference plane, between 0 and `deepest`, 255 codes deep.

    The texels' values are of the ray through each one's middle, stepped along until it is under the surface.
    """
    btf = _btf(texels)
    middle = (np.arange(texels) + 0.5) / texels
    uv = np.stack(np.meshgrid(middle, middle), axis=-1).reshape(-1, 2)
    depths = np.stack([first_depth(profile, uv, view, deepest, plane, steps) for view in btf.views.directions])
    codes = np.rint(depths / deepest * 255).astype(np.uint8).reshape(-1, texels, texels)
    return Mesostructure(btf, codes, deepest / 255, btf.views, plane)


@lru_cache
def _btf(texels: int) -> FactoredBtf:
    return bricks(texels)


def first_depth(profile: Profile, uv: np.ndarray, view: np.ndarray, deepest: float, plane: float, steps: int):
    """Depth (n,) of what rays toward `view` (3,) meet first, which cross the plane at depth `plane` in `uv` (n, 2)."""
    along = view[:2] / view[2] * [-1.0, 1.0]
    found = np.full(len(uv), deepest)
    for depth in np.linspace(deepest, 0.0, steps):
        under = profile((uv + (depth - plane) * along) % 1.0) <= depth
        found[under] = depth
    return found


def step(high: float = 0.0, low: float = 0.2) -> Profile:
    """A wall along v: the left half of the tile lies at `high`, the right one at `low`."""
    return lambda uv: np.where(uv[:, 0] % 1.0 < 0.5, high, low)


def waves(deepest: float = 0.1) -> Profile:
    """A smooth egg tray."""
    return lambda uv: deepest * (0.5 + 0.25 * (np.cos(2 * np.pi * uv[:, 0]) + np.cos(2 * np.pi * uv[:, 1])))
