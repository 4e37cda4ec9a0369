"""Displacements of one view, merged over the laser's locations."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.robust import bulk_deviation, weighted_median_place

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
    variances, which are best, or `weights` (k,) per location, such as the paper's (`tetrahedron_weights`);
    0 leaves a location out.
    Source: Wang et al. 2005, section 3.2.
    """
    values, variances = np.asarray(displacement_m, np.float64), np.asarray(variance_m2, np.float64)
    measured = np.isfinite(values) & np.isfinite(variances) & (variances > 0.0)
    if weights is not None:
        measured &= weights[:, None, None] > 0.0
    variances = np.where(measured, variances, 1.0)
    agrees = measured & _near_median(np.where(measured, values, 0.0), variances, measured)
    used, rejected = agrees.sum(axis=0), (measured & ~agrees).sum(axis=0)
    weight = np.where(agrees, 1.0 / variances if weights is None else weights[:, None, None], 0.0)
    total = weight.sum(axis=0)
    share = np.divide(weight, total, out=np.full(weight.shape, np.nan), where=total > 0.0)
    merged = np.where(agrees, share * values, 0.0 * share).sum(axis=0)
    variance = (share**2 * variances).sum(axis=0)
    quarrel = np.where(measured & ~agrees, (values - merged) ** 2, 0.0).max(axis=0)
    variance = np.where(rejected >= used, variance + quarrel, variance)
    return Merged(
        merged.astype(np.float32),
        variance.astype(np.float32),
        used.astype(np.uint8),
        rejected.astype(np.uint8),
        _consistency(values - merged, variances, variance, measured & (used + rejected > 1)),
    )


def _near_median(values: Array, variances: Array, measured: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which sweeps lie within four sigmas of the median, weighted by inverse variances."""
    middle = weighted_median_place(values, np.where(measured, 1.0 / variances, 0.0))
    median, its_variance = np.take_along_axis(values, middle, axis=0), np.take_along_axis(variances, middle, axis=0)
    tolerance = _OUTLIER * np.sqrt(variances + its_variance + _AGREEMENT_M**2)
    return np.asarray(np.abs(values - median) <= tolerance)


def _consistency(deviation: Array, variances: Array, merged_variance: Array, shared: NDArray[np.bool_]) -> Array:
    """Robust RMS per sweep of the deviation in sigmas; the merged value holds the sweep itself: hence `- merged`."""
    # A sweep that makes the merged value alone leaves no variance between both: a floor keeps that finite.
    sigmas = deviation / np.sqrt(np.maximum(variances - merged_variance, 0.05 * variances))
    return np.array([bulk_deviation(r[s]) if s.any() else np.nan for r, s in zip(sigmas, shared, strict=True)])


def tetrahedron_weights(sources_m: Array, camera_m: Array) -> Array:
    """The paper's weights (k,) of the laser locations (k, 3) for a camera at (3,), rig frame, metres cubed.

    Volume of the tetrahedron of source, camera and two points, one metre apart, of the stripe through the origin: the
    stripe lies in the reference plane, square to the laser's azimuth; so no source may stand straight above the origin.
    Source: Wang et al. 2005, section 3.2.
    """
    sources = np.asarray(sources_m, np.float64)
    level = sources[:, :2] / np.linalg.norm(sources[:, :2], axis=1, keepdims=True)
    stripe = np.stack([-level[:, 1], level[:, 0], np.zeros(len(sources))], axis=1)
    return np.asarray(np.abs(np.cross(stripe, sources) @ np.asarray(camera_m, np.float64)) / 6.0)
