"""Lobes times one shadow per light (STVS), both of least squared error over all the views."""

from dataclasses import dataclass, replace

import numpy as np

from processing.products.arrays import Float32, Float64
from processing.sbrdf.lafortune import LafortuneFit, fit_lafortune, lafortune_values
from processing.sbrdf.shadow_kernel import light_sums
from processing.sbrdf.shadows import either
from processing.sbrdf.supported import Support, supported
from processing.threads import in_parts

_PART = 16  # texels that a thread takes at a time
_FAINTEST = 0.02  # a light whose shadow is darker tells nothing of the lobes


@dataclass(frozen=True, eq=False)
class Views:
    """Values (t, light, view, 3) of texels, how much each counts (t, light, view), and the directions (n, 3).

    A missing value counts 0.
    """

    values: Float32
    weight: Float32
    light_directions: Float64
    view_directions: Float64

    def pairs(self) -> tuple[Float64, Float64]:
        """Light and view (light * view, 3) of a texel's values."""
        lights, views = self.light_directions, self.view_directions
        return np.repeat(lights, len(views), axis=0), np.tile(views, (len(lights), 1))

    def part(self, some: slice) -> "Views":
        """Some of the texels."""
        return Views(self.values[some], self.weight[some], self.light_directions, self.view_directions)


@dataclass(frozen=True, eq=False)
class ShadedLobes:
    """`lobes` of t texels and their `shadow` (t, light) in 0 to 1, the same for all views."""

    lobes: LafortuneFit
    shadow: Float32

    def seen_along(self, light: Float64, view: Float64) -> Float32:
        """Values (t, light, 3) under all lights (n, 3) toward one view (3,)."""
        values = lafortune_values(self.lobes, light, np.broadcast_to(view, light.shape))
        values *= self.shadow[..., None]
        return values

    @classmethod
    def joined(cls, parts: list["ShadedLobes"]) -> "ShadedLobes":
        """The texels of several, one after another."""
        return cls(LafortuneFit.joined([p.lobes for p in parts]), np.concatenate([p.shadow for p in parts]))


def fit_shaded(seen: Views, start: LafortuneFit, rounds: int) -> ShadedLobes:
    """Lobes and shadows in turns, from lobes that leave shadows out, so that lobes are what the light can reach.

    Each half-step is a least-squares fit, of lobes that the values bear out; a texel whose squared error a round does
    not lower keeps what it has, so the error never rises. A light without any weight is not shadowed.
    """

    def part(first: int, stop: int) -> ShadedLobes:
        some = slice(first, stop)
        return _fit_shaded(seen.part(some), start.chosen(some), rounds)

    return ShadedLobes.joined(in_parts(part, len(seen.values), _PART))


def _fit_shaded(seen: Views, start: LafortuneFit, rounds: int) -> ShadedLobes:
    light, view = seen.pairs()
    support = Support.of(seen.values.reshape(len(seen.values), -1, 3), light, view)
    best, shadow, error = start, *_best_shadow(seen, lafortune_values(start, light, view))
    error = np.where(support.exceeded(start), np.inf, error)
    for _ in range(rounds):
        lobes = _refitted(seen, best, shadow, support)
        new, lower = _best_shadow(seen, lafortune_values(lobes, light, view))
        worse = ~(lower < error)
        best = either(best, lobes, worse)
        shadow = np.where(worse[:, None], shadow, new)
        error = np.where(worse, error, lower)
    return _brightest_as_one(best, shadow)


def _brightest_as_one(lobes: LafortuneFit, shadow: Float32) -> ShadedLobes:
    """The same product; eight bits of a shadow are best used where the brightest light has 1."""
    level = shadow.max(axis=1, keepdims=True)
    level = np.where(level > 0, level, np.float32(1))
    brighter = replace(lobes, diffuse=lobes.diffuse * level, albedo=lobes.albedo * level[..., None])
    return ShadedLobes(brighter, np.asarray(shadow / level, np.float32))


def _best_shadow(seen: Views, drawn: Float32) -> tuple[Float32, Float64]:
    """Shadow (t, light) of least squared error, and that error (t,)."""
    sums = np.empty((*seen.weight.shape[:2], 3))
    light_sums(seen.values, seen.weight, drawn.reshape(seen.values.shape), sums)
    energy, cross, square = np.moveaxis(sums, -1, 0)
    best = np.divide(cross, square, out=np.zeros_like(cross), where=square > 0)
    best = np.where(seen.weight.any(axis=2), np.clip(best, 0, 1), 1.0)
    error: Float64 = (energy - 2 * best * cross + best * best * square).sum(axis=1)
    return best.astype(np.float32), error


def _refitted(seen: Views, start: LafortuneFit, shadow: Float32, support: Support) -> LafortuneFit:
    """Lobes whose product with the shadow is nearest to the values: of values over shadow, that much less certain."""
    ways, texels = seen.pairs(), len(shadow)
    level = np.where(shadow > _FAINTEST, shadow, np.float32(np.nan))[:, :, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = (seen.weight * level * level).reshape(texels, -1)
        values = np.where(seen.weight[..., None] > 0, seen.values / level[..., None], np.float32(np.nan))
    values = values.reshape(texels, -1, 3)
    with np.errstate(divide="ignore"):
        fit = fit_lafortune(values, *ways, start=start, variance=1 / weight)
    return supported(fit, values, ways, support, weight)
