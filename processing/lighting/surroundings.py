"""Which bodies matter to a body's vertices at their poses, and what they hide from the vertices there."""

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np
from numba.typed import List
from numpy.typing import NDArray

from processing.lighting.contact import ContactZone, contact_zone
from processing.lighting.cuts import Cuts
from processing.lighting.directions import SampleDirections
from processing.lighting.field import VisibilityField
from processing.lighting.kept_runs import KeptRuns
from processing.lighting.light import turned_leaves
from processing.lighting.moving_kernel import Steps
from processing.lighting.outline import FlatOutline
from processing.lighting.rays import Bool
from processing.lighting.shadow_kernel import FIELD, NOTHING, Shadows, Slot, round_weights, runs_met
from processing.lighting.tracing import BodyTracer, leaf_rays
from processing.lighting.triangle_body import TriangleBody
from processing.products.arrays import Float32, Float64
from processing.threads import in_parts

Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]
UInt16 = NDArray[np.uint16]

_SAME = 1e-9
_NO_LEAVES = np.zeros(0, np.uint16)
_TRACED_PART = 8  # vertices that a thread traces at a time
HIDDEN, BETWEEN, AT_VERTEX = 0, 1, 2  # how a vertex is told of a body: not, between sample points, or itself


@dataclass(frozen=True, eq=False)
class RelitBody:
    """A body with the cuts of its vertices; `field` tells what it hides from others: a flat body's outline is enough,
    and without one it throws no shadows on others."""

    body: TriangleBody
    self_visibility: Cuts
    field: VisibilityField | FlatOutline | None

    @cached_property
    def starts(self) -> UInt16:
        """First leaf of each node of the vertices' cuts."""
        size = 1 << self.self_visibility.heights.astype(np.int64)
        leaves = size[: self.self_visibility.first[1]].sum()
        return np.asarray((np.cumsum(size) - size) % leaves, np.uint16)

    @cached_property
    def tracer(self) -> BodyTracer:
        """Finds what the body hides where that is not known."""
        return BodyTracer(self.body)

    @cached_property
    def contact(self) -> ContactZone:
        """Where the body is all but touched."""
        return contact_zone(self.body)

    def steps(self, vertices: Int64) -> Steps:
        """What the body leaves visible of each direction, times the cosine."""
        first = self.self_visibility.first
        return Steps(first[vertices], first[vertices + 1], self.starts, self.self_visibility.values)


@dataclass(frozen=True, eq=False)
class Neighbour:
    """A body that may throw shadows on another: how its frame lies to the other's."""

    relit: RelitBody
    turn: Float64
    shift: Float64
    sampled: SampleDirections

    @property
    def middle(self) -> Float64:
        """Centre (3,) of the body in the other's frame."""
        return np.asarray(self.turn @ self.relit.body.centre + self.shift)

    @cached_property
    def turned(self) -> bool:
        """Whether the frames' leaves are others."""
        return bool(np.abs(self.turn - np.eye(3)).max() > _SAME)

    @cached_property
    def leaf(self) -> UInt16:
        """Which of the body's leaves each of the other's is; empty where they are the same."""
        if not self.turned:
            return _NO_LEAVES
        return turned_leaves(self.turn.T, self.sampled).astype(np.uint16)

    @cached_property
    def met(self) -> UInt16:
        """Runs of the body's leaves that the other's meet (see `runs_met`)."""
        return runs_met(self.leaf) if self.turned else np.zeros((0, 0), np.uint16)

    def lies_as(self, other: "Neighbour | None") -> bool:
        """Whether nothing has changed."""
        if other is None:
            return False
        apart = np.abs(self.shift - other.shift).max() / self.relit.body.radius
        return bool(max(apart, np.abs(self.turn - other.turn).max()) <= _SAME)

    def reached(self, points: Float64, normals: Float64) -> UInt8:
        """How each vertex (n,) is to be told of the body: not where all of it is below the horizon or beyond the field,
        at the vertex itself where it is close or the body is flat."""
        field, some = self.relit.field, np.empty(len(points), np.bool_)
        if isinstance(field, FlatOutline):
            return AT_VERTEX * field.moved(self.turn, self.shift).above(points, normals).astype(np.uint8)
        if field is None:
            return np.full(len(points), HIDDEN, np.uint8)
        _reached(points, normals, self.middle, self.relit.body.radius, float(field.shells.radii[-1]), some)
        found = BETWEEN * some.astype(np.uint8)
        inside = np.flatnonzero(some)
        found[inside[self.relit.contact.holds((points[inside] - self.shift) @ self.turn)]] = AT_VERTEX
        return found

    def changes(self, points: Float64, normals: Float64) -> tuple[Int64, UInt16]:
        """Changes of visibility over the other's leaves at its vertices themselves: how many (n,) each has, and all."""
        if isinstance(self.relit.field, FlatOutline):
            return self.relit.field.moved(self.turn, self.shift).changes(points, normals, self.sampled)
        leaves = leaf_rays(self.sampled).turned(self.turn.T)
        local = (points - self.shift) @ self.turn, normals @ self.turn
        counts, toggles, _ = self.relit.tracer.changes_of_blocks(*local, leaves)
        return counts, toggles


