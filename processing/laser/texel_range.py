"""From pixels to texels: the displacement along the view ray through every texel of the reference plane.

A texel's view ray is the pixel ray through the image of its reference point, so this is interpolation in the image at
known places, and one resampling in all.
"""

import numpy as np
from numpy.typing import NDArray

from processing.robust import weighted_median_place

Array = NDArray[np.float64]
_SIGMA_PX = 0.5  # of the kernel, or _SIGMA_TEXEL of a texel where that is larger
_SIGMA_TEXEL = 0.25
_REACH = 2.5  # sigmas of the kernel
_NEAR = 1.9  # sigmas within which a pixel must lie: any texel between four measured ones has one
_ROUGHNESS_M = 40e-6  # of the surface within a kernel, about a plane
_SLOPE = 1.0  # displacement per distance on the plane that still counts as one surface
_CHUNK = 16384


def texel_displacement(
    displacement_m: NDArray[np.floating], variance_m2: NDArray[np.floating], uv_px: Array, pitch_m: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Displacement (n, n) and variance at texels `pitch_m` apart, seen at image points `uv_px` (n, n, 2).

    The pixels around a texel vote for one surface (weighted median, so that no value lies between two), and a plane
    through those that lie on it gives the value at the texel's own place. NaN where no measured pixel of that surface
    is near.
    """
    values, variances = np.asarray(displacement_m, np.float64), np.asarray(variance_m2, np.float64)
    sigma_px, pixel_m = _kernel(uv_px, pitch_m)
    places = uv_px.reshape(-1, 2)
    found = np.full((len(places), 2), np.nan)
    margin = _REACH * sigma_px
    seen = np.flatnonzero(((places > -margin) & (places < np.array(values.shape[::-1]) + margin)).all(axis=1))
    for start in range(0, len(seen), _CHUNK):
        part = seen[start : start + _CHUNK]
        found[part] = _interpolate(values, variances, places[part], sigma_px, pixel_m)
    grid = found.reshape(*uv_px.shape[:2], 2).astype(np.float32)
    return grid[..., 0], grid[..., 1]


def _kernel(uv_px: Array, pitch_m: float) -> tuple[Array, Array]:
    """Kernel's sigma (u, v) in pixels, and a pixel's extent (u, v) on the reference plane in metres."""
    steps = [np.abs(np.diff(uv_px, axis=axis)).reshape(-1, 2) for axis in (0, 1)]
    known = [step[np.isfinite(step).all(axis=1)] for step in steps]
    if min(len(step) for step in known) == 0:
        return np.full(2, _SIGMA_PX), np.full(2, pitch_m)
    per_texel = np.maximum(*(np.median(step, axis=0) for step in known))
    return np.maximum(_SIGMA_PX, _SIGMA_TEXEL * per_texel), pitch_m / np.maximum(per_texel, 1e-3)


def _interpolate(values: Array, variances: Array, places: Array, sigma_px: Array, pixel_m: Array) -> Array:
    """Value and variance (n, 2) at image points (n, 2)."""
    offset, value, variance = _neighbours(values, variances, places, np.ceil(_REACH * sigma_px).astype(int))
    measured = np.isfinite(value) & (variance > 0.0)
    kernel = np.exp(-0.5 * ((offset / sigma_px) ** 2).sum(axis=-1))
    noise = np.where(measured, variance, 0.0) + _ROUGHNESS_M**2
    weight = np.where(measured, kernel / noise, 0.0)
    distance_m = np.hypot(offset[..., 0] * pixel_m[0], offset[..., 1] * pixel_m[1])
    value = np.where(measured, value, 0.0)
    middle = np.take_along_axis(value, weighted_median_place(value, weight, axis=1), axis=1)
    surface = np.abs(value - middle) < 4.0 * np.sqrt(noise) + _SLOPE * distance_m
    other = np.where(surface, 0.0, weight)
    weight = np.where(surface, weight, 0.0)
    apart = np.where(weight > 0.0, ((offset / sigma_px) ** 2).sum(axis=-1), np.inf).min(axis=1)
    near = apart < _NEAR**2
    result = _plane(offset, value, weight, noise, _SLOPE * pixel_m)
    result[:, 1] += _doubt(value, weight, other, result[:, 0])
    return np.where(near[:, None], result, np.nan)


def _doubt(value: Array, weight: Array, other: Array, chosen: Array) -> Array:
    """Variance (n) of having chosen one surface where `other` weights speak for another one."""
    against = other.sum(axis=1)
    share = against / np.maximum(weight.sum(axis=1) + against, 1e-300)
    apart = (other * (value - chosen[:, None]) ** 2).sum(axis=1) / np.maximum(against, 1e-300)
    return np.asarray(share * (1.0 - share) * apart)


def _neighbours(values: Array, variances: Array, places: Array, reach: NDArray[np.int_]) -> tuple[Array, Array, Array]:
    """Offsets (n, m, 2) in pixels from the places to the pixels around them, values and variances (n, m)."""
    across, down = (np.arange(-r, r + 1) for r in reach)
    around = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    pixel = np.rint(places).astype(int)[:, None] + around
    size = np.array([values.shape[1], values.shape[0]])
    inside = ((pixel >= 0) & (pixel < size)).all(axis=-1)
    column, row = np.moveaxis(np.clip(pixel, 0, size - 1), -1, 0)
    return pixel - places[:, None], np.where(inside, values[row, column], np.nan), variances[row, column]


def _plane(offset: Array, value: Array, weight: Array, noise: Array, slope: Array) -> Array:
    """Value at offset 0 (n) of weighted planes with a prior on their slopes per pixel, and its variance: (n, 2).

    The variance grows with the scatter about the plane where that exceeds the noise: structure below a pixel.
    """
    total = np.maximum(weight.sum(axis=1), 1e-300)[:, None]
    basis = np.concatenate([np.ones((*offset.shape[:2], 1)), offset], axis=-1)
    share = weight / total
    normal = np.einsum("nmi,nm,nmj->nij", basis, share, basis)
    typical = (share**2 * noise).sum(axis=1)
    normal[:, 1, 1] += typical / slope[0] ** 2
    normal[:, 2, 2] += typical / slope[1] ** 2
    normal += 1e-12 * np.eye(3)
    row = np.linalg.solve(normal, np.broadcast_to([[1.0], [0.0], [0.0]], (len(normal), 3, 1)))[..., 0]
    linear = np.einsum("nmi,ni,nm->nm", basis, row, share)
    moment = np.einsum("nmi,nm,nm->ni", basis, share, value)
    surface = np.einsum("nmi,ni->nm", basis, np.linalg.solve(normal, moment[..., None])[..., 0])
    scatter = (share * (value - surface) ** 2).sum(axis=1) / np.maximum((share * noise).sum(axis=1), 1e-300)
    variance = (linear**2 * noise).sum(axis=1) * np.maximum(scatter, 1.0)
    return np.stack([(linear * value).sum(axis=1), variance], axis=-1)
