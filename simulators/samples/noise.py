"""Periodic noise and soft steps, of which the samples' surfaces are made."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

Array = NDArray[np.float64]


def band_noise(rng: np.random.Generator, n: int, band: tuple[float, float], slope: float) -> Array:
    """Periodic Gaussian noise (n, n) of unit variance; frequencies, from low to high, count waves across the field.

    Its amplitude falls as frequency^-(slope + 0.5).
    """
    low, high = band
    frequency = np.fft.fftfreq(n, 1 / n)
    radius = np.hypot(*np.meshgrid(frequency, frequency))
    inside = (radius >= low) & (radius <= high)
    amplitude = np.where(inside, np.maximum(radius, 1.0) ** -(slope + 0.5), 0.0)
    field = np.fft.ifft2(np.fft.fft2(rng.standard_normal((n, n))) * amplitude).real
    scaled: Array = field / field.std()
    return scaled


def smooth_noise(rng: np.random.Generator, shape: tuple[int, ...], widths: tuple[float, ...]) -> Array:
    """Periodic Gaussian noise of this shape and unit variance, smoothed over `widths` samples along each axis."""
    field = gaussian_filter(rng.standard_normal(shape), widths, mode="wrap")
    scaled: Array = field / field.std()
    return scaled


def smooth_step(low: float, high: float, values: Array) -> Array:
    """0 up to `low`, 1 from `high` on, and smooth between."""
    share = np.clip((values - low) / (high - low), 0, 1)
    return np.asarray(share * share * (3 - 2 * share))
