"""A piece of a surface laid out flat around a vertex, along the tangent field."""

from heapq import heappop, heappush
from math import atan2, cos, hypot, pi, sin, sqrt
from typing import NamedTuple

import numba
import numpy as np

from processing.materials.skin_atlas import Texels
from processing.materials.skin_surface import Int32, Surface, grouped
from processing.products.arrays import Float64

# The axes of a patch turn toward the field by this angle per radius at most: near a zero of the field, where it turns
# at once, the patch stays flat instead of being torn.
_BEND_RAD = 0.5
# Triangles that are stretched more than this, or turned over, are left to a patch that begins nearer.
_STRETCH = 2.0
_SWEEPS = 3  # of relaxation: lengths then agree along all edges and not along the shortest ways only


class Layout(NamedTuple):
    """What patches are laid out from: arrays of `Surface` and `Texels`, neighbours and members in CSR form."""

    positions: Float64
    normals: Float64
    tangents: Float64
    triangles: Int32
    edge_start: Int32
    edge: Int32
    around_start: Int32
    around: Int32
    texel_start: Int32
    barycentric: Float64


class Sheet(NamedTuple):
    """A patch laid flat: `texel` (t,) with its place `xy` (t, 2) along t and b from the seed, and `turn_rad` (t,).

    `turn_rad` is the angle from the surface's t to the patch's at that texel, toward b. Also the scratch it is made in.
    """

    texel: Int32
    xy: Float64
    turn_rad: Float64
    vertex_xy: Float64
    vertex_turn: Float64
    vertex_axis: Float64
    vertex_mark: Int32
    triangle_mark: Int32
    member: Int32

    def first(self, count: int) -> "Sheet":
        """The same with no more than the texels that are filled."""
        return self._replace(texel=self.texel[:count], xy=self.xy[:count], turn_rad=self.turn_rad[:count])


def layout_of(surface: Surface, tangents: Float64, texels: Texels) -> Layout:
    """The arrays in the form that the kernels read."""
    start, _ = grouped(texels.triangle, len(surface.triangles))
    return Layout(
        surface.positions, surface.normals, tangents, surface.triangles,
        *surface.neighbours(), *surface.triangles_around(), start, texels.barycentric,
    )  # fmt: skip


def empty_sheet(layout: Layout) -> Sheet:
    """Room for the largest patch there can be."""
    n, m, t = len(layout.positions), len(layout.triangles), len(layout.barycentric)
    return Sheet(
        np.zeros(t, np.int32), np.zeros((t, 2)), np.zeros(t),
        np.zeros((n, 2)), np.zeros(n), np.zeros((n, 2)),
        np.full(n, -1, np.int32), np.full(m, -1, np.int32), np.zeros(n, np.int32),
    )  # fmt: skip


@numba.njit(cache=True)
def further_out(layout: Layout, distance: Float64, vertex: int, reach: float) -> int:
    """The vertex within `reach` of `vertex` that one comes to along the edges that gain most `distance` (n,)."""
    start = layout.positions[vertex]
    while True:
        best = vertex
        for k in range(layout.edge_start[vertex], layout.edge_start[vertex + 1]):
            other = int(layout.edge[k])
            if distance[other] > distance[best] and _distance(layout.positions[other], start) <= reach:
                best = other
        if best == vertex:
            return vertex
        vertex = best


@numba.njit(cache=True)
def lay_flat(layout: Layout, sheet: Sheet, seed: int, radius: float, number: int) -> int:
    """Lay the surface within `radius` of vertex `seed` flat; returns how many texels of `sheet` are filled.

    Vertices are reached in order of distance, each placed by the edges to those before it, then relaxed. `number` tells
    this patch from earlier ones in the same scratch. Source: Schmidt et al., Discrete Exponential Maps, 2006, with the
    field's direction in place of parallel transport.
    """
    count = _reach(layout, sheet, seed, radius, number)
    for _ in range(_SWEEPS):
        for k in range(1, count):
            _place(layout, sheet, sheet.member[k], number)
    return _gather(layout, sheet, count, radius, number)


