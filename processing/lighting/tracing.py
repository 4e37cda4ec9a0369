"""Which directions a body blocks at points: rays within the cones of its spheres, above the points' horizons."""

from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from processing.lighting.cover import covering_spheres
from processing.lighting.directions import SampleDirections
from processing.lighting.rays import BATCH, Bool
from processing.lighting.toggles import UInt16
from processing.lighting.triangle_body import TriangleBody
from processing.products.arrays import Float32, Float64, Int32

Int64 = NDArray[np.int64]

_BLOCK, _LEAVES, _AROUND = 2, 4, 8  # height and leaves of a block, and how many others are around it
_CLUSTER = 6  # height of the nodes that are looked at first, whether the cone holds all or none of them


@dataclass(frozen=True, eq=False)
class LeafRays:
    """Leaves' directions (leaves, 3) in some frame; `clusters` (c, 4) are axes and half angles of all nodes of a
    height. Blocks are the nodes of four leaves: `middles` (blocks, 3), and `around` (blocks, 8) the nearest ones."""

    rays: Float32
    clusters: Float64
    middles: Float32
    around: Int32

    def turned(self, turn: Float64) -> "LeafRays":
        """The same leaves in the frame that `turn` (3, 3) takes directions into."""
        clusters = np.column_stack([self.clusters[:, :3] @ turn.T, self.clusters[:, 3]])
        rays, middles = (np.ascontiguousarray(ways @ turn.T, np.float32) for ways in (self.rays, self.middles))
        return LeafRays(rays, clusters, middles, self.around)


@lru_cache(maxsize=4)
def leaf_rays(sampled: SampleDirections) -> LeafRays:
    """The rays of a tree in its own frame."""
    cluster = min(_CLUSTER, sampled.height)
    axes = sampled.means(cluster)
    along = np.einsum("nki,ni->nk", sampled.directions.reshape(len(axes), -1, 3), axes)
    clusters = np.column_stack([axes, np.arccos(np.clip(along.min(axis=1), -1, 1))])
    middles = sampled.means(_BLOCK)
    around = np.asarray(cKDTree(middles).query(middles, _AROUND + 1)[1], np.int32)  # itself first
    return LeafRays(sampled.rays, clusters, middles.astype(np.float32), np.ascontiguousarray(around[:, 1:]))


class BodyTracer:
    """Finds the leaves at which a body's visibility changes; several threads may ask at once."""

    def __init__(self, body: TriangleBody) -> None:
        self._occluder, self._spheres = body.occluder, covering_spheres(body)

    def changes(self, points: Float64, normals: Float64, leaves: LeafRays) -> tuple[Int64, UInt16, int]:
        """How many changes (n,) each of points (n, 3) has, all of them, and how many rays were traced.

        Points and leaves are in the body's frame. What lies below the horizons of `normals` (n, 3), clusters as a
        whole, counts as visible; a normal of zeros has no horizon.
        """
        at, rays = 0, 0
        parts = [(np.zeros(0, np.int64), np.zeros(0, np.uint16))]
        while at < len(points):
            first, numbers, blocked = self._traced(points[at:], normals[at:], leaves.clusters, leaves.rays)
            parts.append(_changes(first, numbers, blocked, len(leaves.rays)))
            at, rays = at + len(first) - 1, rays + len(numbers)
        return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts]), rays

    def changes_of_blocks(self, points: Float64, normals: Float64, leaves: LeafRays) -> tuple[Int64, UInt16, int]:
        """The same with fewer rays: a block is taken as its middle where those around it are blocked, or free, alike.

        What is thinner than a block, 2 deg, may be missed.
        """
        at, rays = 0, 0
        parts = [(np.zeros(0, np.int64), np.zeros(0, np.uint16))]
        while at < len(points):
            first, numbers, blocked = self._traced(points[at:], normals[at:], leaves.clusters, leaves.middles)
            here = points[at : at + len(first) - 1]
            unclear, origins, directions = _unclear_rays(here, first, numbers, blocked, leaves.around, leaves.rays)
            finer = self._occluder.blocks(origins, directions)
            parts.append(_changes(*_in_leaves(first, numbers, blocked, unclear, finer), len(leaves.rays)))
            at, rays = at + len(here), rays + len(numbers) + len(finer)
        return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts]), rays

    def _traced(self, points: Float64, normals: Float64, clusters: Float64, rays: Float32) -> tuple[Int64, Int32, Bool]:
        first, numbers, origins, directions = cone_rays(points, normals, self._spheres, clusters, rays, BATCH)
        return first, numbers, self._occluder.blocks(origins, directions)


@numba.njit(cache=True, nogil=True)
def _unclear_rays(
    points: Float64, first: Int64, blocks: Int32, blocked: Bool, around: Int32, rays: Float32
) -> tuple[Bool, Float32, Float32]:
    """Which of the blocks differ from one around them, and rays to all leaves of these: origins and directions."""
    unclear, dark = np.zeros(len(blocks), np.bool_), np.zeros(len(around), np.bool_)
    for i in range(len(points)):
        dark[:] = False
        for k in range(first[i], first[i + 1]):
            dark[blocks[k]] = blocked[k]
        for k in range(first[i], first[i + 1]):
            for other in around[blocks[k]]:
                unclear[k] |= dark[other] != blocked[k]
    count = _LEAVES * unclear.sum()
    origins, directions, at = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32), 0
    for i in range(len(points)):
        for k in range(first[i], first[i + 1]):
            for leaf in range(_LEAVES * blocks[k], _LEAVES * (blocks[k] + 1) if unclear[k] else 0):
                for axis in range(3):
                    origins[at, axis], directions[at, axis] = points[i, axis], rays[leaf, axis]
                at += 1
    return unclear, origins, directions


