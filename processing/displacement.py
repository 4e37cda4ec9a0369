"""Displacements of one view, merged over the laser's locations."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_OUTLIER = 4.0  # sigmas from the weighted median
_AGREEMENT_M = 25e-6  # two locations see a rough surface's pixel differently by about this much


@dataclass(frozen=True)
class Merged:
    """Displacement (h, w) of several sweeps of one view, float32 metres; NaN where none measured.

    `variance_m2` is that of the weighted mean; where sweeps contradict each other and neither has the majority it
    includes their disagreement. `used` (h, w) counts the sweeps that agree, `rejected` those that do not.
    `consistency` (k,) is every sweep's RMS deviation from the merged value in its own sigmas where others measured
    too: near 1 where its variance tells the truth, larger where its plane is off.
    """

    displacement_m: NDArray[np.float32]
    variance_m2: NDArray[np.float32]
    used: NDArray[np.uint8]
    rejected: NDArray[np.uint8]
    consistency: Array


def merge_displacements(
    displacement_m: NDArray[np.floating], variance_m2: NDArray[np.floating], weights: Array | None = None
) -> Merged:
    """Merge the sweeps (k, h, w) of one view over the laser's locations.

    Weighted mean of what lies within four sigmas of the weighted median: D = sum w_i D_i / sum w_i. Weights are inverse
    variances, which are best, or `weights` (k,) per location, such as the paper's (`tetrahedron_weights`).
    Source: Wang et al. 2005, section 3.2.
    """
    values, variances = np.asarray(displacement_m, np.float64), np.asarray(variance_m2, np.float64)
    measured = np.isfinite(values) & (variances > 0.0)
    precision = np.where(measured, 1.0 / np.where(measured, variances, 1.0), 0.0)
    chosen = precision if weights is None else np.where(measured, weights[:, None, None], 0.0)
    middle, middle_variance = _weighted_median(np.where(measured, values, 0.0), variances, precision)
    tolerance = _OUTLIER * np.sqrt(np.where(measured, variances, 0.0) + middle_variance + _AGREEMENT_M**2)
    agrees = measured & (np.abs(values - middle) <= tolerance)
    used, rejected = agrees.sum(axis=0), (measured & ~agrees).sum(axis=0)
    share = np.where(agrees, chosen, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = share / share.sum(axis=0)
    merged = np.where(used > 0, np.where(agrees, share * values, 0.0).sum(axis=0), np.nan)
    variance = np.where(used > 0, np.where(agrees, share**2 * variances, 0.0).sum(axis=0), np.nan)
    quarrel = np.where(measured & ~agrees, (values - merged) ** 2, 0.0).max(axis=0)
    variance = np.where(rejected >= used, variance + quarrel, variance)
    return Merged(
        merged.astype(np.float32),
        variance.astype(np.float32),
        used.astype(np.uint8),
        rejected.astype(np.uint8),
        _consistency(values - merged, variances, variance, measured & (used + rejected > 1)),
    )


def _weighted_median(values: Array, variances: Array, precision: Array) -> tuple[Array, Array]:
    """Weighted lower median over the first axis, and the variance of the sweep that gave it; precision 0 = missing."""
    order = np.argsort(np.where(precision > 0.0, values, np.inf), axis=0, kind="stable")
    summed = np.cumsum(np.take_along_axis(precision, order, axis=0), axis=0)
    place = np.argmax(summed >= 0.5 * summed[-1], axis=0)[None]
    index = np.take_along_axis(order, place, axis=0)
    variance = np.take_along_axis(np.where(precision > 0.0, variances, 0.0), index, axis=0)[0]
    return np.take_along_axis(values, index, axis=0)[0], variance


def _consistency(deviation: Array, variances: Array, merged_variance: Array, shared: NDArray[np.bool_]) -> Array:
    """Robust RMS per sweep of the deviation in sigmas; the merged value holds the sweep itself: hence `- merged`."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio2 = deviation**2 / np.maximum(variances - merged_variance, 0.05 * variances)
    return np.array([_robust_rms(r[s]) if s.any() else np.nan for r, s in zip(ratio2, shared, strict=True)])


def _robust_rms(squares: Array) -> float:
    return 1.4826 * float(np.sqrt(np.median(squares)))


def tetrahedron_weights(sources_m: Array, camera_m: Array) -> Array:
    """The paper's weights (k,) of the laser locations (k, 3) for a camera at (3,), rig frame, metres cubed.

    Volume of the tetrahedron of source, camera and two points, one metre apart, of the stripe through the origin: the
    stripe lies in the reference plane, square to the laser's azimuth.
    Source: Wang et al. 2005, section 3.2.
    """
    sources = np.asarray(sources_m, np.float64)
    level = sources[:, :2] / np.linalg.norm(sources[:, :2], axis=1, keepdims=True)
    stripe = np.stack([-level[:, 1], level[:, 0], np.zeros(len(sources))], axis=1)
    return np.asarray(np.abs(np.cross(stripe, sources) @ np.asarray(camera_m, np.float64)) / 6.0)
