"""Steger's ridge in plain NumPy and SciPy, whole images at a time."""

import numpy as np
from scipy.ndimage import correlate1d


def ridge_points(image, sigma_px, threshold, mask):
    """Points (n, 2), strengths and next strongest ones per row, as `processing.laser.ridge.stripe_ridge` gives them."""
    offset, strength = ridge_field(np.asarray(image, np.float64), sigma_px)
    strength = np.where((np.abs(offset).max(axis=-1) <= 0.6) & mask & (strength > threshold), strength, 0.0)
    rows, columns = np.arange(len(strength)), np.argmax(strength, axis=1)
    apart = np.abs(np.arange(strength.shape[1]) - columns[:, None]) > 3.0 * sigma_px
    rival = np.where(apart, strength, 0.0).max(axis=1)
    found = strength[rows, columns] > 0.0
    rows, columns = rows[found], columns[found]
    return np.stack([columns, rows], axis=-1) + offset[rows, columns], strength[rows, columns], rival[found]


def ridge_field(values, sigma_px):
    """Offset (h, w, 2) from every pixel to the ridge across it, and its strength (h, w)."""
    x = np.arange(-2 * int(np.ceil(2.0 * sigma_px)), 2 * int(np.ceil(2.0 * sigma_px)) + 1)
    gauss = np.exp(-0.5 * (x / sigma_px) ** 2)
    gauss /= gauss.sum()
    slope = x * gauss / (x**2 * gauss).sum()
    bend = (x**2 - (x**2 * gauss).sum()) * gauss
    bend *= 2.0 / (x**2 * bend).sum()
    v, u, vv, uv, uu = (
        correlate1d(correlate1d(values, down, axis=0, mode="nearest"), along, axis=1, mode="nearest")
        for down, along in ((slope, gauss), (gauss, slope), (bend, gauss), (slope, slope), (gauss, bend))
    )
    curvatures, axes = np.linalg.eigh(np.stack([np.stack([uu, uv], -1), np.stack([uv, vv], -1)], -2))
    most = np.argmax(np.abs(curvatures), axis=-1)[..., None]
    curvature = np.take_along_axis(curvatures, most, axis=-1)[..., 0]
    across = np.take_along_axis(axes, most[..., None], axis=-1)[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        step = np.where(curvature < 0.0, -(u * across[..., 0] + v * across[..., 1]) / curvature, np.inf)
    step = np.where(np.isfinite(step), step, 9.0)
    step *= 2.0 / (1.0 + np.sqrt(1.0 + 2.0 * (step / sigma_px) ** 2))
    return step[..., None] * across, -curvature * sigma_px**2
