"""The laser stripe in single images: its ridge to a fraction of a pixel, and the line through it.

Space-time analysis needs none of this. It serves images that are no sweep: a stripe photographed on boards, a laser
swept by hand, the paper's plane per frame.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from processing.errors import ImageError
from processing.robust import biweight, bulk_deviation, principal_axes

Array = NDArray[np.float64]
_ROUNDS = 15
_LEAST_SCALE_PX = 1e-3  # of exact points, whose scatter is rounding
_TRIALS = 300  # pairs of points: with half of them wrong, none of 300 is right once in 10^37
_OWN_PIXEL = 0.6  # pixels from a ridge point to its pixel's centre: half, and what noise moves it


@dataclass(frozen=True)
class Ridge:
    """Points (n, 2) uv_px on the stripe's middle, one per scan line, with the ridge's strength (n,) in image units."""

    uv_px: Array
    strength: Array


@dataclass(frozen=True)
class ImageLine:
    """The line a u + b v = c with a^2 + b^2 = 1 in pixels, the RMS distance of the points that make it, their number.

    `inliers` (n,) says which of the given points they are.
    """

    normal: Array
    offset_px: float
    rms_px: float
    inliers: NDArray[np.bool_]


def redness(rgb: NDArray[np.generic]) -> Array:
    """How much redder than grey a pixel is: R - G, an image (h, w) in the units of `rgb` (h, w, 3).

    White and black paper under white light are both near 0, so only the stripe is left. Of a Bayer camera's other two
    channels green is the less noisy.
    Raises ImageError where there are not three channels.
    """
    image = np.asarray(rgb, np.float64)
    if image.ndim != 3 or image.shape[2] < 3:
        raise ImageError(f"a colour image (h, w, 3) is needed, not {image.shape}.")
    return np.asarray(image[..., 0] - image[..., 1])


def stripe_ridge(
    image: NDArray[np.floating], sigma_px: float, threshold: float, mask: NDArray[np.bool_] | None = None
) -> Ridge:
    """The strongest ridge point of every scan line (row) of an image (h, w), where it is stronger than `threshold`.

    Second derivatives of the Gaussian-filtered image give the ridge's direction and, along it, the sub-pixel place
    (Steger 1998, section 3); `sigma_px` is about half the stripe's half width. Strength is -sigma^2 times the second
    derivative. Scan along columns by passing the transpose. Raises ImageError where image and mask do not fit.
    """
    values = np.asarray(image, np.float64)
    if values.ndim != 2 or (mask is not None and mask.shape != values.shape):
        raise ImageError(f"a grey image (h, w) and a mask of its shape are needed, not {np.shape(image)}.")
    if mask is not None and not mask.any():
        return Ridge(np.empty((0, 2)), np.empty(0))
    part = _needed(values.shape if mask is None else mask, int(np.ceil(4 * sigma_px)))
    offset, strength = _ridge_field(values[part], sigma_px)
    allowed = np.abs(offset).max(axis=-1) <= _OWN_PIXEL
    strength = np.where(allowed if mask is None else allowed & mask[part], strength, -np.inf)
    rows = np.arange(strength.shape[0])
    columns = np.argmax(strength, axis=1)
    found = strength[rows, columns] > threshold
    rows, columns = rows[found], columns[found]
    uv_px = np.stack([columns, rows], axis=-1) + offset[rows, columns] + [part[1].start, part[0].start]
    return Ridge(uv_px, strength[rows, columns])


def _needed(mask: NDArray[np.bool_] | tuple[int, ...], margin: int) -> tuple[slice, slice]:
    """The part of the image that holds the mask and the filter's margin, or all of a shape."""
    if isinstance(mask, tuple):
        return slice(0, mask[0]), slice(0, mask[1])
    spans = [np.flatnonzero(mask.any(axis=1 - axis)) for axis in (0, 1)]
    rows, columns = (slice(max(int(s[0]) - margin, 0), int(s[-1]) + margin + 1) for s in spans)
    return rows, columns


def _ridge_field(values: Array, sigma_px: float) -> tuple[Array, Array]:
    """Offset (h, w, 2) from every pixel to the ridge across it, and its strength (h, w)."""
    v, u, vv, uv, uu = (
        gaussian_filter(values, sigma_px, order=order, mode="nearest")
        for order in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
    )
    angle = 0.5 * np.arctan2(2.0 * uv, uu - vv)
    across = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    along = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
    curvature, other = (
        uu * d[..., 0] ** 2 + 2 * uv * d[..., 0] * d[..., 1] + vv * d[..., 1] ** 2 for d in (across, along)
    )
    swap = np.abs(other) > np.abs(curvature)
    across, curvature = np.where(swap[..., None], along, across), np.where(swap, other, curvature)
    slope = u * across[..., 0] + v * across[..., 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        step = np.where(curvature < 0.0, -slope / curvature, np.inf)
    step = np.where(np.abs(step) < 2.0, step, 2.0)
    return step[..., None] * across, -curvature * sigma_px**2


def stripe_line(uv_px: Array, tolerance_px: float = 2.0) -> ImageLine:
    """Line through stripe points (n, 2) of which a minority may be wrong.

    Starts from the pair of points that most others support, then reweighted (Tukey) least squares on distances.
    Raises ImageError where fewer than three points are given, or no line has three.
    """
    points = np.asarray(uv_px, np.float64)
    if len(points) < 3:
        raise ImageError(f"{len(points)} stripe points do not make a line.")
    normal, offset = _consensus(points, tolerance_px)
    distance = points @ normal - offset
    for _ in range(_ROUNDS):
        near = np.abs(distance) < tolerance_px
        if np.count_nonzero(near) < 3:
            raise ImageError("the stripe's points do not lie on a line.")
        scale = max(bulk_deviation(distance[near]), _LEAST_SCALE_PX)
        weight = np.where(near, biweight(distance, scale), 0.0)
        centre, _, axes = principal_axes(points, weight)
        normal = axes[:, 0]
        offset = float(normal @ centre)
        distance = points @ normal - offset
    inliers = weight > 0.0
    rms = float(np.sqrt(np.mean(distance[inliers] ** 2)))
    return ImageLine(np.asarray(normal, np.float64), offset, rms, inliers)


def _consensus(points: Array, tolerance_px: float) -> tuple[Array, float]:
    """Normal and offset of the line through two points with the most others within the tolerance."""
    rng = np.random.default_rng(0)  # the same line for the same points
    first, second = rng.integers(0, len(points), (2, _TRIALS))
    along = points[second] - points[first]
    length = np.hypot(along[:, 0], along[:, 1])
    usable = length > 0
    if not usable.any():
        raise ImageError("the stripe's points coincide.")
    normals = np.stack([-along[usable, 1], along[usable, 0]], axis=-1) / length[usable, None]
    offsets = np.einsum("ij,ij->i", normals, points[first[usable]])
    support = (np.abs(points @ normals.T - offsets) < tolerance_px).sum(axis=0)
    best = int(np.argmax(support))
    return normals[best], float(offsets[best])