@numba.njit(cache=True, nogil=True)
def _in_leaves(first: Int64, blocks: Int32, blocked: Bool, unclear: Bool, finer: Bool) -> tuple[Int64, Int32, Bool]:
    """The leaves of all blocks, blocked as these or, where they are unclear, each for itself."""
    leaves, found, at = np.empty(_LEAVES * len(blocks), np.int32), np.empty(_LEAVES * len(blocks), np.bool_), 0
    for k in range(len(blocks)):
        for leaf in range(_LEAVES):
            leaves[_LEAVES * k + leaf] = _LEAVES * blocks[k] + leaf
            found[_LEAVES * k + leaf] = finer[at] if unclear[k] else blocked[k]
            at += unclear[k]
    return _LEAVES * first, leaves, found


@numba.njit(cache=True, nogil=True)
def cone_rays(
    points: Float64, normals: Float64, spheres: Float64, clusters: Float64, rays: Float32, room: int
) -> tuple[Int64, Int32, Float32, Float32]:
    """Rays from points (n, 3) above their horizons that may meet spheres, of as many points as there is room for.

    That is at least one point; `normals` (n, 3) of zeros have no horizon.

    `spheres` (m, 4) are centres and radii: one around all, then those within. `clusters` (c, 4) are axes and half
    angles of all nodes of one height: those beyond the spheres' cones are left out as a whole. Rays `first[i]` to
    `first[i + 1]` are of point i: ascending leaves (k,), origins (k, 3) and directions (k, 3).
    """
    count, size = len(rays), len(rays) // len(clusters)
    first, room = np.zeros(len(points) + 1, np.int64), max(room, count)
    leaves = np.empty(room, np.int32)
    origins, directions = np.empty((room, 3), np.float32), np.empty((room, 3), np.float32)
    cones, near = np.empty((len(spheres), 5)), np.empty(len(spheres), np.int32)
    k, done = 0, 0
    while done < len(points) and k + count <= room:
        for i in range(len(spheres)):
            _write_cone(points[done], spheres[i], cones[i])
        for cluster in range(len(clusters)):
            below = _below(clusters[cluster], normals[done])
            found = 0 if below else _cones_near(clusters[cluster], cones, near)
            for leaf in range(cluster * size, (cluster + 1) * size if found > 0 else 0):
                if _within(rays[leaf], cones, near[:found]):
                    leaves[k], directions[k] = leaf, rays[leaf]
                    for axis in range(3):
                        origins[k, axis] = points[done, axis]
                    k += 1
        done += 1
        first[done] = k
    return first[: done + 1], leaves[:k], origins[:k], directions[:k]


@numba.njit(cache=True, nogil=True)
def _below(cluster: Float64, normal: Float64) -> bool:
    """Whether a cluster lies under a horizon as a whole."""
    along = cluster[0] * normal[0] + cluster[1] * normal[1] + cluster[2] * normal[2]
    return bool(along < -np.sin(min(cluster[3], np.pi / 2)) - 1e-6)


@numba.njit(cache=True, nogil=True)
def _write_cone(point: Float64, sphere: Float64, cone: Float64) -> None:
    """Axis, half angle and its cosine of the cone in which a point sees a sphere; all directions from inside."""
    toward = sphere[:3] - point
    distance = np.sqrt(np.sum(toward * toward))
    sine = sphere[3] / distance if distance > 0 else 2.0
    cone[:3] = toward / max(distance, 1e-300)
    cone[3] = np.arcsin(sine) if sine < 1 else np.pi
    cone[4] = np.cos(cone[3]) - 1e-6  # more than float32 rays are off


@numba.njit(cache=True, nogil=True)
def _cones_near(cluster: Float64, cones: Float64, near: Int32) -> int:
    """Write the numbers of cones that a cluster touches, but for the first, which must be touched; return how many."""
    found = 0
    for i in range(len(cones)):
        spread = cones[i, 3] + cluster[3]
        along = cluster[0] * cones[i, 0] + cluster[1] * cones[i, 1] + cluster[2] * cones[i, 2]
        apart = spread < np.pi and along < np.cos(spread)
        if i == 0 and apart:
            return 0
        if i > 0 and not apart:
            near[found] = i
            found += 1
    return found


@numba.njit(cache=True, nogil=True)
def _within(ray: Float32, cones: Float64, near: Int32) -> bool:
    for i in near:
        if ray[0] * cones[i, 0] + ray[1] * cones[i, 1] + ray[2] * cones[i, 2] >= cones[i, 4]:
            return True
    return False


@numba.njit(cache=True, nogil=True)
def _changes(first: Int64, leaves: Int32, blocked: Bool, count: int) -> tuple[Int64, UInt16]:
    """How often the visibility of each point changes over its leaves, and where; leaves not traced are visible."""
    counts, toggles, end = np.zeros(len(first) - 1, np.int64), np.empty(2 * len(leaves), np.uint16), 0
    for i in range(len(counts)):
        begun, after, dark = end, 0, False
        for k in range(first[i], first[i + 1]):
            if dark and leaves[k] != after:
                toggles[end], dark = after, False
                end += 1
            if blocked[k] != dark:
                toggles[end], dark = leaves[k], blocked[k]
                end += 1
            after = leaves[k] + 1
        if dark and after < count:
            toggles[end] = after
            end += 1
        counts[i] = end - begun
    return counts, toggles[:end].copy()
