"""Normals and albedo of any object from pictures under known lights."""

from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import minimize_scalar

from processing.materials import photometric_kernel as kernel
from processing.materials.surface import integrate
from processing.products import LightStack, NormalMap, plane_points
from processing.products.arrays import Float32, Float64

_MOST_TAKEN = 32  # samples that a start is chosen by
_MOST_TRIPLES = 64  # 40 % of shadow and highlight leave no good triple among them once in ten million pixels
_COARSE = 160  # pixels along the longer side of the picture that depth is sought in
_SEARCHED = 600  # pixels that tell how far away the whole surface lies
_ROUNDS = 5  # figures of other seeds than the benchmark's needed three to five until their depth stayed
_REACH = 0.25  # of the nearest light's distance: how far before and behind the origin the surface may lie
_SETTLED = 1e-3  # of that distance


def find_normals(stack: LightStack, depth_m: Float64 | None = None) -> NormalMap:
    """Normals of what is matt, shadows and highlights left out, from four lights on.

    Model: reflectance = albedo / pi (n . L) times a near light's falloff, the colour of a pixel the same under all
    lights. What the surface does otherwise (it is not quite matt, light comes round about) is estimated for the whole
    picture and counted as noise of each sample, on top of its own variance; samples that lie further off have no
    weight. `depth_m` (y, x) is where the surface lies in the stack's frame, NaN = 0; where it is not given and a light
    is near, `find_depth` finds it. Albedo is measured, not bounded: it may exceed 1 where the surface shines.
    Source: Woodham 1980; least median of squares, Rousseeuw 1984; biweight, Beaton and Tukey 1974.
    """
    if depth_m is None and np.isfinite(stack.light_distances_m).any():
        depth_m = find_depth(stack)
    shape = stack.reflectance_cos.shape[1:3]
    depth_m = np.zeros(shape) if depth_m is None else np.nan_to_num(depth_m)
    points = _points(stack, depth_m)
    start = _starts(stack, points)
    known = start[..., 3][np.isfinite(start[..., 3])]
    start[..., 3] = max(float(np.median(known)), 0.0) if known.size else 0.0
    found, status = kernel.normals(*_samples(stack), points, start)
    with np.errstate(invalid="ignore"):
        unit = found[:, :3] / np.linalg.norm(found[:, :3], axis=-1, keepdims=True)
    normal, variance, albedo = (part.astype(np.float32) for part in (unit, found[:, 3], found[:, 4:]))
    return NormalMap(
        normal.reshape(*shape, 3),
        albedo.reshape(*shape, 3),
        variance.reshape(shape),
        status.reshape(shape),
        stack.pixel_m,
        stack.provenance,
        depth_m.astype(np.float32),
    )


def find_depth(stack: LightStack) -> Float64:
    """Where the surface lies in the stack's frame (y, x), in metres, for lights that are near.

    Normals, found as if the surface were flat, give its shape; how far from the camera all of it lies is what lets
    one normal per pixel explain the pictures best; and so on with these depths. Pieces that do not touch are taken to
    lie equally far. Pixels without normals have the depth of the nearest that has one.
    """
    step = -(-max(stack.reflectance_cos.shape[1:3]) // _COARSE)
    coarse = _every(stack, step)
    relative = np.zeros(coarse.reflectance_cos.shape[1:3])
    away_m = 0.0
    for _ in range(_ROUNDS):
        away_m = _distance(coarse, relative)
        shape = integrate(find_normals(coarse, relative + away_m))
        if not np.isfinite(shape).any():
            break
        relative = _filled(shape)
    away_m = _distance(coarse, relative)
    return _finer(relative + away_m, stack.reflectance_cos.shape[1:3], step)


def _distance(stack: LightStack, relative_m: Float64) -> float:
    """By how much a surface of this shape must be moved toward the camera to explain the pictures best."""
    seen = np.flatnonzero(np.isfinite(stack.reflectance_cos).any(axis=(0, 3)).ravel())
    pixels = seen[:: max(len(seen) // _SEARCHED, 1)]
    points = _points(stack, relative_m)[pixels]
    nearest_m = float(stack.light_distances_m.min())

    def misfit(away_m: float) -> float:
        start = _starts(stack, points + np.array([0.0, 0.0, away_m]), pixels)
        known = start[:, 3][np.isfinite(start[:, 3])]
        return float(np.median(known)) if known.size else 0.0

    reach_m = _REACH * nearest_m
    found = minimize_scalar(
        misfit, bounds=(-reach_m, reach_m), method="bounded", options={"xatol": _SETTLED * nearest_m}
    )
    return float(found.x)


def _every(stack: LightStack, step: int) -> LightStack:
    """The stack of every so many pixels."""
    rows, columns = (slice((size - 1) % step // 2, None, step) for size in stack.reflectance_cos.shape[1:3])
    fewer = (part[:, rows, columns] for part in (stack.reflectance_cos, stack.variance))
    value, variance = (np.ascontiguousarray(part) for part in fewer)
    return replace(stack, reflectance_cos=value, variance=variance, pixel_m=step * stack.pixel_m)


def _finer(depth: Float64, shape: tuple[int, int], step: int) -> Float64:
    """Depth of every so many pixels (y, x), interpolated between them."""
    places = [(np.arange(size) - (size - 1) % step // 2) / step for size in shape]
    grid = np.stack(np.meshgrid(*places, indexing="ij"))
    return np.asarray(ndimage.map_coordinates(depth, grid, order=1, mode="nearest"), np.float64)


def _filled(depth: Float64) -> Float64:
    """Each missing depth replaced by the nearest that is known."""
    nearest = ndimage.distance_transform_edt(np.isnan(depth), return_distances=False, return_indices=True)
    return np.asarray(depth[tuple(nearest)], np.float64)


def _points(stack: LightStack, depth_m: Float64) -> Float64:
    """What each pixel sees (pixel, 3)."""
    points = plane_points(stack.reflectance_cos.shape[1:3], stack.pixel_m)
    points[..., 2] = depth_m
    return points.reshape(-1, 3)


def _starts(stack: LightStack, points: Float64, pixels: NDArray[np.intp] | slice = np.s_[:]) -> Float64:
    return kernel.starts(*_samples(stack, pixels), points, _triples())


def _samples(stack: LightStack, pixels: NDArray[np.intp] | slice = np.s_[:]) -> tuple[Float32, Float32, Float64]:
    """Values and variances (light, pixel, 3), and each light's direction and distance (light, 4).

    Of one type and order in memory always: for another the kernels would be compiled once more.
    """
    lights = np.column_stack([stack.light_directions, stack.light_distances_m]).astype(np.float64)
    parts = (part.reshape(len(lights), -1, 3)[:, pixels] for part in (stack.reflectance_cos, stack.variance))
    value, variance = (np.ascontiguousarray(part, np.float32) for part in parts)
    return value, variance, lights


@cache
def _triples() -> NDArray[np.intp]:
    """Triples of m samples in row m: all of them, or so many at random, the same ones always; ended by -1."""
    rng = np.random.default_rng(0)
    table = np.full((_MOST_TAKEN + 1, _MOST_TRIPLES, 3), -1)
    for count in range(3, _MOST_TAKEN + 1):
        every = np.array(list(combinations(range(count), 3)))
        chosen = rng.permutation(every)[:_MOST_TRIPLES]
        table[count, : len(chosen)] = chosen
    return table
