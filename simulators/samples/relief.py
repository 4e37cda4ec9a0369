"""Reliefs: height and material on a square raster; first hits and shadows by marching rays over it.

Texel (row, column) of n lies at x = (column + 0.5) / n * side - side / 2, y = side / 2 - (row + 0.5) / n * side.
"""

from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np
from scipy.ndimage import maximum_filter

from simulators.scene import Array, Floats, Hits, Mask, Material

BLOCK = 8  # texels; a ray above a block's highest point skips the block

Field = tuple[Array, Array, float]  # heights, highest point of each block, side


@dataclass(frozen=True)
class Relief:
    """`height_m` (n, n) at or below 0; `albedo` (n, n, 3), `specular` (n, n) and `roughness` (n, n) of the surface."""

    side_m: float
    height_m: Array
    albedo: Array
    specular: Array
    roughness: Array


def flat_relief(side_m: float, height_m: float, albedo: float, n: int = 8) -> Relief:
    """A matt plate at one height."""
    colour = np.full((n, n, 3), albedo)
    return Relief(side_m, np.full((n, n), height_m), colour, np.zeros((n, n)), np.ones((n, n)))


@dataclass(frozen=True)
class ReliefSample:
    """A height field in the holder's opening."""

    relief: Relief
    offset_m: float = 5e-6

    @cached_property
    def field(self) -> Field:
        """Heights, highest point per block, and side, as the kernels want them."""
        height = np.ascontiguousarray(self.relief.height_m)
        return height, _block_heights(height), self.relief.side_m

    @cached_property
    def _slopes(self) -> Array:
        """Slopes along x and y (n, n, 2) of the relief, which is periodic."""
        around = np.pad(self.relief.height_m, 1, mode="wrap")
        along_x, along_y = around[1:-1, 2:] - around[1:-1, :-2], around[:-2, 1:-1] - around[2:, 1:-1]
        return np.stack([along_x, along_y], axis=-1) * len(self.relief.height_m) / (2 * self.relief.side_m)

    @cached_property
    def _maps(self) -> Array:
        """Albedo, specular and roughness (n, n, 5) of the relief."""
        return np.dstack([self.relief.albedo, self.relief.specular, self.relief.roughness])

    def trace(self, starts: Array, ways: Array) -> Hits:
        """First hits on the ways (n, 3) from points (n, 3) above the relief."""
        shares = np.empty(len(starts))
        _first(starts, ways, self.field, shares)
        ray = np.flatnonzero(shares < np.inf)
        points = starts[ray] + shares[ray, None] * ways[ray]
        return Hits(ray, points, self._normals(points), self._material(points))

    def blocks(self, starts: Array, ways: Array) -> Mask:
        """Which ways (n, 3) from points (n, 3) above the relief it crosses."""
        shares = np.empty(len(starts))
        _first(starts, ways, self.field, shares)
        return shares < np.inf

    def heights(self, x_m: Array, y_m: Array) -> Array:
        """Height of the relief at points (n,) of the opening."""
        found: Array = _sample(self.relief.height_m[..., None], x_m, y_m, self.relief.side_m)[:, 0]
        return found

    def _normals(self, points: Array) -> Floats:
        slopes = _sample(self._slopes, points[:, 0], points[:, 1], self.relief.side_m)
        normals = np.column_stack([-slopes, np.ones(len(slopes))])
        length: Array = np.linalg.norm(normals, axis=1, keepdims=True)
        return (normals / length).astype(np.float32)

    def _material(self, points: Array) -> Material:
        values = _sample(self._maps, points[:, 0], points[:, 1], self.relief.side_m).astype(np.float32)
        return Material(values[:, :3].copy(), values[:, 3].copy(), values[:, 4].copy())


