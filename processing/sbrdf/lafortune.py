"""Lafortune lobes of many texels from their samples, fitted in parallel."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from processing.errors import ImageError
from processing.products.arrays import Float32, Float64
from processing.products.lafortune import LafortuneTexels
from processing.sbrdf.lafortune_batch import fit_texels
from processing.sbrdf.lafortune_kernel import BLOCK, values_of
from processing.sbrdf.lafortune_starts import candidate_lobes, exponent_bounds, mixed_order, shared_starts
from processing.threads import in_parts

_PART = 16  # texels that a thread takes at a time
_MOST_LOBES = 3


class LobeLayout(StrEnum):
    """What the channels and lobes of a texel share."""

    FULL = "full"  # 24 floats: the diffuse, and of each lobe C, n and the albedo
    SHARED = "shared"  # the paper's 16: one C and one grey diffuse, and of each lobe n and the albedo


class FitStatus(IntEnum):
    """How the fit of a texel ended."""

    CONVERGED = 0  # the cost no longer falls
    AT_BOUND = 1  # an exponent rests on its bound: the samples do not tell how narrow, or broad, the lobe is
    TOO_FEW_SAMPLES = 2  # fewer than two valid samples per function: the diffuse alone
    DIVERGED = 3  # no finite cost, as for values at the end of the number range
    STOPPED = 4  # the cost still fell when the rounds ran out


@dataclass(frozen=True, eq=False)
class LafortuneFit:
    """Lobes of texels as `LafortuneTexels` has them, in float32: the largest |C_i| is 1; absent: C = 0, n = 1, rho = 0.

    `diffuse` (t, 3), `axis` (t, lobe, 3), `exponent` (t, lobe), `albedo` (t, lobe, 3) in the values' unit; `status`
    (t,) int8 of `FitStatus`; `cost` (t,) float32 is the mean squared error per value, over its variance where that is
    given; `iterations` (t,) int32 counts evaluations, those on a part of the samples among them.
    """

    diffuse: Float32
    axis: Float32
    exponent: Float32
    albedo: Float32
    status: NDArray[np.int8]
    cost: Float32
    iterations: NDArray[np.int32]

    def texels(self, height: int, width: int, scale: float = 1.0) -> LafortuneTexels:
        """The product of height x width texels, rows first, in 1/sr; `scale` is that of a value of 1."""
        diffuse, albedo = (np.asarray(one * np.float32(scale), np.float32) for one in (self.diffuse, self.albedo))
        fields = (diffuse, self.axis, self.exponent, albedo)
        return LafortuneTexels(*(one.reshape(height, width, *one.shape[1:]) for one in fields))

    def chosen(self, index: NDArray[Any] | slice) -> "LafortuneFit":
        """Some of the texels."""
        return LafortuneFit(*(one[index] for one in self._fields()))

    @classmethod
    def joined(cls, fits: Sequence["LafortuneFit"]) -> "LafortuneFit":
        """The texels of several fits, one after another."""
        return cls(*(np.concatenate(same) for same in zip(*(fit._fields() for fit in fits), strict=True)))

    def _fields(self) -> tuple[NDArray[Any], ...]:
        return self.diffuse, self.axis, self.exponent, self.albedo, self.status, self.cost, self.iterations


def fit_lafortune(  # noqa: PLR0913 - four that are named, each a choice of its own
    values: Float32,
    light: Float64,
    view: Float64,
    *,
    lobes: int = 3,
    layout: LobeLayout = LobeLayout.FULL,
    start: LafortuneFit | None = None,
    variance: ArrayLike | None = None,
) -> LafortuneFit:
    """Weighted least squares of rho_d + sum_j rho_j (C_j . (L V))^n_j, times the cosine to the light, for each texel.

    `values` (t, s, 3) have the cosine inside; a sample with a channel that is not finite is left out, as is one whose
    light or view is not above; `light`, `view` (s, 3) are unit vectors. `variance` (s,) or (t, s), shared by the
    channels, weighs samples; without it all count alike. `start` saves the search of the lobes (those absent stay
    so). Albedos are >= 0; n lies within `exponent_bounds`; a lobe whose gain is not worth its parameters is absent.
    Never raises because of a texel, see `LafortuneFit.status`; ImageError where shapes disagree or `lobes` is not 1
    to 3. Source: Lafortune et al. 1997; McAllister et al. 2002.
    """
    values = np.require(values, np.float32, ["C", "W"])  # kernels are compiled for such arrays alone
    _check(values, light, view, lobes)
    if start is not None and start.exponent.shape != (len(values), lobes):
        raise ImageError(f"a start for {len(values)} texels of {lobes} lobes is needed, not {start.exponent.shape}")
    texels = len(values)
    weighed = _variance(variance, values.shape[:2])
    order, bounds = _order_and_bounds(*(np.asarray(one, np.float64).tobytes() for one in (light, view)))
    known = (_products(light, view), order)
    settings = (layout is LobeLayout.SHARED, *bounds)
    starts = shared_starts(lobes) if layout is LobeLayout.SHARED else candidate_lobes()[:, None]
    warm = _packed(start) if start is not None else np.empty((0, lobes, 4))
    shapes, albedos, cost = np.empty((texels, lobes, 4)), np.empty((texels, 3, 1 + lobes)), np.empty(texels)
    status, rounds = np.empty(texels, np.int8), np.empty(texels, np.int32)

    def part(first: int, stop: int) -> None:
        some = slice(first, stop)
        own = weighed[some] if len(weighed) > 1 else weighed
        mine = (shapes[some], albedos[some], cost[some], status[some], rounds[some])
        fit_texels(values[some], own, known, settings, (starts, warm[some]), mine)

    in_parts(part, texels, _PART)
    return _unpacked(shapes, albedos, cost, status, rounds)


def lafortune_values(fit: LafortuneFit, light: Float64, view: Float64) -> Float32:
    """Values (t, s, 3) of the lobes with the cosine inside, for unit vectors (s, 3); 0 under the horizon."""
    texels, lobes = fit.exponent.shape
    products = _products(light, view)
    count = products.shape[1]
    blocks = np.zeros((-(-count // BLOCK), 4, BLOCK), np.float32)
    for k in range(4):
        padded = np.zeros(blocks.shape[0] * BLOCK, np.float32)
        padded[:count] = products[k]
        blocks[:, k] = padded.reshape(-1, BLOCK)
    shapes, weights = np.zeros((texels, 3, 4), np.float32), np.zeros((texels, 4, 3), np.float32)
    shapes[:, :lobes, :3], shapes[:, :lobes, 3] = fit.axis, fit.exponent
    weights[:, 0], weights[:, 1 : 1 + lobes] = fit.diffuse, fit.albedo
    out, flat = np.empty((texels, count, 3), np.float32), blocks.reshape(-1)
    rows = out.reshape(texels, -1)

    def part(first: int, stop: int) -> None:
        values_of(flat, weights[first:stop], shapes[first:stop], rows[first:stop])

    in_parts(part, texels, _PART)
    return out


def _check(values: Float32, light: Float64, view: Float64, lobes: int) -> None:
    if values.ndim != 3 or values.shape[2] != 3 or not ((*values.shape[1:2], 3) == light.shape == view.shape):
        shapes = f"values {values.shape}, light {light.shape}, view {view.shape}"
        raise ImageError(f"samples of texels are (t, s, 3) under lights and views (s, 3); here {shapes}")
    if not 1 <= lobes <= _MOST_LOBES:
        raise ImageError(f"one to {_MOST_LOBES} lobes can be fitted, not {lobes}")


@lru_cache(maxsize=4)
def _order_and_bounds(light: bytes, view: bytes) -> tuple[NDArray[np.int64], tuple[float, float]]:
    """Order of the samples, and bounds of log n; texels are fitted a few at a time, all under the same directions."""
    ways = [np.frombuffer(one).reshape(-1, 3) for one in (light, view)]
    low, high = np.log(exponent_bounds(ways[0], ways[1])).tolist()
    return mixed_order(ways[0], ways[1]), (low, high)


def _variance(variance: ArrayLike | None, shape: tuple[int, ...]) -> Float32:
    """(1, 0) without one, (1, s) for all texels, or (t, s)."""
    if variance is None:
        return np.empty((1, 0), np.float32)
    own = np.atleast_2d(np.asarray(variance, np.float32))
    if own.shape[1] != shape[1] or len(own) not in (1, shape[0]):
        raise ImageError(
            f"the variance is (s,) or (t, s), here {own.shape} for {shape[0]} texels of {shape[1]} samples"
        )
    return np.require(own, np.float32, ["C", "W"])


def _products(light: Float64, view: Float64) -> Float32:
    """L_i V_i and the cosine to the light, 0 where light or view is not above: (4, s)."""
    light, view = np.asarray(light, np.float64), np.asarray(view, np.float64)
    above = (light[:, 2] > 0) & (view[:, 2] > 0)
    return np.concatenate([(light * view).T, np.where(above, light[:, 2], 0.0)[None]]).astype(np.float32)


def _packed(fit: LafortuneFit) -> Float64:
    """C and log n (t, j, 4), C = 0 where a lobe is absent."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.concatenate([fit.axis, np.log(fit.exponent)[..., None]], axis=2).astype(np.float64)


def _unpacked(
    shapes: Float64, albedos: Float64, cost: Float64, status: NDArray[np.int8], rounds: NDArray[np.int32]
) -> LafortuneFit:
    axis = shapes[..., :3].astype(np.float32)
    exponent = np.exp(shapes[..., 3]).astype(np.float32)
    diffuse = np.ascontiguousarray(albedos[..., 0]).astype(np.float32)
    albedo = np.ascontiguousarray(np.swapaxes(albedos[..., 1:], 1, 2)).astype(np.float32)
    finite = np.minimum(cost, np.finfo(np.float32).max).astype(np.float32)  # of values beyond 1e19
    return LafortuneFit(diffuse, axis, exponent, albedo, status, finite, rounds)