@numba.njit(cache=True)
def _reach(layout: Layout, sheet: Sheet, seed: int, radius: float, number: int) -> int:
    sheet.vertex_xy[seed] = 0.0
    _turn(sheet, seed, 0.0)
    # A triangle that begins within the radius is needed whole; no edge is longer than a quarter of it.
    limit = 1.3 * radius
    heap = [(0.0, np.int64(seed))]  # int32 neighbours and an int64 seed are one type in the heap
    count = 0
    while len(heap) > 0:
        distance, nearest = heappop(heap)
        vertex = int(nearest)
        if sheet.vertex_mark[vertex] == number:
            continue
        if count > 0:
            _orient(layout, sheet, vertex, radius, number)
            _place(layout, sheet, vertex, number)
        sheet.vertex_mark[vertex] = number
        sheet.member[count] = vertex
        count += 1
        for k in range(layout.edge_start[vertex], layout.edge_start[vertex + 1]):
            other = int(layout.edge[k])
            if sheet.vertex_mark[other] != number:
                x, y = _step(layout, sheet, vertex, other, vertex)
                far = hypot(sheet.vertex_xy[vertex, 0] + x, sheet.vertex_xy[vertex, 1] + y)
                # Never before the one it is reached from: folds come last.
                far = max(far, distance)
                if far < limit:
                    heappush(heap, (far, np.int64(other)))
    return count


@numba.njit(cache=True)
def _place(layout: Layout, sheet: Sheet, vertex: int, number: int) -> None:
    """Put a vertex where its neighbours of this patch, on average, want it."""
    x, y, total = 0.0, 0.0, 0
    for k in range(layout.edge_start[vertex], layout.edge_start[vertex + 1]):
        other = int(layout.edge[k])
        if sheet.vertex_mark[other] == number and other != vertex:
            x0, y0 = _step(layout, sheet, other, vertex, other)
            x1, y1 = _step(layout, sheet, other, vertex, vertex)
            x += sheet.vertex_xy[other, 0] + 0.5 * (x0 + x1)
            y += sheet.vertex_xy[other, 1] + 0.5 * (y0 + y1)
            total += 1
    if total > 0:
        sheet.vertex_xy[vertex, 0] = x / total
        sheet.vertex_xy[vertex, 1] = y / total


@numba.njit(cache=True)
def _orient(layout: Layout, sheet: Sheet, vertex: int, radius: float, number: int) -> None:
    """Carry the patch's axes on from the neighbours, then bend them toward the field as far as allowed."""
    c, s, length, total = 0.0, 0.0, 0.0, 0
    for k in range(layout.edge_start[vertex], layout.edge_start[vertex + 1]):
        other = layout.edge[k]
        if sheet.vertex_mark[other] == number:
            angle = sheet.vertex_turn[other] + _transported(layout, other, vertex)
            c += cos(angle)
            s += sin(angle)
            length += _distance(layout.positions[vertex], layout.positions[other])
            total += 1
    carried = atan2(s, c)
    most = _BEND_RAD * length / (max(total, 1) * radius)
    _turn(sheet, vertex, carried - min(max(carried, -most), most))


@numba.njit(cache=True)
def _turn(sheet: Sheet, vertex: int, angle_rad: float) -> None:
    sheet.vertex_turn[vertex] = angle_rad
    sheet.vertex_axis[vertex, 0] = cos(angle_rad)
    sheet.vertex_axis[vertex, 1] = sin(angle_rad)


@numba.njit(cache=True)
def _transported(layout: Layout, source: int, target: int) -> float:
    """Angle from the field at `target` to the field at `source` carried there by the least rotation of the normal."""
    n, m = layout.normals[source], layout.normals[target]
    t, u = layout.tangents[source], layout.tangents[target]
    # The rotation of n to m takes t to t - (m . t) / (1 + n . m) (n + m), for t across n.
    along = (m[0] * t[0] + m[1] * t[1] + m[2] * t[2]) / max(1.0 + n[0] * m[0] + n[1] * m[1] + n[2] * m[2], 1e-6)
    x, y, z = t[0] - along * (n[0] + m[0]), t[1] - along * (n[1] + m[1]), t[2] - along * (n[2] + m[2])
    across = x * (m[1] * u[2] - m[2] * u[1]) + y * (m[2] * u[0] - m[0] * u[2]) + z * (m[0] * u[1] - m[1] * u[0])
    return atan2(across, x * u[0] + y * u[1] + z * u[2])