def _block_heights(height: Array) -> Array:
    """Highest point of each block of texels, those around it included that bilinear interpolation reaches."""
    wide = maximum_filter(height, 3, mode="nearest")
    n = len(height)
    blocks = -(-n // BLOCK)
    padded = np.pad(wide, (0, blocks * BLOCK - n), mode="edge")
    highest: Array = padded.reshape(blocks, BLOCK, blocks, BLOCK).max(axis=(1, 3))
    return highest


@numba.njit(cache=True)
def _sample(maps: Array, x_m: Array, y_m: Array, side_m: float) -> Array:
    """Bilinear values (n, k) of maps (rows, columns, k), clamped at the border."""
    size, channels = maps.shape[0], maps.shape[2]
    out = np.empty((x_m.size, channels))
    for i in range(x_m.size):
        col = min(max((x_m[i] / side_m + 0.5) * size - 0.5, 0.0), size - 1.0)
        row = min(max((0.5 - y_m[i] / side_m) * size - 0.5, 0.0), size - 1.0)
        c, r = min(int(col), size - 2), min(int(row), size - 2)
        fc, fr = col - c, row - r
        for k in range(channels):
            upper = maps[r, c, k] * (1 - fc) + maps[r, c + 1, k] * fc
            lower = maps[r + 1, c, k] * (1 - fc) + maps[r + 1, c + 1, k] * fc
            out[i, k] = upper * (1 - fr) + lower * fr
    return out


@numba.njit(cache=True)
def _height(field: Field, x: float, y: float) -> float:
    height, _, side = field
    size = height.shape[0]
    col = min(max((x / side + 0.5) * size - 0.5, 0.0), size - 1.0)
    row = min(max((0.5 - y / side) * size - 0.5, 0.0), size - 1.0)
    c, r = min(int(col), size - 2), min(int(row), size - 2)
    fc, fr = col - c, row - r
    upper = height[r, c] * (1 - fc) + height[r, c + 1] * fc
    lower = height[r + 1, c] * (1 - fc) + height[r + 1, c + 1] * fc
    found: float = upper * (1 - fr) + lower * fr
    return found


@numba.njit(cache=True)
def _block_exit(field: Field, p: Array, d: Array, t: float) -> float:
    """Where the ray leaves the block that it is in, if it stays above the block's highest point; else t itself."""
    height, blocks, side = field
    block_m = side / height.shape[0] * BLOCK
    x, y = p[0] + t * d[0] + side / 2, side / 2 - p[1] - t * d[1]
    bx = min(max(int(x / block_m), 0), blocks.shape[1] - 1)
    by = min(max(int(y / block_m), 0), blocks.shape[0] - 1)
    leave = t + 4 * side
    if d[0] != 0.0:
        leave = min(leave, t + ((bx + (d[0] > 0)) * block_m - x) / d[0])
    if d[1] != 0.0:
        leave = min(leave, t + ((by + (d[1] < 0)) * block_m - y) / -d[1])
    lowest = p[2] + min(t * d[2], leave * d[2])
    return max(leave, t) if lowest > blocks[by, bx] else t


@numba.njit(cache=True)
def _march(field: Field, p: Array, d: Array) -> float:
    """First t in [0, 1] at which p + t d lies on or under the relief; infinity where none does."""
    texel = field[2] / field[0].shape[0]
    step = texel * 0.4 / max(abs(d[0]), abs(d[1]), 0.35 * abs(d[2]))
    t, above = 0.0, 0.0
    while True:
        if p[2] + t * d[2] <= _height(field, p[0] + t * d[0], p[1] + t * d[1]):
            return _refine(field, p, d, above, t)
        if t >= 1.0:
            return np.inf
        above = t
        t = min(max(_block_exit(field, p, d, t) + 1e-9, t + step), 1.0)


@numba.njit(cache=True)
def _refine(field: Field, p: Array, d: Array, above: float, under: float) -> float:
    """The crossing between two parameters, by bisection to about a nanometre."""
    for _ in range(24):
        middle = 0.5 * (above + under)
        if p[2] + middle * d[2] <= _height(field, p[0] + middle * d[0], p[1] + middle * d[1]):
            under = middle
        else:
            above = middle
    return under


@numba.njit(cache=True)
def _first(starts: Array, ways: Array, field: Field, shares: Array) -> None:
    for i in range(len(starts)):
        shares[i] = _march(field, starts[i], ways[i])
