"""The surface at one place from noisy samples around it: Gaussian processes whose roughness the samples tell.

How much a surface bends between samples cannot be known beforehand: a glazed brick is smooth to micrometres, its edge
rises by a millimetre within two pixels. So several roughnesses are held against the samples around each place, and each
speaks by the likelihood that it gives them. Where noise rules that smooths, where the surface is steep it interpolates,
and the variance says which it was. Lengths are in sample spacings.
Source: Rasmussen and Williams 2006, chapters 2, 4 and 5 (regression, Matern covariances, marginal likelihood).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_ROUGHNESS = np.geomspace(0.02, 40.0, 8)  # standard deviations of a process
_LENGTH = 6.0  # of its correlation: as wide as the neighbourhood
_SLOPE = 1.0  # standard deviation of a surface's slope: 45 degrees
_OFFSET = 100.0  # of its height about the samples' median: hardly any belief
_ABSENT = 1e12  # variance of a sample that was not measured
_EXACT = 1e-8  # least variance: beside _OFFSET, double precision knows no less
_GAP = 1.0  # between the samples of two surfaces, at least
_EDGE = 0.15  # standard deviation of where an edge runs between samples
_SHARE_ROUNDS = 4


@dataclass(frozen=True)
class Samples:
    """The k samples around n places: `offset` (n, k, 2) from the place, `value` and its `variance` (n, k).

    Those that are not `measured` (n, k) mean nothing.
    """

    offset: Array
    value: Array
    variance: Array
    measured: Mask

    def chosen(self, which: Mask) -> "Samples":
        """Those of some places only."""
        return Samples(self.offset[which], self.value[which], self.variance[which], self.measured[which])


@dataclass(frozen=True)
class _Models:
    """What m models say of n places: mean, variance and the logarithm of their evidence, (n, m) each."""

    mean: Array
    variance: Array
    evidence: Array


def predict_surface(samples: Samples) -> Array:
    """Value and variance (n, 2) of the surface at n places, each with one measured sample at least.

    Models are one surface of any roughness, or two of which one hides part of the other. How common each is among all
    places is its prior (empirical Bayes), the evidence of a place's own samples decides. The value is never a mean of
    two surfaces: it lies on the likelier one, and the variance holds the chance that it is the other.
    """
    ordered = np.sort(np.where(samples.measured, samples.value, np.inf), axis=1)
    middle = (samples.measured.sum(axis=1) - 1) // 2
    median = np.take_along_axis(ordered, middle[:, None], axis=1)
    value = np.where(samples.measured, samples.value - median, 0.0)
    known = replace(
        samples, value=value, variance=np.where(samples.measured, np.maximum(samples.variance, _EXACT), _ABSENT)
    )
    one, upper, lower = _one_surface(known), *_two_surfaces(known)
    value, variance = _decided(_joined([one, upper, lower]))
    return np.stack([value + median[:, 0], variance], axis=1)


def _one_surface(samples: Samples) -> _Models:
    every = np.ones(samples.value.shape)
    return _regress(samples, every[:, :, None] * every[:, None], [every])[0]


def _two_surfaces(samples: Samples) -> list[_Models]:
    """The place on the upper surface and on the lower one; samples of one say nothing of the other."""
    above, gap = _split(samples)
    torn = gap > _GAP
    shape = (len(gap), 2 * len(_ROUGHNESS))
    answers = [_Models(np.zeros(shape), np.zeros(shape), np.full(shape, -np.inf)) for _ in range(2)]
    if not torn.any():
        return answers
    label, there = np.where(above[torn], 1.0, -1.0), samples.chosen(torn)
    together = 0.5 * (1.0 + label[:, :, None] * label[:, None])
    level = edge_level(there.offset, label, there.measured) / _EDGE
    found = _regress(there, together, [0.5 + 0.5 * label, 0.5 - 0.5 * label])
    for answer, side, chance in zip(answers, found, (log_ndtr(level), log_ndtr(-level)), strict=True):
        answer.mean[torn], answer.variance[torn] = side.mean, side.variance
        answer.evidence[torn] = side.evidence + chance[:, None]
    return answers


def _split(samples: Samples) -> tuple[Mask, Array]:
    """Which samples (n, k) lie above the largest gap between the sorted values of a place, and that gap (n,)."""
    value = np.where(samples.measured, samples.value, np.nan)
    ordered = np.sort(value, axis=1)
    steps = np.nan_to_num(np.diff(ordered, axis=1), nan=0.0)
    place = np.argmax(steps, axis=1)[:, None]
    with np.errstate(invalid="ignore"):
        above = value > np.take_along_axis(ordered, place, axis=1)
    return above, np.take_along_axis(steps, place, axis=1)[:, 0]


def edge_level(offset: Array, label: Array, known: Mask) -> Array:
    """About how far (n,) places lie, in sample spacings, on the side labelled 1 of the edge between labels 1 and -1.

    The height of a plane through the labels (n, k) of the `known` samples at `offset` (n, k, 2), near ones counting
    more; it saturates at 1.
    """
    weight = np.where(known, np.exp(-0.5 * (offset**2).sum(axis=-1)), 0.0)
    basis = np.concatenate([np.ones((*label.shape, 1)), offset], axis=-1)
    normal = np.einsum("nki,nk,nkj->nij", basis, weight, basis) + 1e-3 * np.eye(3)
    moment = np.einsum("nki,nk,nk->ni", basis, weight, label)
    return np.asarray(np.linalg.solve(normal, moment[..., None])[:, 0, 0])


def _regress(samples: Samples, together: Array, sides: Sequence[Array]) -> list[_Models]:
    """All models where `together` (n, k, k) says which samples share a surface; one answer for each of `sides` (n, k).

    A side says which samples share the place's surface. With noise and plane whitened out and the process' covariance
    made diagonal, every roughness is a sum over eigenvalues.
    """
    base = together * (_OFFSET**2 + _SLOPE**2 * samples.offset @ samples.offset.swapaxes(1, 2))
    np.einsum("nii->ni", base)[...] += samples.variance
    root = np.linalg.cholesky(base)
    whiten = np.linalg.inv(root)
    determinant = 2.0 * np.log(np.einsum("nii->ni", root)).sum(axis=1)
    apart = np.linalg.norm(samples.offset[:, :, None] - samples.offset[:, None], axis=-1)
    away = np.linalg.norm(samples.offset, axis=-1)
    answers: list[list[_Models]] = [[] for _ in sides]
    for covariance in (_rough, _smooth):
        inner = whiten @ (together * covariance(apart / _LENGTH)) @ whiten.swapaxes(1, 2)
        eigen, axes = np.linalg.eigh(inner)
        turn = axes.swapaxes(1, 2) @ whiten
        for answer, side in zip(answers, sides, strict=True):
            columns = np.stack([samples.value, side * covariance(away / _LENGTH), side * _OFFSET**2], axis=-1)
            answer.append(_all_roughnesses(eigen, turn @ columns, determinant))
    return [_joined(answer) for answer in answers]


def _all_roughnesses(eigen: Array, turned: Array, determinant: Array) -> _Models:
    square = _ROUGHNESS**2
    shrink = 1.0 / (1.0 + square * np.maximum(eigen, 0.0)[..., None])
    value, toward, level = (turned[..., i, None] for i in range(3))
    cross = square * toward + level
    mean = (cross * value * shrink).sum(axis=1)
    variance = np.maximum(square + _OFFSET**2 - (cross**2 * shrink).sum(axis=1), 0.0)
    misfit = (value**2 * shrink).sum(axis=1) - np.log(shrink).sum(axis=1)
    return _Models(mean, variance, -0.5 * (misfit + determinant[:, None]))


def _rough(distance: Array) -> Array:
    """Matern covariance of order 1/2: continuous, with kinks everywhere."""
    return np.asarray(np.exp(-distance))


def _smooth(distance: Array) -> Array:
    """Matern covariance of order 5/2: slopes and curvatures are continuous."""
    scaled = np.sqrt(5.0) * distance
    return np.asarray((1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled))


def _joined(models: Sequence[_Models]) -> _Models:
    parts = [np.concatenate([getattr(m, name) for m in models], axis=1) for name in ("mean", "variance", "evidence")]
    return _Models(*parts)


def _decided(models: _Models) -> tuple[Array, Array]:
    """Value (n,) by the likeliest third of the models, one surface, upper or lower; variance (n,) by all of them."""
    weight = _posterior(models.evidence)
    thirds = weight.reshape(len(weight), 3, -1)
    chosen = np.argmax(thirds.sum(axis=2), axis=1)[:, None, None]
    own = np.take_along_axis(thirds, chosen, axis=1)[:, 0]
    mean = np.take_along_axis(models.mean.reshape(thirds.shape), chosen, axis=1)[:, 0]
    value = (own * mean).sum(axis=1) / own.sum(axis=1)
    return value, (weight * (models.variance + (models.mean - value[:, None]) ** 2)).sum(axis=1)


def _posterior(evidence: Array) -> Array:
    """Probability (n, m) of every model, with the shares of the models among all places as prior."""
    likelihood = np.exp(evidence - evidence.max(axis=1, keepdims=True))
    weight = likelihood
    for _ in range(_SHARE_ROUNDS):
        weight = weight / weight.sum(axis=1, keepdims=True)
        weight = likelihood * (1.0 + weight.sum(axis=0))  # one place more for each model: few places prove little
    return np.asarray(weight / weight.sum(axis=1, keepdims=True))
