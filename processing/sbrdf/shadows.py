"""Samples in shadow: what lies far below the lobes of a texel, found in rounds that fit the lobes to the rest.

Source: Chen et al. 2008, sections 2.1 and 2.2. Its thresholds, Error = (SBRDF - BTF) / BTF > 0.3 and BTF < 0.3, take
every sample at less than three quarters of the lobes for a shadow, among them many that only face the light less than
the lobes say. A cast shadow lies far below that: the ratios BTF / SBRDF of a material have a peak near what is left of
the light in its shadows, and the threshold is that peak's upper foot.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32, Float64
from processing.sbrdf.lafortune import FitStatus, LafortuneFit, fit_lafortune, lafortune_values

Mask = NDArray[np.bool_]

ROUNDS = 3
_HIGHEST = 0.3  # of the lobes: above nothing is a shadow
_BINS = 60  # of the ratios up to there
_FOOT = 2.0  # times the emptiest bin beyond the peak
# Of the material's mean texel: darker lobes are taken to be as bright, so that a texel which no light reaches is in
# shadow rather than black.
_DARKEST = 0.02


class ShadowStatus(IntEnum):
    """How the shadow rounds of a texel ended."""

    FOUND = 0
    KEPT = 1  # too few samples were left outside the shadows: the lobes are those of the round before


@dataclass(frozen=True, eq=False)
class Darkness:
    """What counts as shadow in a material: mean values under `share` of the lobes or of `least` (s,), the larger."""

    share: float
    least: Float32

    def shadowed(self, values: Float32, drawn: Float32) -> Mask:
        """Which samples (t, s) lie in shadow, of values (t, s, 3) and those of their lobes; missing ones do not."""
        lobes = np.maximum(_grey(drawn), self.least)
        with np.errstate(invalid="ignore"):
            return np.asarray(_grey(values) < np.float32(self.share) * lobes)


@dataclass(frozen=True, eq=False)
class LitLobes:
    """Lobes of texels fitted to what is not in shadow; `shadowed` (t, s), `status` (t,) int8 is a ShadowStatus."""

    lobes: LafortuneFit
    shadowed: Mask
    status: NDArray[np.int8]


def darkness(values: Float32, light: Float64, view: Float64, plain: LafortuneFit) -> Darkness:
    """What counts as shadow in a material, from some of its texels' values (t, s, 3) and their fit to all samples.

    Without a peak of dark samples the share is the lowest.
    """
    least = (_DARKEST * lafortune_values(plain, light, view).mean(axis=(0, 2))).astype(np.float32)
    lobes, _ = _lit(values, light, view, plain, least)
    return Darkness(_foot(_ratios(values, lafortune_values(lobes, light, view), least)), least)


def fit_lit(values: Float32, light: Float64, view: Float64, start: LafortuneFit, dark: Darkness) -> LitLobes:
    """Which of the values (t, s, 3) lie in shadow, and lobes of the others, from a fit to all of them."""
    lobes, status = _lit(values, light, view, start, dark.least)
    return LitLobes(lobes, dark.shadowed(values, lafortune_values(lobes, light, view)), status)


def _lit(
    values: Float32, light: Float64, view: Float64, start: LafortuneFit, least: Float32
) -> tuple[LafortuneFit, NDArray[np.int8]]:
    """Three rounds that leave out all that may be a shadow, and the status (t,) of each texel."""
    lobes, status = start, np.full(len(values), ShadowStatus.FOUND, np.int8)
    doubtful = Darkness(_HIGHEST, least)
    for _ in range(ROUNDS):
        left_out = doubtful.shadowed(values, lafortune_values(lobes, light, view))
        lobes, kept = _refitted(values, light, view, left_out, lobes)
        status[kept] = ShadowStatus.KEPT
    return lobes, status


def shadow_map(values: Float32, drawn: Float32, shadowed: Mask) -> Float32:
    """ShadowMap (t, s) in 0 to 1: 1 out of shadow, else BTF / SBRDF, of the channels' means."""
    lobes = _grey(drawn)
    level = np.divide(_grey(values), lobes, out=np.zeros(shadowed.shape, np.float32), where=lobes > 0)
    return np.where(shadowed, np.clip(np.nan_to_num(level), 0, 1), 1).astype(np.float32)


def _grey(values: Float32) -> Float32:
    """Mean of the channels (t, s), plane by plane: NumPy's own mean over three is slow."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray((values[..., 0] + values[..., 1] + values[..., 2]) / np.float32(3), np.float32)


def _refitted(
    values: Float32, light: Float64, view: Float64, shadowed: Mask, lobes: LafortuneFit
) -> tuple[LafortuneFit, Mask]:
    """The fit without the shadowed samples, and the texels (t,) whose lobes are as they were."""
    lit = np.where(shadowed[..., None], np.float32(np.nan), values)
    fit = fit_lafortune(lit, light, view, start=lobes)
    kept = (fit.status == FitStatus.TOO_FEW_SAMPLES) | (fit.status == FitStatus.DIVERGED)
    return either(lobes, fit, kept), kept


def either(first: LafortuneFit, second: LafortuneFit, wants_first: Mask) -> LafortuneFit:
    """Texel by texel one of two fits of the same texels."""
    count = len(wants_first)
    return LafortuneFit.joined([first, second]).chosen(np.arange(count) + np.where(wants_first, 0, count))


def _ratios(values: Float32, drawn: Float32, least: Float32) -> Float64:
    """How many samples lie in each bin of BTF / SBRDF up to the highest that may be a shadow."""
    ratio = _grey(values) / np.maximum(np.maximum(_grey(drawn), least), np.finfo(np.float32).tiny)
    inside = ratio[ratio < _HIGHEST]  # NaN is not
    return np.histogram(np.clip(inside, 0, None), _BINS, (0, _HIGHEST))[0].astype(np.float64)


def _foot(count: Float64) -> float:
    """The upper end of the peak of the dark ratios; the lowest bin's where the counts only rise."""
    smooth = np.convolve(np.pad(count, 1, mode="edge"), [0.25, 0.5, 0.25], mode="valid")
    peak = int(np.argmax(smooth))
    if peak == _BINS - 1:
        return _HIGHEST / _BINS
    beyond = count[peak + 1 :]
    first = int(np.argmax(beyond <= _FOOT * max(beyond.min(), 1.0)))
    return _HIGHEST / _BINS * (peak + 1 + first)