class Surroundings:
    """The other bodies around one body, as they lie, and what is known of what they hide from its vertices."""

    def __init__(self, body: TriangleBody, sampled: SampleDirections) -> None:
        self._points, self._normals, self._sampled = body.origins, body.normals, sampled
        self._neighbours: dict[int, Neighbour] = {}
        self._reached: dict[int, UInt8] = {}
        self._lists: dict[int, KeptRuns] = {}

    @property
    def numbers(self) -> frozenset[int]:
        """Bodies that throw shadows."""
        return frozenset(self._neighbours)

    def meet(self, number: int, other: RelitBody, own_from_other: Float64) -> Bool | None:
        """Another body lies elsewhere: vertices (n,) that it reached or reaches now; None where nothing changes."""
        neighbour = Neighbour(other, own_from_other[:3, :3], own_from_other[:3, 3], self._sampled)
        if other.field is None or neighbour.lies_as(self._neighbours.get(number)):
            return None
        now = neighbour.reached(self._points, self._normals)
        changed = (now | self._reached.get(number, now)) != HIDDEN
        self._neighbours[number], self._reached[number] = neighbour, now
        self._lists[number] = KeptRuns(len(now), np.uint16)
        return np.asarray(changed)

    def shadows(self, vertices: Int64, casting: Collection[int]) -> Shadows:
        """What some bodies hide from vertices (n,)."""
        numbers = sorted(casting)
        for number in numbers:
            self._complete(number, vertices)
        begin = np.full((len(vertices), len(numbers)), NOTHING)
        end = np.full_like(begin, NOTHING)
        for k, number in enumerate(numbers):
            reached = self._reached[number][vertices]
            begin[reached == BETWEEN, k] = FIELD
            own = reached == AT_VERTEX
            begin[own, k], end[own, k] = self._lists[number].bounds(vertices[own])
        near = [self._neighbours[number] for number in numbers]
        lists = [self._lists[number].columns[0] for number in numbers]
        return Shadows(begin, end, self._points[vertices], *_frames(near), _slots(near, lists))

    def _complete(self, number: int, vertices: Int64) -> None:
        """Find what a body hides from vertices themselves where it is not known."""
        own = vertices[self._reached[number][vertices] == AT_VERTEX]
        missing = own[~self._lists[number].has(own)]
        neighbour = self._neighbours[number]

        def work(start: int, stop: int) -> tuple[Int64, UInt16]:
            part = missing[start:stop]
            return neighbour.changes(self._points[part], self._normals[part])

        if len(missing):
            part = 16 * _TRACED_PART if isinstance(neighbour.relit.field, FlatOutline) else _TRACED_PART
            self._lists[number].keep(missing, in_parts(work, len(missing), part))


def part_of(shadows: Shadows, start: int, stop: int) -> Shadows:
    """Those of vertices `start` to `stop`."""
    return shadows._replace(
        begin=shadows.begin[start:stop], end=shadows.end[start:stop], places=shadows.places[start:stop]
    )


def exact_weights(weights: Float32) -> Float32:
    """Weights (n, 8) as multiples of 2^-16 with the same sum of 1, so that what all see is exactly 1 again."""
    found = np.array(weights, np.float32)
    for one in found:
        round_weights(one)
    return found


def _frames(near: list[Neighbour]) -> tuple[Float64, Float64, Bool, UInt16, UInt16]:
    count = max(len(near), 1)
    middle, turn, turned = np.zeros((count, 3)), np.zeros((count, 3, 3)), np.zeros(count, np.bool_)
    asked = [one for one in near if one.turned and isinstance(one.relit.field, VisibilityField)]
    leaf = np.zeros((count, len(asked[0].leaf) if asked else 0), np.uint16)
    met = np.zeros((count, *(asked[0].met.shape if asked else (0, 0))), np.uint16)
    for k, one in enumerate(near):
        middle[k], turn[k], turned[k] = one.middle, one.turn, one.turned
        if one in asked:
            leaf[k], met[k] = one.leaf, one.met
    return middle, turn, turned, leaf, met


def _slots(near: list[Neighbour], lists: list[UInt16]) -> list[Slot]:
    """As compiled code reads them; one that is empty where there is none."""
    found: list[Slot] = List()
    for one, own in zip(near, lists, strict=True):
        field = one.relit.field
        if isinstance(field, VisibilityField):
            shells = field.shells
            found.append(Slot(shells.radii, shells.neighbours, field.sealed, field.first, field.toggles, own))
        else:
            found.append(_NO_FIELD._replace(lists=own))
    if not near:
        found.append(_NO_FIELD)
    return found


_NO_FIELD = Slot(
    np.zeros(1), np.zeros((6, 2, 2), np.int32), np.zeros(1, np.bool_), np.zeros(1, np.int64), _NO_LEAVES, _NO_LEAVES
)


@numba.njit(cache=True, nogil=True)
def _reached(points: Float64, normals: Float64, middle: Float64, radius: float, farthest: float, found: Bool) -> None:
    for i in range(len(points)):
        x, y, z = middle[0] - points[i, 0], middle[1] - points[i, 1], middle[2] - points[i, 2]
        above = x * normals[i, 0] + y * normals[i, 1] + z * normals[i, 2]
        found[i] = above > -radius and x * x + y * y + z * z < farthest * farthest
