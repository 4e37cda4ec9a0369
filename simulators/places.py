"""Places around the rig: the light that comes from every direction, as equirectangular pictures.

A picture (h, 2 h, 3) has row 0 at the top and, from left to right, azimuths from +pi down to -pi; its middle looks
along +X, +Z is up. Radiance is relative: a picture's mean is of the order of 1, lamps and suns are far above.
"""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, gaussian_filter1d

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def look(picture: Array, directions: Array) -> Array:
    """Radiance (..., 3) from directions (..., 3), linear between the picture's pixels."""
    height, width = picture.shape[:2]
    x, y, z = np.moveaxis(directions / np.linalg.norm(directions, axis=-1, keepdims=True), -1, 0)
    row = np.clip(np.arccos(np.clip(z, -1, 1)) / np.pi * height - 0.5, 0, height - 1)
    column = (np.pi - np.arctan2(y, x)) / (2 * np.pi) * width - 0.5
    top, left = np.minimum(row.astype(np.intp), height - 2), np.floor(column).astype(np.intp)
    down, right = (row - top)[..., None], (column - left)[..., None]
    near, far = left % width, (left + 1) % width
    upper = picture[top, near] * (1 - right) + picture[top, far] * right
    lower = picture[top + 1, near] * (1 - right) + picture[top + 1, far] * right
    return np.asarray(upper * (1 - down) + lower * down)


def sky(seed: int, height: int) -> Array:
    """A sky with clouds and a veiled sun over ground, trees along the horizon."""
    rng = np.random.default_rng((11, seed))
    directions, shape = _directions(height), (height, 2 * height)
    up = directions[..., 2]
    clouds = np.clip(_texture(rng, shape, 1.5), 0, 2)[..., None]
    blue = np.array([0.35, 0.6, 1.0]) * (1.2 - 0.6 * np.abs(up))[..., None]
    above = blue + clouds * 0.5
    ground = np.array([0.25, 0.22, 0.12]) * np.exp(0.5 * _texture(rng, shape, 0.8))[..., None]
    skyline = 0.03 + 0.1 * np.abs(gaussian_filter1d(rng.normal(size=2 * height), 3, mode="wrap")) * 3
    trees = np.array([0.05, 0.08, 0.03]) * np.exp(0.6 * _texture(rng, shape, 0.8))[..., None]
    picture = np.where((up > skyline)[..., None], above, np.where((up > 0)[..., None], trees, ground))
    azimuth, elevation = rng.uniform(-3, 3), np.radians(38)
    sun = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    apart = np.arccos(np.clip(directions @ sun, -1, 1))
    glow = 400.0 * np.exp(-0.5 * (apart / np.radians(1.2)) ** 2) + 4.0 * np.exp(-apart / np.radians(8))
    return np.asarray(picture + glow[..., None] * np.array([1.0, 0.9, 0.75]))


def room(seed: int, height: int) -> Array:
    """A box-shaped room with papered walls, pictures, windows and a lamp."""
    rng = np.random.default_rng((13, seed))
    directions = _directions(height)
    half = np.array([2.6, 2.1, 1.4])
    distance = (half / np.maximum(np.abs(directions), 1e-9)).min(axis=-1)
    place = directions * distance[..., None]
    wall = np.argmax(np.abs(place) / half, axis=-1)
    side = np.take_along_axis(place, wall[..., None], -1)[..., 0] > 0
    face = 2 * wall + side
    u = np.where(wall == 0, place[..., 1], place[..., 0])
    v = np.where(wall == 2, place[..., 1], place[..., 2])
    colours = rng.uniform(0.25, 0.8, (6, 3)) * np.array([1.0, 0.92, 0.8])
    shade = 0.3 + 0.25 * np.exp(-distance / 3)
    picture = colours[face] * shade[..., None] * np.exp(0.15 * _texture(rng, face.shape, 0.8))[..., None]
    for number in range(26):
        here = face == rng.integers(0, 6)
        middle, extent = rng.uniform(-1.8, 1.8, 2), rng.uniform(0.1, 0.6, 2)
        patch = here & (np.abs(u - middle[0]) < extent[0]) & (np.abs(v - middle[1]) < extent[1])
        picture[patch] = rng.uniform(0.02, 0.9, 3) * 0.5
        if number % 9 == 4:  # windows
            picture[patch] = np.array([14.0, 17.0, 22.0]) * rng.uniform(0.5, 1.5)
    lamp = directions @ (place[height // 5, height // 2] / np.linalg.norm(place[height // 5, height // 2]))
    picture += 30.0 * np.exp(-0.5 * (np.arccos(np.clip(lamp, -1, 1)) / np.radians(2)) ** 2)[..., None]
    return np.asarray(picture)


def hall(seed: int, height: int) -> Array:
    """A room under four bare lamps, ten stops over what they light."""
    directions = _directions(height)
    lamps = np.array([[1.0, 1.0, 1.3], [1.0, -1.0, 1.3], [-1.0, 1.0, 1.3], [-1.0, -1.0, 1.3]]) / np.sqrt(3.69)
    apart = np.arccos(np.clip(directions @ lamps.T, -1, 1))
    glow = 4000.0 * np.exp(-0.5 * (apart / np.radians(1.0)) ** 2).sum(axis=-1)
    return np.asarray(room(seed, height) + glow[..., None] * np.array([1.0, 0.85, 0.65]))


PLACES: Mapping[str, Callable[[int, int], Array]] = {"room": room, "sky": sky, "hall": hall}


def _directions(height: int) -> Array:
    """Unit vectors (h, 2 h, 3) through the middles of a picture's pixels."""
    polar = np.pi * (np.arange(height)[:, None] + 0.5) / height
    azimuth = np.pi - np.pi * (np.arange(2 * height) + 0.5) / height
    parts = np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar) + 0 * azimuth
    return np.stack(parts, axis=-1)


def _texture(rng: np.random.Generator, shape: tuple[int, ...], finest: float, octaves: int = 5) -> Array:
    """Noise of variance 1 that falls with the frequency, the same left and right."""
    total = np.zeros(shape)
    for octave in range(octaves):
        grain = gaussian_filter(rng.normal(size=shape), finest * 2.0**octave, mode=("nearest", "wrap"))
        total += grain / grain.std() * 1.6**octave
    # Plain where columns run together: a star at the pole would be no texture.
    return np.asarray(total / total.std()) * np.sin(np.pi * (np.arange(shape[0])[:, None] + 0.5) / shape[0])
