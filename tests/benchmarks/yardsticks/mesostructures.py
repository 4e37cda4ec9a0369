"""BTFs with depths, of the ray-traced periodic samples, without noise: what a perfect capture would give a renderer."""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.highlights import white_of
from processing.products import Btf, DirectionMesh, Mesostructure
from processing.svd import Colour, factor_btf
from simulators.far_field import btf_below, one_period
from simulators.far_field_truth import depths
from tests.benchmarks.yardsticks.btf_samples import PLANES_M
from tests.benchmarks.yardsticks.material_samples import rings

Array = NDArray[Any]
_Ways = tuple[tuple[float, ...], ...]

_KEPT = 8
_CODES = 255


def mesostructure(
    sample: str,
    seed: int,
    texels: int,
    lights: Array,
    views: Array,
    rank: int = 4,
    rays: int = 1,
    colour: Colour = "colour",
) -> Mesostructure:
    """One period of a sample, with as many rays to a texel's reflectance; kept for the next who asks for the same.

    Lights (n, 3) and views (m, 3) are unit vectors at most 80 deg from the normal. Depths are true to half a step of
    their 8-bit code. Texels lie on the plane that was found for the sample's BTF (`PLANES_M`), on other seeds.
    Glints are no brighter than white, as in joined products.
    """
    return _mesostructure((sample, seed, texels, rays), (_hashable(lights), _hashable(views)), rank, colour)


def polar_grid(azimuths: int, polar_deg: tuple[float, ...]) -> Array:
    """As many azimuths at each polar angle, as the paper's 12 x 5 and 12 x 8, and the top: (1 + n, 3)."""
    return rings(((0.0, 1), *((polar, azimuths) for polar in polar_deg)))


@lru_cache(maxsize=_KEPT)
def _mesostructure(
    which: tuple[str, int, int, int], ways: tuple[_Ways, _Ways], rank: int, colour: Colour
) -> Mesostructure:
    sample, seed = which[:2]
    lit, deep = _measured(which, ways)
    step = float(np.nanmax(deep)) / _CODES
    codes = np.rint(np.nan_to_num(deep, nan=step * _CODES) / step).astype(np.uint8)
    plane = PLANES_M[sample] / one_period(sample, seed, (lit.light_directions, lit.view_directions))[1]
    mesh = DirectionMesh.from_directions(lit.view_directions)
    return Mesostructure(factor_btf(lit, rank, colour, white_of(lit)).btf, codes, step, mesh, plane)


@lru_cache(maxsize=2)
def _measured(which: tuple[str, int, int, int], ways: tuple[_Ways, _Ways]) -> tuple[Btf, Array]:
    """The BTF, and depths in periods."""
    sample, seed, texels, rays = which
    lights, views = map(np.array, ways)
    plane_m, period_m = PLANES_M[sample], one_period(sample, seed, (lights, views))[1]
    values = btf_below(sample, seed, (lights, views), texels, rays, plane_m)
    return Btf(values, lights, views), depths(sample, seed, views, texels, plane_m) / period_m


def _hashable(directions: Array) -> _Ways:
    return tuple(map(tuple, directions.tolist()))
