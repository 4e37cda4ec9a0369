"""Flat bodies: what they hide is what lies within their outline, which needs no field.

An outline's edges are arcs of great circles as seen from a point; nodes of the tree of directions that no arc touches
are hidden or not as a whole.
"""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from processing.lighting.directions import SampleDirections
from processing.lighting.rays import Bool
from processing.lighting.toggles import UInt16
from processing.lighting.triangle_body import TriangleBody
from processing.products.arrays import Float32, Float64

Int64 = NDArray[np.int64]

_FLAT = 1e-6  # of the radius
_IN_PLANE = 1e-9  # of an edge: from there nothing is hidden
_MOST_EDGES = 64  # bits of a mask
_STRAIGHT = 1e-5  # sine of a bend that is none


@dataclass(frozen=True, eq=False)
class FlatOutline:
    """Edges (m, 2, 3) around the area of a flat body, holes among them; the rows of `axes` (3, 3) are along it, across
    it and its normal. All in the frame of its vertices."""

    edges: Float64
    axes: Float64

    def moved(self, turn: Float64, shift: Float64) -> "FlatOutline":
        """The outline in the frame that this rotation (3, 3) and shift (3,) take points into."""
        return FlatOutline(self.edges @ turn.T + shift, self.axes @ turn.T)

    def above(self, points: Float64, normals: Float64) -> Bool:
        """Points (n, 3) above whose horizon a part of the body is."""
        corners = self.edges[:, 0]
        return np.asarray(((normals @ corners.T).max(axis=1) - (points * normals).sum(axis=1)) > 0)

    def changes(self, points: Float64, normals: Float64, sampled: SampleDirections) -> tuple[Int64, UInt16]:
        """How many changes (n,) of visibility over the leaves each of points (n, 3) has, and all of them.

        Nodes that are below the horizon of a point as a whole may be told to be hidden or not.
        """
        return _changes(points, normals, self.edges, self.axes, sampled.node_means, sampled.node_reaches)


