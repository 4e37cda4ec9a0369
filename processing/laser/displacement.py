"""Displacements of one view, merged over the laser's locations."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.laser import displacement_kernel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Merged:
    """Displacement (h, w) of several sweeps of one view, float32 metres; NaN where none measured.

    `variance_m2` is that of the weighted mean; where sweeps contradict each other and neither has the majority it
    includes their disagreement. `used` (h, w) counts the sweeps that agree, `rejected` those that do not.
    `consistency` (k,) is the bulk of every sweep's deviations from the merged value where others measured too, in its
    own sigmas: near 1 where its variance tells the truth, larger where its plane is off, NaN where it is alone.
    """

    displacement_m: NDArray[np.float32]
    variance_m2: NDArray[np.float32]
    used: NDArray[np.uint16]
    rejected: NDArray[np.uint16]
    consistency: Array


def merge_displacements(
    displacement_m: NDArray[np.floating],
    variance_m2: NDArray[np.floating],
    weights: Array | None = None,
    roughness_m: float = 0.0,
) -> Merged:
    """Merge the sweeps (k, h, w) of one view over the laser's locations.

    Weighted mean D = sum w_i D_i / sum w_i of the sweeps that agree: all where they lie within four sigmas of their
    mean, else those about the one that is nearest to most others. Weights are inverse variances, which are best, or
    `weights` (k,) per location, such as the paper's (`tetrahedron_weights`); 0 leaves a location out. Where many sweeps
    would be left out they may differ by `roughness_m` too (standard deviation), which what a pixel sees of a rough
    surface from different sides differs by.
    Source: Wang et al. 2005, section 3.2.
    """
    locations, *shape = displacement_m.shape
    values, variances = (
        np.ascontiguousarray(array).reshape(locations, np.prod(shape, dtype=int))
        for array in (displacement_m, variance_m2)
    )
    given = np.empty(0) if weights is None else np.asarray(weights, np.float64)
    merged = np.empty((2, *shape), np.float32)
    counts = np.empty((2, *shape), np.uint16)
    histogram = np.zeros((displacement_kernel.BLOCKS, locations, displacement_kernel.BINS), np.int64)
    outputs = merged.reshape(2, -1), counts.reshape(2, -1), histogram
    displacement_kernel.merge_samples((values, variances), given, float(roughness_m) ** 2, *outputs)
    return Merged(merged[0], merged[1], counts[0], counts[1], _consistency(histogram.sum(axis=0)))


def _consistency(histogram: NDArray[np.int64]) -> Array:
    """1.4826 times the median deviation in sigmas (k,) of those counted (k, bins); NaN where none was counted."""
    summed = np.cumsum(histogram, axis=1)
    half = 0.5 * summed[:, -1:]
    place = np.argmax(summed >= half, axis=1)
    within = np.take_along_axis(histogram, place[:, None], axis=1)
    below = np.take_along_axis(summed, place[:, None], axis=1) - within
    with np.errstate(invalid="ignore"):
        share = (place[:, None] + (half - below) / within)[:, 0] / histogram.shape[1]
    return np.asarray(1.4826 * np.sqrt(share / (1.0 - share)))


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
