"""Stone, cloth and bricks by formula: heights and colours over one period, and the SRF of their Lambertian surface."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from processing.products import BlinnPhong, ResidualBasis, Srf

Array = NDArray[np.float64]


def skin_sample(name: str, texels: int, seed: int) -> Srf:
    """An SRF of one period whose residual is the best of s . H for a bumpy, coloured Lambertian surface."""
    rng = np.random.default_rng(seed)
    height, colour = {"stone": _stone, "cloth": _cloth, "brick": _brick}[name](rng, texels)
    slope_x = (np.roll(height, -1, 1) - np.roll(height, 1, 1)) / 2
    slope_y = (np.roll(height, 1, 0) - np.roll(height, -1, 0)) / 2
    normals = np.stack([-slope_x, -slope_y, np.ones_like(height)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    light = _spread(60)
    view = light[np.arange(60) * 23 % 60]
    radiance = np.maximum(np.einsum("yxi,li->lyx", normals, light), 0.0)[..., None] * colour / np.pi
    lobe = BlinnPhong(0.9 / np.pi * colour.mean(axis=(0, 1)), np.full(3, 0.04), 20.0)
    basis = ResidualBasis.HALF
    rest = radiance - lobe.evaluate(light, view)[:, None, None]
    solved = np.linalg.pinv(basis.evaluate(light, view)) @ rest.reshape(len(light), -1)
    residual = np.moveaxis(solved.reshape(basis.size, texels, texels, 3), (0, 3), (3, 0))
    return Srf(np.ascontiguousarray(residual, np.float32), lobe, wrap=True, basis=basis)


def _stone(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    veins = np.exp(-((_noise(rng, n, 2, 8) / 0.12) ** 2))
    grey = (0.35 + 0.06 * _noise(rng, n, 2, n / 6)) * (1 - 0.5 * veins)
    return n / 250 * _noise(rng, n, 3, n / 8), np.clip(grey[..., None] * [1.05, 1.0, 0.92], 0.02, 0.95)


def _cloth(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    across, along = (8.0 * axis / n for axis in np.meshgrid(np.arange(n), np.arange(n)))
    over = (np.floor(across) + np.floor(along)) % 2 > 0
    x, y = across % 1 - 0.5, along % 1 - 0.5
    arch = np.where(over, np.sqrt(0.3 - y**2) - 0.8 * x**2, np.sqrt(0.3 - x**2) - 0.8 * y**2)
    threads = np.where(over[..., None], [0.45, 0.12, 0.10], [0.12, 0.15, 0.40])
    return n / 24 * arch, np.clip(threads * (1 + 0.08 * _noise(rng, n, 4, n / 3))[..., None], 0.02, 0.95)


def _brick(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    column, row = np.meshgrid(np.arange(n) / n, np.arange(n) / n)
    course = np.floor(6 * row)
    place = (3 * column + course % 2 / 2) % 3
    inside = (6 * row % 1 > 0.12) & (place % 1 > 0.06)
    tone = rng.uniform(0.7, 1.2, (6, 3))[course.astype(int), np.floor(place).astype(int)]
    colour = np.where(inside[..., None], tone[..., None] * [0.50, 0.20, 0.14], [0.45, 0.43, 0.40])
    height = gaussian_filter(inside.astype(float), 1.5, mode="wrap") * n / 30 + n / 250 * _noise(rng, n, 6, n / 4)
    return height, np.clip(colour * (1 + 0.08 * _noise(rng, n, 3, n / 3))[..., None], 0.02, 0.95)


def _noise(rng: np.random.Generator, n: int, lowest: float, highest: float) -> Array:
    """Periodic noise of unit variance, falling with the frequency between two numbers of waves per period."""
    waves = np.hypot(*np.meshgrid(np.fft.fftfreq(n) * n, np.fft.fftfreq(n) * n))
    passed = np.where((waves >= lowest) & (waves <= highest), 1 / np.maximum(waves, 1), 0.0)
    value = np.fft.ifft2(np.fft.fft2(rng.normal(size=(n, n))) * passed).real
    return np.asarray(value / value.std())


def _spread(count: int) -> Array:
    """Directions down to 10 deg over the horizon, by Fibonacci's spiral."""
    k = np.arange(count)
    z = 1 - (k + 0.5) / count * 0.83
    azimuth = k * np.pi * (3 - np.sqrt(5))
    return np.stack([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z], axis=1)