def flat_outline(body: TriangleBody) -> FlatOutline | None:
    """The outline of a body; None where it is not flat, overlaps itself or has more than 64 straight edges."""
    corners = body.vertices[body.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sizes = np.linalg.norm(normals, axis=1)
    axis = normals[sizes.argmax()] / sizes.max()
    if np.abs((corners - body.centre) @ axis - (corners[0, 0] - body.centre) @ axis).max() > _FLAT * body.radius:
        return None
    edges = _straight(_border(corners, _FLAT * body.radius))
    if edges is None or len(edges) > _MOST_EDGES:
        return None
    area = np.cross(edges[:, 0] - body.centre, edges[:, 1] - body.centre).sum(axis=0) @ axis
    if abs(abs(area) - sizes.sum()) > 1e-3 * sizes.sum():
        return None
    along = (edges[0, 1] - edges[0, 0]) / np.linalg.norm(edges[0, 1] - edges[0, 0])
    return FlatOutline(edges, np.stack([along, np.cross(axis, along), axis]))


def _border(corners: Float64, weld: float) -> list[Float64]:
    """Loops (k, 3) of the edges that one triangle has alone; none where they meet in other ways."""
    vertices = corners.reshape(-1, 3)
    _, index, number = np.unique(
        np.rint(vertices / weld).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    triangles = number.reshape(-1, 3)
    ways = {(int(a), int(b)) for one in triangles for a, b in zip(one, np.roll(one, -1), strict=True)}
    after = {a: b for a, b in ways if (b, a) not in ways}
    if len(after) != sum((b, a) not in ways for a, b in ways) or set(after) != set(after.values()):
        return []
    loops = []
    while after:
        start, at = next(iter(after.items()))
        loop = [start]
        while at != start:
            loop.append(at)
            at = after.pop(at)
        after.pop(start)
        loops.append(vertices[index[loop]])
    return loops


def _straight(loops: list[Float64]) -> Float64 | None:
    """Edges (m, 2, 3) of loops, those that go on straight joined."""
    edges = []
    for loop in loops:
        before, behind = loop - np.roll(loop, 1, axis=0), np.roll(loop, -1, axis=0) - loop
        bend = np.linalg.norm(np.cross(before, behind), axis=1)
        length = np.linalg.norm(before, axis=1) * np.linalg.norm(behind, axis=1)
        kept = loop[bend > _STRAIGHT * length]
        edges.append(np.stack([kept, np.roll(kept, -1, axis=0)], axis=1))
    return np.concatenate(edges) if edges else None


@numba.njit(cache=True, nogil=True)
def _changes(
    points: Float64, normals: Float64, edges: Float64, axes: Float64, means: Float32, reaches: Float64
) -> tuple[Int64, UInt16]:
    counts, toggles, end = np.zeros(len(points), np.int64), np.empty(len(means), np.uint16), 0
    arcs, flat = np.empty((len(edges), 5, 3)), np.empty((len(edges), 2, 2))
    for i in range(len(points)):
        if end + len(means) // 2 > len(toggles):
            longer = np.empty(2 * len(toggles), np.uint16)
            longer[:end] = toggles[:end]
            toggles = longer
        height = _write_arcs(points[i], edges, axes, arcs, flat)
        if abs(height) > _IN_PLANE * np.sqrt(np.sum((edges[0, 1] - edges[0, 0]) ** 2)):
            counts[i] = _write_changes(normals[i], arcs, flat, axes, height, means, reaches, toggles[end:])
            end += counts[i]
    return counts, toggles[:end].copy()


@numba.njit(cache=True, nogil=True)
def _write_arcs(point: Float64, edges: Float64, axes: Float64, arcs: Float64, flat: Float64) -> float:
    """Of each edge: its unit ends, the unit normal of their plane, and the normals that bound the arc within it; and
    its places in the body's plane from below the point. Returns how far the plane is along its normal."""
    height = 0.0
    for k in range(len(edges)):
        for side in range(2):
            toward = edges[k, side] - point
            flat[k, side, 0], flat[k, side, 1], height = (
                _dot(axes[0], toward),
                _dot(axes[1], toward),
                _dot(axes[2], toward),
            )
            arcs[k, side] = toward / max(np.sqrt(np.sum(toward * toward)), 1e-300)
        _write_cross(arcs[k, 0], arcs[k, 1], arcs[k, 2])
        length = np.sqrt(np.sum(arcs[k, 2] * arcs[k, 2]))
        arcs[k, 2] /= max(length, 1e-300)
        _write_cross(arcs[k, 2], arcs[k, 0], arcs[k, 3])
        _write_cross(arcs[k, 1], arcs[k, 2], arcs[k, 4])
    return height


@numba.njit(cache=True, nogil=True)
def _write_cross(a: Float64, b: Float64, found: Float64) -> None:
    found[0], found[1], found[2] = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@numba.njit(cache=True, nogil=True)
def _write_changes(  # noqa: PLR0913 - one point's outline in its two forms, and the tree
    normal: Float64,
    arcs: Float64,
    flat: Float64,
    axes: Float64,
    height: float,
    means: Float32,
    reaches: Float64,
    toggles: UInt16,
) -> int:
    """Walk the tree down to where no arc touches, from left to right."""
    nodes, sizes, masks = np.empty(64, np.int64), np.empty(64, np.int64), np.empty(64, np.uint64)
    nodes[0], sizes[0], masks[0], depth = 1, len(means) // 2, ~np.uint64(0), 1
    position, found, dark = 0, 0, False
    while depth > 0:
        depth -= 1
        node, size = nodes[depth], sizes[depth]
        x, y, z = means[node, 0], means[node, 1], means[node, 2]
        if normal[0] * x + normal[1] * y + normal[2] * z < -reaches[node, 0]:
            position += size
            continue
        touched = np.uint64(0)
        if size > 1:
            touched = _touched(arcs, masks[depth], x, y, z, reaches[node, 0], reaches[node, 1])
        if touched != 0:
            for child in range(2):
                nodes[depth], sizes[depth], masks[depth] = 2 * node + 1 - child, size // 2, touched
                depth += 1
            continue
        if _hidden(flat, axes, height, x, y, z) != dark:
            dark = not dark
            toggles[found] = position
            found += 1
        position += size
    return found


@numba.njit(cache=True, nogil=True)
def _touched(  # noqa: PLR0913 - a direction in numbers, for arrays cost more than the rest
    arcs: Float64, mask: np.uint64, x: float, y: float, z: float, sine: float, cosine: float
) -> np.uint64:
    """Which of the arcs of a mask come within an angle of a direction."""
    found, k = np.uint64(0), 0
    while mask >> np.uint64(k) != 0 and k < len(arcs):
        bit = np.uint64(1) << np.uint64(k)
        if mask & bit and abs(_along(arcs, k, 2, x, y, z)) <= sine:
            within = _along(arcs, k, 3, x, y, z) >= 0 and _along(arcs, k, 4, x, y, z) >= 0
            if within or _along(arcs, k, 0, x, y, z) >= cosine or _along(arcs, k, 1, x, y, z) >= cosine:
                found |= bit
        k += 1
    return found


@numba.njit(cache=True, nogil=True)
def _along(arcs: Float64, k: int, row: int, x: float, y: float, z: float) -> float:
    return float(arcs[k, row, 0] * x + arcs[k, row, 1] * y + arcs[k, row, 2] * z)


@numba.njit(cache=True, nogil=True)
def _hidden(flat: Float64, axes: Float64, height: float, x: float, y: float, z: float) -> bool:
    """Whether a ray meets the plane within an odd number of edges."""
    along = axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z
    if along * height <= 0:
        return False
    u = (axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z) * height / along
    v = (axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z) * height / along
    odd = False
    for k in range(len(flat)):
        if (flat[k, 0, 1] > v) != (flat[k, 1, 1] > v):
            share = (v - flat[k, 0, 1]) / (flat[k, 1, 1] - flat[k, 0, 1])
            if u < flat[k, 0, 0] + share * (flat[k, 1, 0] - flat[k, 0, 0]):
                odd = not odd
    return odd


@numba.njit(cache=True, nogil=True)
def _dot(a: Float64, b: Float64) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
