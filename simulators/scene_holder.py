"""The stepped white holder with a relief in its opening: first hits and shadows by marching rays over the raster."""

from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from simulators.layout import HolderLayout
from simulators.scene import Array, Floats, Hits, Mask, Material
from simulators.scene_relief import Relief

BLOCK = 8  # texels; a ray above a block's highest point skips the block
OFFSET_M = 5e-6  # shadow rays start this far off the surface: more than the sag of a bilinear patch under its arc
MISS, RELIEF, FRAME = 0, 1, 2

Box = tuple[float, float, float, float]  # half widths of opening, upper and lower frame, and the step's height
Field = tuple[Array, Array, float]  # heights, highest point of each block, side


@dataclass(frozen=True)
class HolderScene:
    """A relief in the holder; the scene's frame is the sample frame."""

    holder: HolderLayout
    relief: Relief

    @property
    def box(self) -> Box:
        """Half widths of the opening, the upper and the lower frame, and the height of the step."""
        holder = self.holder
        return holder.opening_m / 2, holder.upper_m / 2, holder.lower_m / 2, holder.step_m

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

    def trace(self, origin: Array, directions: Array) -> Hits:
        """First hits of rays from one origin (3,) along unit directions (n, 3)."""
        kinds = np.zeros(len(directions), np.uint8)
        points = np.empty((len(directions), 3))
        normals = np.zeros((len(directions), 3), np.float32)
        _trace(origin, np.ascontiguousarray(directions), self.box, self.field, (kinds, points, normals))
        ray = np.flatnonzero(kinds)
        points, normals, on_relief = points[ray], normals[ray], kinds[ray] == RELIEF
        normals[on_relief] = self._relief_normals(points[on_relief])
        return Hits(ray, points, normals, self._material(points, on_relief))

    def lit(self, hits: Hits, source: Array) -> Mask:
        """Which hits (n,) see the point source (3,)."""
        visible = np.empty(len(hits.points), np.bool_)
        _lit(hits.points, hits.normals, source, self.box, (self.field, visible))
        return visible

    def heights(self, x_m: Array, y_m: Array) -> Array:
        """Height of the relief at points (n,) of the opening."""
        found: Array = _sample(self.relief.height_m[..., None], x_m, y_m, self.relief.side_m)[:, 0]
        return found

    def _relief_normals(self, points: Array) -> Floats:
        slopes = _sample(self._slopes, points[:, 0], points[:, 1], self.relief.side_m)
        normals = np.column_stack([-slopes, np.ones(len(slopes))])
        length: Array = np.linalg.norm(normals, axis=1, keepdims=True)
        return (normals / length).astype(np.float32)

    def _material(self, points: Array, on_relief: Mask) -> Material:
        relief = self.relief
        values = np.empty((len(points), 5), np.float32)
        values[:] = (*(self.holder.albedo,) * 3, 0.0, 1.0)
        values[on_relief] = _sample(self._maps, points[on_relief, 0], points[on_relief, 1], relief.side_m)
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
def _to_square(p: Array, d: Array, half: float) -> tuple[float, float]:
    """Where the line p + t d enters and leaves the upright square prism |x|, |y| <= half; enter > leave: it misses."""
    enter, leave = -np.inf, np.inf
    for k in range(2):
        if d[k] == 0.0:
            if abs(p[k]) > half:
                return np.inf, -np.inf
            continue
        near, far = (-half - p[k]) / d[k], (half - p[k]) / d[k]
        if near > far:
            near, far = far, near
        enter, leave = max(enter, near), min(leave, far)
    return enter, leave


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
def _march(field: Field, p: Array, d: Array, start: float, end: float) -> float:
    """First t in [start, end] at which p + t d lies on or under the relief; infinity where none does."""
    texel = field[2] / field[0].shape[0]
    step = texel * 0.4 / max(abs(d[0]), abs(d[1]), 0.35 * abs(d[2]))
    t, above = start, start
    while True:
        if p[2] + t * d[2] <= _height(field, p[0] + t * d[0], p[1] + t * d[1]):
            return _refine(field, p, d, above, t)
        if t >= end:
            return np.inf
        above = t
        t = min(max(_block_exit(field, p, d, t) + 1e-9, t + step), end)


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
def _side_normal(point: Array, sign: float, normal: Floats) -> None:
    """Normal of an upright wall at this point: outward for sign +1, into the opening for -1."""
    k = 0 if abs(point[0]) > abs(point[1]) else 1
    normal[0] = normal[1] = normal[2] = 0.0
    normal[k] = sign if point[k] > 0 else -sign


@numba.njit(cache=True)
def _hit(p: Array, d: Array, box: Box, field: Field, normal: Floats) -> tuple[int, float]:
    """Kind and parameter of the first hit of one ray from outside; writes the normal of what is not relief."""
    opening, upper, lower, step = box
    normal[2] = 1.0
    if d[2] < 0.0 and p[2] > 0.0:
        top = -p[2] / d[2]
        x, y = abs(p[0] + top * d[0]), abs(p[1] + top * d[1])
        if max(x, y) <= opening:
            _, wall = _to_square(p, d, opening)
            t = _march(field, p, d, top, wall)
            if t < np.inf:
                return RELIEF, t
            _side_normal(p + wall * d, -1.0, normal)
            return FRAME, wall
        if max(x, y) <= upper:
            return FRAME, top
    enter, leave = _to_square(p, d, upper)
    if 0.0 < enter < leave and -step <= p[2] + enter * d[2] <= 0.0:
        _side_normal(p + enter * d, 1.0, normal)
        return FRAME, enter
    bottom = (-step - p[2]) / d[2] if d[2] < 0.0 else -1.0
    if bottom > 0.0 and max(abs(p[0] + bottom * d[0]), abs(p[1] + bottom * d[1])) <= lower:
        return FRAME, bottom
    return MISS, 0.0


@numba.njit(cache=True)
def _trace(
    origin: Array, directions: Array, box: Box, field: Field, out: tuple[NDArray[np.uint8], Array, Floats]
) -> None:
    kinds, points, normals = out
    for i in range(len(directions)):
        kinds[i], t = _hit(origin, directions[i], box, field, normals[i])
        points[i] = origin + t * directions[i]


@numba.njit(cache=True)
def _lit(points: Array, normals: Floats, source: Array, box: Box, more: tuple[Field, Mask]) -> None:
    field, visible = more
    opening, upper, _, _ = box
    p, d = np.empty(3), np.empty(3)
    for i in range(len(points)):
        for k in range(3):
            p[k] = points[i, k] + OFFSET_M * normals[i, k]
            d[k] = source[k] - p[k]
        if d[0] * normals[i, 0] + d[1] * normals[i, 1] + d[2] * normals[i, 2] <= 0.0:
            visible[i] = False
        elif p[2] >= 0.0:
            visible[i] = d[2] > 0.0
        else:
            visible[i] = _climbs_out(p, d, opening, upper, field)


@numba.njit(cache=True)
def _climbs_out(p: Array, d: Array, opening: float, upper: float, field: Field) -> bool:
    """Whether the way from p under the reference plane to p + d is free."""
    top = -p[2] / d[2] if d[2] > 0.0 else 1.0  # of the way; the holder ends at the reference plane
    if max(abs(p[0]), abs(p[1])) <= opening:
        _, wall = _to_square(p, d, opening)
        return wall >= top and _march(field, p, d, 0.0, top) == np.inf
    enter, leave = _to_square(p, d, upper)
    return not (enter < leave and leave > 0.0 and enter < top)
