"""Which bodies matter to a body's vertices at their poses, and the sample points around the vertices there."""

from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np
from numba.typed import List
from numpy.typing import NDArray

from processing.lighting.cuts import Cuts
from processing.lighting.directions import SampleDirections
from processing.lighting.field import VisibilityField
from processing.lighting.light import leaves_of
from processing.lighting.moving_kernel import WEIGHT_STEPS, Shadows, Steps
from processing.lighting.rays import Bool
from processing.lighting.triangle_body import TriangleBody
from processing.products.arrays import Float32, Float64

Int64 = NDArray[np.int64]

Fields = tuple[list[Int64], list[NDArray[np.uint16]], list[NDArray[np.uint16]]]

_SAME = 1e-9
_NO_LEAVES = np.zeros(0, np.uint16)
_NO_POINTS = np.zeros(1, np.int64)


@dataclass(frozen=True, eq=False)
class RelitBody:
    """A body with the cuts of its vertices; without a `field` it throws no shadows on others."""

    body: TriangleBody
    self_visibility: Cuts
    field: VisibilityField | None

    @cached_property
    def starts(self) -> NDArray[np.uint16]:
        """First leaf of each node of the vertices' cuts."""
        size = 1 << self.self_visibility.heights.astype(np.int64)
        leaves = size[: self.self_visibility.first[1]].sum()
        return np.asarray((np.cumsum(size) - size) % leaves, np.uint16)

    def steps(self, vertices: Int64) -> Steps:
        """What the body leaves visible of each direction, times the cosine."""
        first = self.self_visibility.first
        return Steps(first[vertices], first[vertices + 1], self.starts, self.self_visibility.values)


@dataclass(frozen=True, eq=False)
class Neighbour:
    """A body that may throw shadows on another: how its frame lies to the other's."""

    field: VisibilityField
    turn: Float64
    shift: Float64
    centre: Float64
    radius: float
    leaf: NDArray[np.uint16]

    @classmethod
    def of(cls, relit: RelitBody, other_from_body: Float64, sampled: SampleDirections) -> "Neighbour | None":
        """Of a body, by the transform (4, 4) from its frame to the other's."""
        if relit.field is None:
            return None
        turn, shift = other_from_body[:3, :3], other_from_body[:3, 3]
        turned = np.abs(turn - np.eye(3)).max() > _SAME
        leaf = leaves_of(sampled.directions @ turn, sampled).astype(np.uint16) if turned else _NO_LEAVES
        return cls(relit.field, turn, shift, turn @ relit.body.centre + shift, relit.body.radius, leaf)

    def reaches(self, points: Float64, normals: Float64) -> Bool:
        """Vertices (n,) above whose horizon a part of the bounding sphere is, within the field."""
        found = np.empty(len(points), np.bool_)
        _reaches(points, normals, self.centre, self.radius, float(self.field.shells.radii[-1]), found)
        return found


@numba.njit(cache=True, nogil=True)
def _reaches(points: Float64, normals: Float64, centre: Float64, radius: float, farthest: float, found: Bool) -> None:
    for i in range(len(points)):
        x, y, z = centre[0] - points[i, 0], centre[1] - points[i, 1], centre[2] - points[i, 2]
        above = x * normals[i, 0] + y * normals[i, 1] + z * normals[i, 2]
        found[i] = above > -radius and x * x + y * y + z * z < farthest * farthest


def shadows(neighbours: list[Neighbour], fields: Fields, reached: list[Bool], points: Float64) -> Shadows:
    """Sample points of the neighbours that reach vertices at `points` (n, 3), each by its own mask (n,); `fields` are
    those of the neighbours."""
    count = max(len(neighbours), 1)
    number = np.full((len(points), count, 8), -1, np.int32)
    weight = np.zeros((len(points), count, 8), np.float32)
    for k, (neighbour, mask) in enumerate(zip(neighbours, reached, strict=True)):
        if mask.any():
            local = (points[mask] - neighbour.shift) @ neighbour.turn
            found, share = neighbour.field.cells(local)
            number[mask, k], weight[mask, k] = found, exact_weights(share)
    return Shadows(number, weight, *fields)


def exact_weights(weights: Float32) -> Float32:
    """Weights (n, 8) as multiples of 2^-16 with the same sum of 1, so that what all see is exactly 1 again."""
    found = np.rint(weights * np.float32(WEIGHT_STEPS))
    rest = np.rint(weights.sum(axis=1)) * WEIGHT_STEPS - found.sum(axis=1)
    found[np.arange(len(found)), found.argmax(axis=1)] += rest
    return np.asarray(found / np.float32(WEIGHT_STEPS), np.float32)


def fields_of(neighbours: list[Neighbour]) -> Fields:
    """The fields as lists that compiled code reads, slow to make; with one that is empty where there is none."""
    firsts, toggles, leaves = List(), List(), List()
    for neighbour in neighbours:
        firsts.append(neighbour.field.first)
        toggles.append(neighbour.field.toggles)
        leaves.append(neighbour.leaf)
    if not neighbours:
        firsts.append(_NO_POINTS)
        toggles.append(_NO_LEAVES)
        leaves.append(_NO_LEAVES)
    return firsts, toggles, leaves
