"""Whether the exposures of a stack show the same picture: a shift between them, or parts that moved."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import correlate1d
from scipy.stats import chi2

from processing.errors import ImageError
from processing.radiometry.sensor import Sensor

Array = NDArray[np.float64]

TOLERABLE_PX = 0.1  # smaller shifts are not told: they change a merged edge by less than demosaicing does
REFUSED_PX = 0.5  # from here on neighbouring pixels, and so colours, mix
_REACH = 8  # quads in each direction that are searched for the other exposure
_ALIKE = 0.8  # mean of log(1 + z^2) over quads; noise alone gives 0.53
_BETTER = 0.1  # difference of that mean that is nothing of noise over thousands of quads
_KNOWN_PX = 0.25  # deviation of a shift from which on it counts as undetermined
_FALSE_ALARM = 1e-6
_DOUBT = 4.0  # standard deviations
_DISTURBED = 1e-3  # share of undisturbed patches that the outlier test rejects
_DISAGREE = 1e-4  # the same of quads
_LIKENESS = 0.01  # relative departure of two frames that flicker and nonlinearity explain
_STEPS = 6
_SMOOTH = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16
_SLOPE = np.array([-0.5, 0.0, 0.5])


class ShiftStatus(IntEnum):
    """What is known of the shift between two exposures."""

    ALIGNED = 0  # within the noise, or under `TOLERABLE_PX`
    SHIFTED = 1  # beyond both
    UNDETERMINED = 2  # nothing that both show has an edge


@dataclass(frozen=True, eq=False)
class Shift:
    """By how much the picture of `other` lies right of and under that of `one` (column, row), frames by their number.

    `sigma_px` is infinite in a direction in which the scene has no edges. `significance` is the chance that noise alone
    makes aligned frames differ as much.
    """

    one: int
    other: int
    shift_px: Array
    sigma_px: Array
    significance: float

    @property
    def length_px(self) -> float:
        """Length of the shift, of what is determined of it."""
        return float(np.hypot(*np.where(np.isfinite(self.sigma_px), self.shift_px, 0.0)))

    @property
    def status(self) -> ShiftStatus:
        """Whether the frames are aligned."""
        if not np.isfinite(self.sigma_px).any():
            return ShiftStatus.UNDETERMINED
        shifted = self.significance < _FALSE_ALARM and self.length_px > TOLERABLE_PX
        return ShiftStatus.SHIFTED if shifted else ShiftStatus.ALIGNED

    @property
    def refused(self) -> bool:
        """Whether it is over `REFUSED_PX` beyond doubt."""
        known = np.isfinite(self.sigma_px)
        doubt_px = _DOUBT * float(np.hypot(*np.where(known, self.sigma_px, 0.0)))
        return self.status == ShiftStatus.SHIFTED and self.length_px > REFUSED_PX + doubt_px


@dataclass(frozen=True, eq=False)
class Alignment:
    """Shifts of exposures next to each other in time, and the share of the picture where samples disagree."""

    shifts: tuple[Shift, ...]
    moved_share: float

    @property
    def worst(self) -> Shift | None:
        """The largest significant shift, None where all are aligned or undetermined."""
        found = [shift for shift in self.shifts if shift.status == ShiftStatus.SHIFTED]
        return max(found, key=lambda shift: shift.length_px, default=None)


def alignment(raw_dn: NDArray[np.generic], exposure_s: ArrayLike, sensor: Sensor) -> Alignment:
    """Shifts between exposures next to each other in time, from patches (k, n, h, w) of a Bayer mosaic's frames.

    Compared are the rates D = b - a of quads of 2 x 2 pixels, unsaturated in both. Score and covariance of a shift are
    sums over g D / V and g g' / V with the variance V of D and g the smoothed slope of a and b's weighted mean, with
    which the noise of D is uncorrelated: without movement the score is noise of just that covariance, over any
    texture. A factor between the frames is fitted too; patches that contradict the others (moved parts) do not count.
    Larger shifts are first searched in whole quads, up to 16 pixels. Patches have even corners.
    Raises ImageError where the patches and the exposures disagree.
    """
    patches, times = np.asarray(raw_dn), np.asarray(exposure_s, np.float64)
    if patches.ndim != 4 or times.shape != patches.shape[:1] or min(patches.shape) == 0:
        raise ImageError(f"patches of shape {patches.shape} with {times.size} times; (k, n, h, w) and k are needed.")
    rates = [_Rates.of(frame, time, sensor) for frame, time in zip(patches, times, strict=True)]
    order = np.argsort(times, kind="stable")
    shifts = tuple(_shift(rates[i], rates[j], int(i), int(j)) for i, j in pairwise(order))
    return Alignment(shifts, _moved_share(rates))


def shift_error(shift: Shift, names: Sequence[str]) -> ImageError:
    """What to tell where two exposures show different places at one pixel."""
    return ImageError(
        f"{names[shift.one]} and {names[shift.other]}: the picture moved by {shift.length_px:.1f} px between them, so "
        "that a pixel would mix different places. Fix the camera and take them again, or merge them as they are."
    )


@dataclass(frozen=True, eq=False)
class _Rates:
    """Quads of one frame: electrons per second (n, h, w) and their variance, infinite where there is none."""

    value: Array
    variance: Array

    @classmethod
    def of(cls, frame: NDArray[np.generic], time_s: float, sensor: Sensor) -> "_Rates":
        n, height, width = frame.shape
        dn = np.asarray(frame[:, : height // 2 * 2, : width // 2 * 2], np.float64)
        quads = dn.reshape(n, height // 2, 2, width // 2, 2)
        good = ((quads < sensor.white_dn) & np.isfinite(quads)).all(axis=(2, 4))
        electrons = (np.where(good, quads.sum(axis=(2, 4)), 0.0) - 4 * sensor.black_dn) * sensor.gain_e_per_dn
        variance = (np.maximum(electrons, 0.0) + 4 * sensor.dark_variance_e2) / time_s**2
        return cls(np.where(good, electrons, 0.0) / time_s, np.where(good, variance, np.inf))

    def window(self, at: Sequence[int] | NDArray[np.intp], reach: int) -> "_Rates":
        """The inner part this many columns and rows of quads from the middle; `reach` are cut from every side."""
        (column, row), (height, width) = at, self.value.shape[1:]
        part = np.s_[:, reach + row : height - reach + row, reach + column : width - reach + column]
        return _Rates(self.value[part], self.variance[part])


@dataclass(frozen=True, eq=False)
class _Scores:
    """Sums of each patch (n, ...): score and its covariance about (column, row, factor), and how it answers a shift."""

    score: Array
    covariance: Array
    response: Array


def _shift(one: _Rates, other: _Rates, i: int, j: int) -> Shift:
    reach = min(_REACH, (min(one.value.shape[1:]) - 8) // 2)
    unknown = Shift(i, j, np.zeros(2), np.full(2, np.inf), 1.0)
    if reach < 1:
        return unknown
    scale = _factor(one, other)
    other = _Rates(other.value * scale, other.variance * scale**2)
    at = _search(one, other, reach)
    for _ in range(_STEPS):
        scores = _scores(one.window((0, 0), reach), other.window(at, reach))
        rest, covariance = _solved(scores)
        # Beyond three quarters of a quad the next one is nearer; short of that, going on would go back and forth.
        closer = np.clip(at + np.rint(rest * 2 / 3).astype(int), -reach, reach)
        if (closer == at).all():
            break
        at = closer
    sigma_px = 2 * np.sqrt(np.diag(covariance))
    still = _scores(one.window((0, 0), reach), other.window((0, 0), reach)) if at.any() else scores
    return Shift(i, j, np.where(np.isfinite(sigma_px), 2 * (at + rest), 0.0), sigma_px, _chance(still))


def _factor(one: _Rates, other: _Rates) -> float:
    """What the other frame's rates are to be multiplied by: lamps flicker between exposures."""
    both = np.isfinite(one.variance) & np.isfinite(other.variance)
    total = other.value[both].sum()
    ratio = one.value[both].sum() / total if total > 0 else 1.0
    return float(ratio) if 0.5 < ratio < 2 else 1.0


