"""BTFs with depths, of the ray-traced periodic samples, without noise: what a perfect capture would give a renderer."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.products import Btf, DirectionMesh, Mesostructure
from processing.svd import factor_btf
from simulators.far_field import btf_below, one_period
from simulators.far_field_truth import depths
from tests.benchmarks.yardsticks.btf_samples import PLANES_M
from tests.benchmarks.yardsticks.material_samples import rings

Array = NDArray[Any]

_KEPT = 8
_CODES = 255


def mesostructure(
    sample: str, seed: int, texels: int, lights: Array, views: Array, rank: int = 4, rays: int = 1
) -> Mesostructure:
    """One period of a sample, with as many rays to a texel's reflectance; kept for the next who asks for the same.

    Lights (n, 3) and views (m, 3) are unit vectors at most 80 deg from the normal. Depths are true to half a step of
    their 8-bit code. Texels lie on the plane that was found for the sample's BTF (`PLANES_M`), on other seeds. The
    terms are those of least error with the cosine inside: without it a few glints under low lights take them all, and
    a brick of 61 x 61 directions is drawn a quarter too dark with four.
    """
    return _mesostructure((sample, seed, texels, rank, rays), _hashable(lights), _hashable(views))


def polar_grid(azimuths: int, polar_deg: tuple[float, ...]) -> Array:
    """As many azimuths at each polar angle, as the paper's 12 x 5 and 12 x 8, and the top: (1 + n, 3)."""
    return rings(((0.0, 1), *((polar, azimuths) for polar in polar_deg)))


@lru_cache(maxsize=_KEPT)
def _mesostructure(
    which: tuple[str, int, int, int, int], lights: tuple[Any, ...], views: tuple[Any, ...]
) -> Mesostructure:
    sample, seed, texels, rank, rays = which
    ways, plane_m = (np.array(lights), np.array(views)), PLANES_M[sample]
    period_m = one_period(sample, seed, ways)[1]
    cosine = ways[0][:, 2].astype(np.float32).reshape(-1, 1, 1, 1, 1)
    lit = factor_btf(Btf(btf_below(sample, seed, ways, texels, rays, plane_m) * cosine, *ways), rank).btf
    factored = replace(lit, eigenmaps=lit.eigenmaps / cosine[:, 0])
    deep = depths(sample, seed, ways[1], texels, plane_m) / period_m
    step = float(np.nanmax(deep)) / _CODES
    codes = np.rint(np.nan_to_num(deep, nan=step * _CODES) / step).astype(np.uint8)
    return Mesostructure(factored, codes, step, DirectionMesh.from_directions(ways[1]), plane_m / period_m)


def _hashable(directions: Array) -> tuple[Any, ...]:
    return tuple(map(tuple, directions.tolist()))
