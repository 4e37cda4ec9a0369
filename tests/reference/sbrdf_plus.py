"""SBRDF+ of random parameters, to write, read and draw."""

import numpy as np

from processing.products import DirectionMesh, LafortuneTexels, Provenance, SbrdfPlus


def directions(count, rng):
    """Unit vectors (count, 3) above the horizon, spread by Fibonacci's spiral from the normal down to 75 degrees."""
    z = 1 - np.arange(count) / max(count - 1, 1) * (1 - np.cos(np.radians(75)))
    azimuth = np.arange(count) * np.pi * (3 - np.sqrt(5)) + rng.uniform(0, 1)
    return np.stack([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z], axis=1)


def lobes(height, width, rng, *, count=3, shared=False):
    """Lobes whose largest |C_i| is 1; the last of every other texel is absent."""
    axis = rng.uniform(-1, 1, (height, width, 1 if shared else count, 3))
    axis = np.repeat(axis / np.abs(axis).max(axis=-1, keepdims=True), count // axis.shape[2], axis=2)
    diffuse = rng.uniform(0, 0.3, (height, width, 1 if shared else 3))
    exponent, albedo = rng.uniform(1, 30, (height, width, count)), rng.uniform(0.01, 0.2, (height, width, count, 3))
    absent = np.arange(height * width).reshape(height, width) % 2 == 1
    axis[absent, -1], exponent[absent, -1], albedo[absent, -1] = 0, 1, 0
    found = (np.broadcast_to(diffuse, (height, width, 3)), axis, exponent, albedo)
    return LafortuneTexels(*(array.astype(np.float32) for array in found))


def product(seed=0, *, lights=9, views=7, height=6, width=10, centres=20, hidden=0.3, shared=False):
    """An SBRDF+ of `hidden` points in so many, shifts within a tenth of the tile, and an origin to tell."""
    rng = np.random.default_rng(seed)
    shape = (views, height, width)
    return SbrdfPlus(
        lobes(height, width, rng, shared=shared),
        rng.uniform(0, 1, (lights, height, width)).astype(np.float32),
        (rng.uniform(-0.1, 0.1, (*shape, 2)) * (width, height)).astype(np.float32),
        (rng.uniform(size=shape) < hidden) & (centres > 0),
        rng.integers(0, max(centres, 1), shape).astype(np.uint16),
        rng.uniform(0, 0.3, (centres, lights, 3)).astype(np.float32),
        DirectionMesh.from_directions(directions(lights, rng)),
        DirectionMesh.from_directions(directions(views, rng)),
        Provenance(("frame",), "calibration", {"seed": seed}),
    )