def _search(one: _Rates, other: _Rates, reach: int) -> NDArray[np.intp]:
    """Columns and rows, in quads, by which the other frame is most like the one; none unless that is beyond doubt."""
    still = one.window((0, 0), reach)
    unmoved = _unlikeness(still, other.window((0, 0), reach))
    if unmoved < _ALIKE:
        return np.zeros(2, np.intp)
    steps = range(-reach, reach + 1)
    cost = {(x, y): _unlikeness(still, other.window((x, y), reach)) for x in steps for y in steps}
    best = min(cost, key=cost.__getitem__)
    return np.array(best if cost[best] < unmoved - _BETTER else (0, 0), np.intp)


def _unlikeness(one: _Rates, other: _Rates) -> float:
    """Mean of log(1 + z^2) over what both show; a part that moved has little say."""
    known = np.isfinite(one.variance) & np.isfinite(other.variance)
    if np.count_nonzero(known) < 64:
        return float("inf")
    spread = one.variance[known] + other.variance[known]
    return float(np.mean(np.log1p((one.value[known] - other.value[known]) ** 2 / spread)))


def _scores(one: _Rates, other: _Rates) -> _Scores:
    known = np.isfinite(one.variance) & np.isfinite(other.variance)
    weight = np.where(known, 1 / np.where(known, one.variance + other.variance, 1.0), 0.0)
    share = np.where(known, other.variance, 1.0) / np.where(known, one.variance + other.variance, 1.0)
    mean = np.where(known, share * one.value + (1 - share) * other.value, 0.0)
    inside = known
    for axis in (1, 2):  # slopes need five known neighbours in a row
        inside = correlate1d(inside.astype(np.int8), np.ones(5, np.int8), axis=axis, mode="constant") == 5
    weight = np.where(inside, weight, 0.0)
    steer = np.stack([*_slopes(mean, _SMOOTH), mean], axis=-1)
    lean = [-slope for slope in _slopes(one.value, None)], [-slope for slope in _slopes(other.value, None)]
    smooth = _slopes(one.value, _SMOOTH), _slopes(other.value, _SMOOTH)
    # Each frame's smoothed slope by the other's own: their noise is independent, so the product has none on average.
    response = np.zeros((len(mean), 3, 3))
    for r in range(2):
        for c in range(2):
            product = smooth[0][r] * lean[1][c] + smooth[1][r] * lean[0][c]
            response[:, r, c] = (weight * product).sum(axis=(1, 2)) / 2
        response[:, 2, r] = (weight * mean * (lean[0][r] + lean[1][r])).sum(axis=(1, 2)) / 2
        response[:, r, 2] = (weight * steer[..., r] * mean).sum(axis=(1, 2))
    response[:, 2, 2] = (weight * mean * mean).sum(axis=(1, 2))
    difference = np.where(known, other.value - one.value, 0.0)
    return _Scores(
        np.einsum("nyxi,nyx->ni", steer, weight * difference),
        np.einsum("nyxi,nyx,nyxj->nij", steer, weight, steer),
        response,
    )


