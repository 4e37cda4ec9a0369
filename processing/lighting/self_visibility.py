"""Self-visibility cuts (SVC): where light comes from to each vertex of a body, times the cosine.

Source: Iwasaki et al., V.A.1. Only directions above the vertex's horizon are traced.
"""

from collections.abc import Callable

import numba
import numpy as np
from numpy.typing import NDArray

from processing.lighting.cuts import Cuts, add_cut
from processing.lighting.directions import SampleDirections
from processing.lighting.rays import BATCH, Bool, Occluder
from processing.lighting.triangle_body import TriangleBody
from processing.products.arrays import Float32, Float64, Int32
from processing.progress import Progress, Silence
from processing.threads import in_parts

_BLOCK = 512  # vertices between two reports

Part = tuple[NDArray[np.int64], NDArray[np.uint8], Float32]


def self_visibility(
    body: TriangleBody, sampled: SampleDirections, tolerance: float, report: Progress | None = None
) -> tuple[Cuts, int]:
    """Cuts of visibility times cosine, one for each vertex, and the number of rays that were traced.

    `tolerance` bounds the clustering error of each node: the root of the sum over its leaves of solid angle times the
    squared difference from its value. Vertices without a normal see nothing.
    """
    origins, normals = body.origins.astype(np.float32), body.normals.astype(np.float32)
    size = max(2 * BATCH // len(sampled.directions), 1)
    parts: list[Part] = []
    rays = 0
    for start in (report or Silence()).track(range(0, len(origins), _BLOCK), "self-visibility"):
        block = slice(start, start + _BLOCK)
        work = _worker(body.occluder, sampled, tolerance, origins[block], normals[block])
        for part, traced in in_parts(work, len(origins[block]), size):
            parts.append(part)
            rays += traced
    sizes, heights, values = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return Cuts(np.concatenate([[0], np.cumsum(sizes)]), heights, values), rays


def _worker(
    occluder: Occluder, sampled: SampleDirections, tolerance: float, origins: Float32, normals: Float32
) -> Callable[[int, int], tuple[Part, int]]:
    def work(start: int, stop: int) -> tuple[Part, int]:
        first, starts, directions, leaf, cosine = upper_rays(sampled.rays, origins[start:stop], normals[start:stop])
        blocked = occluder.blocks(starts, directions)
        return _cuts(first, leaf, cosine, blocked, sampled.solid_angle, tolerance), len(leaf)

    return work


@numba.njit(cache=True, nogil=True)
def upper_rays(
    rays: Float32, origins: Float32, normals: Float32
) -> tuple[NDArray[np.int64], Float32, Float32, Int32, Float32]:
    """Rays above the horizons of points (n, 3) with normals (n, 3).

    Those of point i are numbers `first[i]` to `first[i + 1]`; then origins (k, 3), directions (k, 3), leaves (k,) in
    ascending order and cosines (k,).
    """
    room = len(origins) * len(rays)
    first = np.zeros(len(origins) + 1, np.int64)
    starts, directions = np.empty((room, 3), np.float32), np.empty((room, 3), np.float32)
    leaves, cosines = np.empty(room, np.int32), np.empty(room, np.float32)
    k = 0
    for i in range(len(origins)):
        x, y, z = normals[i]
        for leaf in range(len(rays)):
            cosine = x * rays[leaf, 0] + y * rays[leaf, 1] + z * rays[leaf, 2]
            if cosine > 0:
                for axis in range(3):
                    starts[k, axis], directions[k, axis] = origins[i, axis], rays[leaf, axis]
                leaves[k], cosines[k] = leaf, cosine
                k += 1
        first[i + 1] = k
    return first, starts[:k], directions[:k], leaves[:k], cosines[:k]


@numba.njit(cache=True, nogil=True)
def _cuts(
    first: NDArray[np.int64], leaf: Int32, cosine: Float32, blocked: Bool, weights: Float64, tolerance: float
) -> Part:
    points, count = len(first) - 1, len(weights)
    sizes = np.empty(points, np.int64)
    heights, values = np.empty(points * count, np.uint8), np.empty(points * count, np.float32)
    leaves, end = np.empty(count, np.float32), 0
    for i in range(points):
        leaves[:] = 0
        for k in range(first[i], first[i + 1]):
            if not blocked[k]:
                leaves[leaf[k]] = cosine[k]
        sizes[i] = add_cut(leaves, weights, tolerance, heights[end:], values[end:])
        end += sizes[i]
    return sizes, heights[:end].copy(), values[:end].copy()