@numba.njit(cache=True)
def _step(layout: Layout, sheet: Sheet, source: int, target: int, frame: int) -> tuple[float, float]:
    """The edge from `source` to `target`, laid into the tangent plane of `frame` at its full length."""
    n, t = layout.normals[frame], layout.tangents[frame]
    p, q = layout.positions[source], layout.positions[target]
    e0, e1, e2 = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    x = e0 * t[0] + e1 * t[1] + e2 * t[2]
    y = (
        e0 * (n[1] * t[2] - n[2] * t[1]) + e1 * (n[2] * t[0] - n[0] * t[2]) + e2 * (n[0] * t[1] - n[1] * t[0])
    )  # along b = n x t
    flat = hypot(x, y)
    scale = sqrt(e0 * e0 + e1 * e1 + e2 * e2) / flat if flat > 0.0 else 0.0
    c, s = sheet.vertex_axis[frame]
    return scale * (c * x + s * y), scale * (c * y - s * x)


@numba.njit(cache=True)
def _gather(layout: Layout, sheet: Sheet, count: int, radius: float, number: int) -> int:
    """Place and turn of the texels in all triangles that lie whole and fairly flat in the patch."""
    filled = 0
    for k in range(count):
        vertex = sheet.member[k]
        for at in range(layout.around_start[vertex], layout.around_start[vertex + 1]):
            triangle = layout.around[at]
            if sheet.triangle_mark[triangle] == number:
                continue
            sheet.triangle_mark[triangle] = number
            corners = layout.triangles[triangle]
            if k > 0 and not _is_flat(layout, sheet, corners, number):
                continue
            for texel in range(layout.texel_start[triangle], layout.texel_start[triangle + 1]):
                second, third = layout.barycentric[texel]
                a, b, c = sheet.vertex_xy[corners[0]], sheet.vertex_xy[corners[1]], sheet.vertex_xy[corners[2]]
                x = a[0] + second * (b[0] - a[0]) + third * (c[0] - a[0])
                y = a[1] + second * (b[1] - a[1]) + third * (c[1] - a[1])
                if x * x + y * y < radius * radius:
                    turn = sheet.vertex_turn[corners[0]]
                    turn += second * _wrapped(sheet.vertex_turn[corners[1]] - turn) + third * _wrapped(
                        sheet.vertex_turn[corners[2]] - turn
                    )
                    sheet.texel[filled] = texel
                    sheet.xy[filled, 0] = x
                    sheet.xy[filled, 1] = y
                    sheet.turn_rad[filled] = turn
                    filled += 1
    return filled


@numba.njit(cache=True)
def _is_flat(layout: Layout, sheet: Sheet, corners: Int32, number: int) -> bool:
    """Whether all corners are in the patch, in the same sense and at nearly the same distances as in space."""
    for k in range(3):
        if sheet.vertex_mark[corners[k]] != number:
            return False
    xy = (sheet.vertex_xy[corners[0]], sheet.vertex_xy[corners[1]], sheet.vertex_xy[corners[2]])
    one, two = xy[1] - xy[0], xy[2] - xy[0]
    if one[0] * two[1] - one[1] * two[0] <= 0.0:
        return False
    for k in range(3):
        p, q = corners[k], corners[(k + 1) % 3]
        true = _distance(layout.positions[p], layout.positions[q])
        laid = hypot(xy[(k + 1) % 3][0] - xy[k][0], xy[(k + 1) % 3][1] - xy[k][1])
        if laid > _STRETCH * true or laid * _STRETCH < true:
            return False
    return True


@numba.njit(cache=True)
def _distance(p: Float64, q: Float64) -> float:
    return sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)


@numba.njit(cache=True)
def _wrapped(angle_rad: float) -> float:
    return float(angle_rad - 2.0 * pi * np.round(angle_rad / (2.0 * pi)))