def _slopes(image: Array, smooth: Array | None) -> list[Array]:
    """Slopes along columns and rows of patches (n, h, w)."""
    found = []
    for along, across in ((2, 1), (1, 2)):
        slope = correlate1d(image, _SLOPE, axis=along, mode="nearest")
        if smooth is not None:
            slope = correlate1d(correlate1d(slope, smooth, axis=across, mode="nearest"), smooth, axis=along)
        found.append(slope)
    return found


def _solved(scores: _Scores) -> tuple[Array, Array]:
    """Shift (column, row) in quads and its covariance, infinite where it is undetermined; outlying patches left out."""
    kept = np.trace(scores.covariance, axis1=1, axis2=2) > 0
    found, covariance = np.zeros(3), np.diag(np.full(2, np.inf))
    for _ in range(_STEPS):
        if not kept.any():
            return np.zeros(2), np.diag(np.full(2, np.inf))
        found, covariance = _combined(scores, kept)
        misfit = _misfit(scores, found)
        excess = max(1.0, float(np.median(misfit[kept])) / chi2.median(3))
        again = (misfit < excess * chi2.isf(_DISTURBED, 3)) & (misfit >= 0)
        if (again == kept).all():
            break
        kept = again
    return found[:2], covariance


def _combined(scores: _Scores, kept: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Estimate (column, row, factor) over the kept patches, and the covariance of the shift."""
    response, spread = scores.response[kept].sum(axis=0), scores.covariance[kept].sum(axis=0)
    eliminated = response[:2, :2] - np.outer(response[:2, 2], response[2, :2]) / max(response[2, 2], 1e-300)
    # In units of the score's noise: how many standard deviations one quad of shift moves it, by direction.
    size = np.sqrt(np.maximum(np.diag(spread)[:2], 1e-300))
    _, strength, directions = np.linalg.svd(eliminated / size[:, None])
    known = strength > 1 / (0.5 * _KNOWN_PX)
    if not known.any():
        return np.zeros(3), np.diag(np.full(2, np.inf))
    inverse = np.linalg.pinv(eliminated / size[:, None], rcond=0.999 / (strength[0] * 0.5 * _KNOWN_PX)) / size
    project = np.column_stack([inverse, -inverse @ response[:2, 2] / max(response[2, 2], 1e-300)])
    shift, covariance = project @ scores.score[kept].sum(axis=0), project @ spread @ project.T
    if not known.all():  # the direction that nothing determines, and every axis that has a part in it
        loose = np.abs(directions[~known][0]) > 0.3
        covariance[loose, loose] = np.inf
    factor = (scores.score[kept, 2].sum() - response[2, :2] @ shift) / max(response[2, 2], 1e-300)
    return np.array([*shift, factor]), covariance


def _misfit(scores: _Scores, found: Array) -> Array:
    """Chi-square (n,) of each patch's score about the common estimate; -1 for a patch without any."""
    left = scores.score - scores.response @ found
    size = np.sqrt(np.einsum("nii->ni", scores.covariance))
    some = (size > 0).all(axis=1)
    misfit = np.full(len(left), -1.0)
    scaled = scores.covariance[some] / (size[some, :, None] * size[some, None, :]) + 1e-9 * np.eye(3)
    z = left[some] / size[some]
    misfit[some] = np.einsum("ni,nij,nj->n", z, np.linalg.inv(scaled), z)
    return misfit


def _chance(scores: _Scores) -> float:
    """Chance that noise alone makes unmoved frames differ so, beyond a factor between them; moved patches left out."""
    misfit = _misfit(scores, np.zeros(3))
    kept = misfit >= 0
    if not kept.any():
        return 1.0
    score, spread = scores.score[kept].sum(axis=0), scores.covariance[kept].sum(axis=0)
    free = score[:2] - spread[:2, 2] / max(spread[2, 2], 1e-300) * score[2]
    left = spread[:2, :2] - np.outer(spread[:2, 2], spread[2, :2]) / max(spread[2, 2], 1e-300)
    return float(chi2.sf(free @ np.linalg.pinv(left, rcond=1e-9, hermitian=True) @ free, 2))


def _moved_share(rates: Sequence[_Rates]) -> float:
    """Share of the quads in which the frames' rates differ beyond noise and `_LIKENESS`, less what chance gives."""
    weight = np.stack([1 / one.variance for one in rates])
    value = np.stack([one.value for one in rates])
    degrees = (weight > 0).sum(axis=0) - 1
    compared = degrees > 0
    if not compared.any():
        return 0.0
    mean = (weight * value).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-300)
    weight = weight / (1 + weight * (_LIKENESS * mean) ** 2)
    misfit = (weight * (value - mean) ** 2).sum(axis=0)[compared]
    beyond = np.mean(misfit > chi2.isf(_DISAGREE, degrees[compared]))
    return float(max(beyond - _DISAGREE, 0.0))
