"""MERL files made of any reflectance, and read as the published reader does: the cell that a pair of directions is in.

Directions and angles are taken apart by rotations, as there, not by the products of cosines that the project uses.
"""

import numpy as np
from scipy.spatial.transform import Rotation

SHAPE = 90, 90, 180
SCALES = np.array([1.0, 1.15, 1.66]) / 1500


def directions_of(half, difference, azimuth):
    """Light and view (n, 3) of half angles, difference angles and difference azimuths (n,) in rad."""
    toward = np.stack([np.sin(difference) * np.cos(azimuth), np.sin(difference) * np.sin(azimuth), np.cos(difference)])
    tilt = Rotation.from_rotvec(np.stack([0 * half, half, 0 * half], axis=1))
    light = tilt.apply(toward.T)
    middle = tilt.apply([0.0, 0.0, 1.0])
    return light, 2 * (light * middle).sum(axis=1, keepdims=True) * middle - light


def angles_of(light, view):
    """Half angle, difference angle and difference azimuth (0 to 2 pi) of pairs (n, 3)."""
    middle = light + view
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    half, turn = np.arccos(np.clip(middle[:, 2], -1, 1)), np.arctan2(middle[:, 1], middle[:, 0])
    level = Rotation.from_rotvec(np.stack([0 * turn, 0 * turn, -turn], axis=1)).apply(light)
    upright = Rotation.from_rotvec(np.stack([0 * half, -half, 0 * half], axis=1)).apply(level)
    azimuth = np.arctan2(upright[:, 1], upright[:, 0]) % (2 * np.pi)
    return half, np.arccos(np.clip(upright[:, 2], -1, 1)), azimuth


def cells_of(brdf):
    """Values (90, 90, 180, 3) of a reflectance in the middles of the cells, -1 where one direction is too low."""
    half, difference, azimuth = np.meshgrid(*((np.arange(n) + 0.5) / n for n in SHAPE), indexing="ij")
    angles = half.ravel() ** 2 * np.pi / 2, difference.ravel() * np.pi / 2, azimuth.ravel() * np.pi
    light, view = directions_of(*angles)
    values = brdf.evaluate(light, view)
    values[np.minimum(light[:, 2], view[:, 2]) <= 0] = -1
    return values.reshape(*SHAPE, 3)


def write_merl(path, values):
    """Values (90, 90, 180, 3) in 1/sr as such a file."""
    stored = np.moveaxis(values / SCALES, -1, 0).astype("<f8")
    path.write_bytes(np.array(SHAPE, "<i4").tobytes() + stored.tobytes())


def looked_up(values, light, view):
    """Values (n, 3) of the cells that pairs of directions lie in."""
    half, difference, azimuth = angles_of(light, view)
    shares = np.sqrt(half / (np.pi / 2)), difference / (np.pi / 2), azimuth % np.pi / np.pi
    return values[tuple(np.minimum((share * n).astype(int), n - 1) for share, n in zip(shares, SHAPE, strict=True))]
