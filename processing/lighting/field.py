"""Visibility cut field (VCF): which directions a body blocks, at sample points on spheres around it.

Source: Iwasaki et al., V.A.1. Only directions within the cone of the body's bounding sphere are traced.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from processing.lighting.cuts import Cuts
from processing.lighting.directions import SampleDirections
from processing.lighting.rays import Bool
from processing.lighting.shells import Shells
from processing.lighting.toggles import UInt16, binary_cuts, node_counts, visible_leaves
from processing.lighting.tracing import BodyTracer, leaf_rays
from processing.lighting.triangle_body import TriangleBody
from processing.products.arrays import Float32, Float64, Int32
from processing.progress import Progress, Silence
from processing.threads import in_parts

Int64 = NDArray[np.int64]

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
        self._shells, self._tracer, self._leaves = shells, BodyTracer(body), leaf_rays(sampled)

    def trace(self, start: int, stop: int) -> FieldBlock:
        """Visibility at sample points `start` to `stop`, in threads."""
        parts = in_parts(lambda a, b: self._part(start + a, start + b), stop - start, _PART)
        counts, toggles, rays = zip(*parts, strict=True)
        return FieldBlock(start, np.concatenate(counts), np.concatenate(toggles), sum(rays))

    def _part(self, start: int, stop: int) -> tuple[Int64, UInt16, int]:
        points = self._shells.points(start, stop)
        return self._tracer.changes(points, np.zeros_like(points), self._leaves)


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
