"""Height fields under near and distant lights, with shadows and highlights: independent of photometric stereo.

Lengths are in units of the picture's half width; x right, y up the picture, z toward the camera.
"""

import numpy as np


def grid(size):
    """x and y (size, size) of the pixel centres."""
    x = (np.arange(size) + 0.5) * (2 / size) - 1
    return np.meshgrid(x, -x)


def ball(size, radius=0.9):
    """Height and normals of a ball's front half, NaN beside it."""
    x, y = grid(size)
    squared = radius**2 - x**2 - y**2
    z = np.where(squared > (0.1 * radius) ** 2, np.sqrt(np.maximum(squared, 0)), np.nan)
    return z, np.stack([x, y, z], axis=-1) / radius


def hills(size, seed, count=6, height=0.25):
    """Height and normals of smooth hills and hollows."""
    rng = np.random.default_rng(seed)
    x, y = grid(size)
    z, slope_x, slope_y = np.zeros_like(x), np.zeros_like(x), np.zeros_like(x)
    for _ in range(count):
        (a, b), width = rng.uniform(-0.7, 0.7, 2), rng.uniform(0.18, 0.4)
        bump = rng.uniform(-height, height) * np.exp(-((x - a) ** 2 + (y - b) ** 2) / (2 * width**2))
        z += bump
        slope_x += -bump * (x - a) / width**2
        slope_y += -bump * (y - b) / width**2
    normal = np.stack([-slope_x, -slope_y, np.ones_like(z)], axis=-1)
    return z, normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def dome(count, lowest_deg=25.0):
    """Unit vectors (count, 3) spread evenly over a dome down to an elevation over the picture's plane."""
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    z = np.linspace(np.sin(np.radians(lowest_deg)), 0.98, count)
    return np.stack([np.cos(turn), np.sin(turn), z / np.sqrt(1 - z**2)], axis=1) * np.sqrt(1 - z**2)[:, None]


def shaded(shape, lights, distances=None, *, albedo=(0.6, 0.5, 0.4), gloss=0.0, exponent=60.0, cast=False):
    """Reflectance (light, y, x, 3) in 1/sr with the cosine and a near light's falloff inside; NaN beside the shape."""
    height, normal = shape
    x, y = grid(len(height))
    points = np.stack([x, y, height], axis=-1)
    images = []
    for number, light in enumerate(lights):
        way = np.broadcast_to(light, points.shape)
        fall = 1.0
        if distances is not None:
            way = light * distances[number] - points
            length = np.linalg.norm(way, axis=-1, keepdims=True)
            way, fall = way / length, (distances[number] / length) ** 2
        cosine = (way * normal).sum(axis=-1, keepdims=True)
        half = way + np.array([0.0, 0.0, 1.0])
        half = (half * normal).sum(axis=-1, keepdims=True) / np.linalg.norm(half, axis=-1, keepdims=True)
        shine = gloss * np.maximum(half, 0) ** exponent
        image = (np.array(albedo) / np.pi * np.maximum(cosine, 0) + shine * (cosine > 0)) * fall
        images.append(np.where(shadow(height, light)[..., None], 0.0, image) if cast else image)
    return np.stack(images)


def shadow(height, light):
    """Whether the shape itself stands before a distant light, by steps of half a pixel along the ray."""
    size = len(height)
    column, row = np.meshgrid(np.arange(size, dtype=float), np.arange(size, dtype=float))
    level, hidden = height.copy(), np.zeros(height.shape, bool)
    step = 0.5 / max(np.abs(light[:2]).max(), 1e-9)
    for _ in range(4 * size):
        column, row, level = column + step * light[0], row - step * light[1], level + step * light[2] * 2 / size
        inside = (column >= 0) & (column <= size - 1) & (row >= 0) & (row <= size - 1)
        if not (inside & (level < np.nanmax(height))).any():
            break
        nearest = height[
            np.clip(row, 0, size - 1).round().astype(int), np.clip(column, 0, size - 1).round().astype(int)
        ]
        hidden |= inside & (nearest > level + 2 / size)
    return hidden
