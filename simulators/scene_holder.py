"""The stepped white holder, and the sample in its opening: which of them a ray hits first, and what shades it."""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from simulators.layout import HolderLayout
from simulators.scene import Array, Floats, Hits, Mask, Sample, among_matt

MISS, FRAME, OPENING = 0, 1, 2

Box = tuple[float, float, float, float]  # half widths of opening, upper and lower frame, and the step's height


@dataclass(frozen=True)
class HolderScene:
    """A sample in the holder; the scene's frame is the sample frame."""

    holder: HolderLayout
    sample: Sample

    @property
    def box(self) -> Box:
        """Half widths of the opening, the upper and the lower frame, and the height of the step."""
        holder = self.holder
        return holder.opening_m / 2, holder.upper_m / 2, holder.lower_m / 2, holder.step_m

    def trace(self, origin: Array, directions: Array) -> Hits:
        """First hits of rays from one origin (3,) along unit directions (n, 3)."""
        kinds = np.zeros(len(directions), np.uint8)
        entries, points = np.empty((len(directions), 3)), np.empty((len(directions), 3))
        normals = np.zeros((len(directions), 3), np.float32)
        _trace(origin, np.ascontiguousarray(directions), self.box, (kinds, entries, points, normals))
        inside = np.flatnonzero(kinds == OPENING)
        found = self.sample.trace(entries[inside], points[inside] - entries[inside])
        points[inside[found.ray]] = found.points
        normals[inside[found.ray]] = found.normals
        ray = np.flatnonzero(kinds)
        of_sample = np.searchsorted(ray, inside[found.ray])
        material = among_matt(len(ray), self.holder.albedo, of_sample, found.material)
        return Hits(ray, points[ray], normals[ray], material)

    def lit(self, hits: Hits, source: Array) -> Mask:
        """Which hits (n,) see the point source (3,)."""
        starts = hits.points + self.sample.offset_m * hits.normals
        ways = source - starts
        visible, climbs = np.empty(len(starts), np.bool_), np.zeros(len(starts), np.bool_)
        _lit(starts, ways, hits.normals, self.box, (visible, climbs))
        visible[climbs] = ~self.sample.blocks(starts[climbs], ways[climbs])
        return visible


@numba.njit(cache=True)
def _to_square(p: Array, d: Array, half: float) -> tuple[float, float]:
    """Where the line p + t d enters and leaves the upright square prism |x|, |y| <= half; enter > leave: it misses."""
    enter, leave = -np.inf, np.inf
    for k in range(2):
        if d[k] == 0.0:
            if abs(p[k]) > half:
                return np.inf, -np.inf
            continue
        near, far = (-half - p[k]) / d[k], (half - p[k]) / d[k]
        if near > far:
            near, far = far, near
        enter, leave = max(enter, near), min(leave, far)
    return enter, leave


@numba.njit(cache=True)
def _side_normal(point: Array, sign: float, normal: Floats) -> None:
    """Normal of an upright wall at this point: outward for sign +1, into the opening for -1."""
    k = 0 if abs(point[0]) > abs(point[1]) else 1
    normal[0] = normal[1] = normal[2] = 0.0
    normal[k] = sign if point[k] > 0 else -sign


@numba.njit(cache=True)
def _hit(p: Array, d: Array, box: Box, normal: Floats) -> tuple[int, float, float]:
    """Kind, parameter and normal of the frame's first hit by one ray from outside, as if the opening were empty.

    The third number is where a ray into the OPENING enters it. Such a ray ends on a wall, or where it is as deep as
    the step.
    """
    opening, upper, lower, step = box
    normal[2] = 1.0
    bottom = (-step - p[2]) / d[2] if d[2] < 0.0 else -1.0
    if d[2] < 0.0 and p[2] > 0.0:
        top = -p[2] / d[2]
        x, y = abs(p[0] + top * d[0]), abs(p[1] + top * d[1])
        if max(x, y) <= opening:
            _, wall = _to_square(p, d, opening)
            if wall < bottom:
                _side_normal(p + wall * d, -1.0, normal)
            return OPENING, min(wall, bottom), top
        if max(x, y) <= upper:
            return FRAME, top, top
    enter, leave = _to_square(p, d, upper)
    if 0.0 < enter < leave and -step <= p[2] + enter * d[2] <= 0.0:
        _side_normal(p + enter * d, 1.0, normal)
        return FRAME, enter, enter
    if bottom > 0.0 and max(abs(p[0] + bottom * d[0]), abs(p[1] + bottom * d[1])) <= lower:
        return FRAME, bottom, bottom
    return MISS, 0.0, 0.0


@numba.njit(cache=True)
def _trace(origin: Array, directions: Array, box: Box, out: tuple[NDArray[np.uint8], Array, Array, Floats]) -> None:
    kinds, entries, points, normals = out
    for i in range(len(directions)):
        kinds[i], t, top = _hit(origin, directions[i], box, normals[i])
        entries[i] = origin + top * directions[i]
        points[i] = origin + t * directions[i]


@numba.njit(cache=True)
def _lit(starts: Array, ways: Array, normals: Floats, box: Box, out: tuple[Mask, Mask]) -> None:
    """Whether the holder leaves light to each point, and whether that has to climb through the opening.

    Those ways then end at the reference plane.
    """
    visible, climbs = out
    opening, upper, _, _ = box
    for i in range(len(starts)):
        p, d = starts[i], ways[i]
        if d[0] * normals[i, 0] + d[1] * normals[i, 1] + d[2] * normals[i, 2] <= 0.0:
            visible[i] = False
        elif p[2] >= 0.0:
            visible[i] = d[2] > 0.0
        else:
            top = -p[2] / d[2] if d[2] > 0.0 else 1.0  # of the way; the holder ends at the reference plane
            inside = max(abs(p[0]), abs(p[1])) <= opening
            enter, leave = _to_square(p, d, opening if inside else upper)
            visible[i] = leave >= top if inside else not (enter < leave and leave > 0.0 and enter < top)
            climbs[i] = inside and visible[i]
            d *= top
