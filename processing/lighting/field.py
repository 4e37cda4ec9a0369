"""Visibility cut field (VCF): which directions a body blocks, at sample points on spheres around it.

Source: Iwasaki et al., V.A.1. Only directions within the cone of the body's bounding sphere are traced.
"""

from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np
from numpy.typing import NDArray

from processing.lighting.cover import covering_spheres
from processing.lighting.cuts import Cuts
from processing.lighting.directions import SampleDirections
from processing.lighting.rays import BATCH, Bool, Occluder
from processing.lighting.shells import Shells
from processing.lighting.toggles import UInt16, binary_cuts, node_counts, visible_leaves
from processing.lighting.triangle_body import TriangleBody
from processing.products.arrays import Float32, Float64, Int32
from processing.progress import Progress, Silence
from processing.threads import in_parts

Int64 = NDArray[np.int64]

_CLUSTER = 6  # height of the nodes that are looked at first, whether the cone holds all or none of them
_PART = 64  # points that a thread takes at a time


@dataclass(frozen=True, eq=False)
class VisibilityField:
    """At each of the points of `shells`, the leaves at which visibility changes; it begins visible.

    The changes of point i are `toggles[first[i] : first[i + 1]]`, ascending. Directions are those of the frame of the
    body's vertices, 2^height of them.
    """

    shells: Shells
    height: int
    first: Int64
    toggles: UInt16

    @cached_property
    def sealed(self) -> Bool:
        """Points (n,) that see nothing but the body: they lie inside it, and say nothing about its surroundings."""
        single = np.flatnonzero(np.diff(self.first) == 1)
        found = np.zeros(len(self.first) - 1, np.bool_)
        found[single] = self.toggles[self.first[single]] == 0
        return found

    @cached_property
    def mean_cut(self) -> float:
        """Nodes of a lossless cut, on average."""
        return float(node_counts(self.first, self.toggles, self.height).mean())

    def cells(self, points: Float64) -> tuple[Int32, Float32]:
        """Numbers and weights (n, 8) of the sample points around points (n, 3) outside the body (see `Shells`)."""
        return self.shells.cells(points, self.sealed)

    def cuts(self, numbers: Int32) -> Cuts:
        """Lossless cuts of some sample points; a node's value is 1 where it is visible, else 0."""
        parts = [self.toggles[self.first[i] : self.first[i + 1]] for i in numbers]
        first = np.concatenate([[0], np.cumsum([len(part) for part in parts])]).astype(np.int64)
        return binary_cuts(first, np.concatenate([*parts, np.zeros(0, np.uint16)]), self.height)

    def visibility(self, points: Float64) -> Float32:
        """Visible share (n, 2^height) of each direction at points (n, 3): the field's, interpolated. For a few."""
        numbers, weights = self.cells(points)
        found = np.ones((len(points), 1 << self.height), np.float32)
        for i, one in enumerate(found):
            for number, weight in zip(numbers[i], weights[i], strict=True):
                changes = self.toggles[self.first[number] : self.first[number + 1]]
                one -= weight * ~visible_leaves(changes, self.height)
        return found


@dataclass(frozen=True, eq=False)
class FieldBlock:
    """Changes of the sample points from `start` on, `counts` (n,) of them each, and how many rays they took."""

    start: int
    counts: Int64
    toggles: UInt16
    rays: int


class FieldTracer:
    """Traces the field of a body, some sample points at a time."""

    def __init__(self, body: TriangleBody, sampled: SampleDirections, shells: Shells) -> None:
        self._shells, self._rays = shells, sampled.rays
        self._occluder = Occluder(body.vertices, body.triangles)
        cluster = min(_CLUSTER, sampled.height)
        axes = sampled.means(cluster)
        along = np.einsum("nki,ni->nk", sampled.directions.reshape(len(axes), -1, 3), axes)
        self._clusters = np.column_stack([axes, np.arccos(np.clip(along.min(axis=1), -1, 1))])
        self._spheres = covering_spheres(body)

    def trace(self, start: int, stop: int) -> FieldBlock:
        """Visibility at sample points `start` to `stop`, in threads."""
        parts = in_parts(lambda a, b: self._part(start + a, start + b), stop - start, _PART)
        counts, toggles, rays = zip(*parts, strict=True)
        return FieldBlock(start, np.concatenate(counts), np.concatenate(toggles), sum(rays))

    def _part(self, start: int, stop: int) -> tuple[Int64, UInt16, int]:
        points, at, rays = self._shells.points(start, stop), 0, 0
        parts = []
        while at < len(points):
            first, leaves, origins, directions = cone_rays(
                points[at:], self._spheres, self._clusters, self._rays, BATCH
            )
            blocked = self._occluder.blocks(origins, directions)
            parts.append(_changes(first, leaves, blocked, len(self._rays)))
            at, rays = at + len(first) - 1, rays + len(leaves)
        return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts]), rays


def trace_field(
    body: TriangleBody, sampled: SampleDirections, shells: Shells, report: Progress | None = None
) -> tuple[VisibilityField, int]:
    """The whole field of a body, and the number of rays that were traced."""
    tracer, step = FieldTracer(body, sampled, shells), block_size(shells)
    starts = (report or Silence()).track(range(0, len(shells), step), "visibility field")
    blocks = [tracer.trace(start, min(start + step, len(shells))) for start in starts]
    counts = np.concatenate([block.counts for block in blocks])
    first = np.concatenate([[0], np.cumsum(counts)])
    field = VisibilityField(shells, sampled.height, first, np.concatenate([block.toggles for block in blocks]))
    return field, sum(block.rays for block in blocks)


def block_size(shells: Shells) -> int:
    """Sample points of one sphere: what is traced between two reports."""
    return 6 * shells.resolution**2


@numba.njit(cache=True, nogil=True)
def cone_rays(
    points: Float64, spheres: Float64, clusters: Float64, rays: Float32, room: int
) -> tuple[Int64, Int32, Float32, Float32]:
    """Rays from points (n, 3) that may meet spheres, of as many points as there is room for, at least one.

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
            found = _cones_near(clusters[cluster], cones, near)
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
