"""Plain twin of the fit of relightable images, and pictures of a bumpy, slightly glossy board to fit."""

import numpy as np

from processing.radiometry.display import srgb


def least_squares(values, functions, tolerance):
    """Coefficients (k, ...) of each column of values (light, ...) on its own, NaN left out, by numpy's own solver."""
    columns = values.reshape(len(values), -1).astype(np.float64)
    out = np.zeros((functions.shape[1], columns.shape[1]))
    for index, column in enumerate(columns.T):
        used = np.isfinite(column)
        if used.any():
            out[:, index] = np.linalg.lstsq(functions[used], column[used], rcond=tolerance)[0]
    return out.reshape(-1, *values.shape[1:])


def dome(count, lowest=0.15):
    """Unit directions (count, 3) over the hemisphere above a height, along a spiral of equal areas."""
    height = lowest + (1 - lowest) * (np.arange(count) + 0.5) / count
    azimuth = np.arange(count) * np.pi * (3 - np.sqrt(5))
    level = np.sqrt(1 - height**2)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), height], axis=-1)


def board(lights, size=(48, 64), seed=0):
    """Display values (light, y, x, 3) uint8 of a matt coloured board with bumps, gloss and own shadows."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: size[0], : size[1]]
    phases, waves = rng.uniform(0, 2 * np.pi, (2, 6)), rng.uniform(0.1, 0.7, (2, 6))
    slopes = [
        0.25 * np.cos(np.multiply.outer(x + 0.3 * y if a else y - 0.3 * x, waves[a]) + phases[a]).sum(axis=-1)
        for a in (1, 0)
    ]
    normal = np.stack([*slopes, np.ones(size)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    albedo = 0.2 + 0.6 * rng.uniform(size=3) * (0.5 + 0.5 * rng.uniform(size=(*size, 1)))
    matt = np.maximum(np.einsum("yxi,li->lyx", normal, lights), 0)
    half = lights + np.array([0, 0, 1.0])
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    gloss = np.maximum(np.einsum("yxi,li->lyx", normal, half), 0) ** 20 * (matt > 0)
    seen = albedo * matt[..., None] + 0.15 * gloss[..., None]
    noisy = seen + rng.normal(0, 0.003, seen.shape)
    return np.round(255 * srgb(noisy)).astype(np.uint8)
