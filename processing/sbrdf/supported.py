"""Lobes that stay near what was measured, also between the measured directions.

A lobe whose peak no sample saw is told by its foot alone: it fits the samples, and is a thousand times brighter between
them. The sparser the directions, the more lobes do so.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32, Float64
from processing.sbrdf.lafortune import LafortuneFit, lafortune_values

MOST = 2.0  # times the brightest sample of a texel
_RINGS_DEG, _AROUND = 15.0, 6  # directions that are tried: each ring has six more than the one inside
_LOWEST_DEG = 80.0
_PEAKS, _TEXELS = 64, 64  # lobes, texels at a time
_ROUNDING = 1.0001
_SWEEPS = 100  # of coordinate descent over the four levels of a texel


@dataclass(frozen=True, eq=False)
class Support:
    """What the samples of texels bear out: reflectance of a lobe up to `most` (t,), asked at `pairs` L V (n, 3)."""

    most: Float32
    pairs: Float32

    @classmethod
    def of(cls, values: Float32, light: Float64, view: Float64) -> "Support":
        """Twice the brightest of the samples (t, s, 3), on rings down to the lowest measured light and view.

        Beyond these nobody asks. What is not finite is left out.
        """
        cosine = np.where((light[:, 2] > 0) & (view[:, 2] > 0), light[:, 2], np.nan).astype(np.float32)
        brightest = np.maximum(np.maximum(values[..., 0], values[..., 1]), values[..., 2]) / cosine
        most = np.max(brightest, axis=1, initial=0, where=np.isfinite(brightest))
        return cls(MOST * most, _asked(_lowest_deg(light), _lowest_deg(view)))

    def limits(self, fit: LafortuneFit) -> Float64:
        """Largest albedo (t, lobe) of each lobe; inf where it is dark at all pairs."""
        axis = fit.axis.reshape(-1, 3)
        base = np.empty(len(axis), np.float32)
        for start in range(0, len(axis), _PEAKS):
            some = slice(start, start + _PEAKS)
            base[some] = (axis[some] @ self.pairs.T).max(axis=1)
        peaks = np.clip(base, 0, None).reshape(fit.exponent.shape).astype(np.float64) ** fit.exponent
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            return np.where(peaks > 0, self.most[:, None] / peaks, np.inf)

    def exceeded(self, fit: LafortuneFit) -> NDArray[np.bool_]:
        """Which texels (t,) have a lobe that is brighter than that."""
        exceeded: NDArray[np.bool_] = (fit.albedo.max(axis=2) > _ROUNDING * self.limits(fit)).any(axis=1)
        return exceeded


def supported(
    fit: LafortuneFit,
    values: Float32,
    ways: tuple[Float64, Float64],
    support: Support,
    weight: Float32 | None = None,
) -> LafortuneFit:
    """The fit to `values` (t, s, 3), no lobe of which is brighter than the support of the texels allows.

    The albedos and diffuse terms of texels with a brighter lobe are those of least squared error under that limit, for
    the lobes' shapes as they are. `ways` are light and view (s, 3); `weight` (t, s) is what each sample counts, 0 or a
    value that is not finite leaves it out.
    """
    limits, wild = support.limits(fit), np.flatnonzero(support.exceeded(fit))
    diffuse, albedo, cost = fit.diffuse.copy(), fit.albedo.copy(), fit.cost.copy()
    for start in range(0, len(wild), _TEXELS):
        some = wild[start : start + _TEXELS]
        own = np.ones(values[some].shape[:2], np.float32) if weight is None else weight[some]
        sums = _sums(fit.chosen(some), values[some], ways, own)
        levels, cost[some] = _levels(sums, limits[some], fit.chosen(some))
        diffuse[some], albedo[some] = levels[:, 0], levels[:, 1:]
    return replace(fit, diffuse=diffuse, albedo=albedo, cost=cost)


def _sums(fit: LafortuneFit, values: Float32, ways: tuple[Float64, Float64], weight: Float32) -> Float64:
    """Weighted inner products (t, 4 + j, 4 + j) of the diffuse term, the lobes and the channels, over 3 x samples."""
    texels, lobes = fit.exponent.shape
    known = np.isfinite(values.sum(axis=2)) & np.isfinite(weight) & (weight > 0)
    alone = np.zeros((texels, lobes, 3), np.float32)
    alone[:, np.arange(lobes), np.arange(lobes)] = 1  # each channel shows one lobe
    shapes = replace(fit, diffuse=np.zeros((texels, 3), np.float32), albedo=alone)
    above = np.where((ways[0][:, 2] > 0) & (ways[1][:, 2] > 0), ways[0][:, 2], 0)
    columns = np.empty((*values.shape[:2], 4 + lobes))
    columns[..., 0], columns[..., 1 : 1 + lobes] = above, lafortune_values(shapes, *ways)[..., :lobes]
    columns[..., 1 + lobes :] = np.where(known[..., None], values, 0)
    columns *= np.sqrt(np.where(known & (above > 0), weight, 0), dtype=np.float64)[..., None]
    count = np.maximum((known & (above > 0)).sum(axis=1), 1)
    found: Float64 = np.swapaxes(columns, 1, 2) @ columns / (3 * count[:, None, None])
    return found


def _levels(sums: Float64, limits: Float64, fit: LafortuneFit) -> tuple[Float32, NDArray[np.floating]]:
    """Diffuse terms and albedos (t, 1 + j, 3) of least squares between 0 and the limits, and the error (t,)."""
    terms = 1 + limits.shape[1]
    gram, wanted = sums[:, :terms, :terms], sums[:, :terms, terms:]
    most = np.concatenate([np.full((len(limits), 1), np.inf), limits], axis=1)[..., None]
    levels = np.minimum(np.concatenate([fit.diffuse[:, None], fit.albedo], axis=1).astype(np.float64), most)
    for _ in range(_SWEEPS):
        for p in range(terms):
            square = gram[:, p, p, None]
            rest = wanted[:, p] - np.einsum("tq,tqc->tc", gram[:, p], levels) + square * levels[:, p]
            best = np.divide(rest, square, out=np.zeros_like(rest), where=square > 0)
            levels[:, p] = np.clip(best, 0, most[:, p])
    squares = np.einsum("tcc->t", sums[:, terms:, terms:])
    error = squares + ((gram @ levels - 2 * wanted) * levels).sum(axis=(1, 2))
    return levels.astype(np.float32), np.maximum(error, 0)


def _lowest_deg(measured: Float64) -> float:
    """Angle from the normal to the lowest of the directions (n, 3) above the horizon."""
    above = measured[measured[:, 2] > 0, 2]
    return min(float(np.degrees(np.arccos(above.min()))) if len(above) else 0.0, _LOWEST_DEG)


@lru_cache(maxsize=4)
def _asked(light_deg: float, view_deg: float) -> Float32:
    """Products L V (n, 3) of lights and views on rings down to these angles, each once."""
    pairs = (_rings(light_deg)[:, None] * _rings(view_deg)).reshape(-1, 3).astype(np.float32)
    return np.ascontiguousarray(np.unique(pairs.round(5), axis=0))


def _rings(lowest_deg: float) -> Float64:
    """Directions (n, 3) on rings from the normal to the lowest."""
    found = [np.array([[0.0, 0.0, 1.0]])]
    for ring in range(1, int(np.ceil(lowest_deg / _RINGS_DEG)) + 1):
        polar = np.radians(min(ring * _RINGS_DEG, lowest_deg))
        azimuth = 2 * np.pi * np.arange(_AROUND * ring) / (_AROUND * ring)
        up = np.full_like(azimuth, np.cos(polar))
        found.append(np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), up], axis=1))
    return np.concatenate(found)
