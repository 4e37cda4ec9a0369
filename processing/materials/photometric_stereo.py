"""Normals and albedo of any object from pictures under known lights."""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from processing.materials import photometric_kernel as kernel
from processing.products import LightStack, NormalMap, plane_points
from processing.products.arrays import Float64

_MOST_TAKEN = 32  # samples that a start is chosen by
_MOST_TRIPLES = 64  # 40 % of shadow and highlight leave no good triple among them once in ten million pixels


def find_normals(stack: LightStack, depth_m: Float64 | None = None) -> NormalMap:
    """Normals of what is matt, shadows and highlights left out, from four lights on.

    Model: reflectance = albedo / pi (n . L) times a near light's falloff, the colour of a pixel the same under all
    lights. What the surface does otherwise (it is not quite matt, light comes round about) is estimated for the whole
    picture and counted as noise of each sample, on top of its own variance; samples that lie further off have no
    weight. `depth_m` (y, x) is where the surface lies in the stack's frame, needed for near lights only: without it, or
    where it is NaN, depth 0. Albedo is measured, not bounded: it may exceed 1 where the surface shines.
    Source: Woodham 1980; least median of squares, Rousseeuw 1984; biweight, Beaton and Tukey 1974.
    """
    points = plane_points(stack.reflectance_cos.shape[1:3], stack.pixel_m)
    if depth_m is not None:
        points[..., 2] = np.nan_to_num(depth_m)
    given = (stack.reflectance_cos, stack.variance, _lights(stack), points)
    start = kernel.starts(*given, _triples())
    known = start[..., 3][np.isfinite(start[..., 3])]
    start[..., 3] = max(float(np.median(known)), 0.0) if known.size else 0.0
    found, status = kernel.normals(*given, start)
    with np.errstate(invalid="ignore"):
        unit = found[..., :3] / np.linalg.norm(found[..., :3], axis=-1, keepdims=True)
    normal, variance, albedo = (part.astype(np.float32) for part in (unit, found[..., 3], found[..., 4:]))
    return NormalMap(normal, albedo, variance, status, stack.pixel_m, stack.provenance)


def _lights(stack: LightStack) -> Float64:
    """Direction and distance of each light, (light, 4)."""
    return np.column_stack([stack.light_directions, stack.light_distances_m]).astype(np.float64)


def _triples() -> NDArray[np.intp]:
    """Triples of m samples in row m: all of them, or so many at random, the same ones always; ended by -1."""
    rng = np.random.default_rng(0)
    table = np.full((_MOST_TAKEN + 1, _MOST_TRIPLES, 3), -1)
    for count in range(3, _MOST_TAKEN + 1):
        every = np.array(list(combinations(range(count), 3)))
        chosen = rng.permutation(every)[:_MOST_TRIPLES]
        table[count, : len(chosen)] = chosen
    return table
