"""Where a ray that enters a wrapped sample first meets it: the depths of straight rays, asked along a bent surface.

A depth map over directions answers for straight rays over a flat sample. Wrapped around a mesh the sample bends under
the ray: seen from the surface, the ray grows flatter, turns level and leaves again. Here the surface below the ray is a
circle of the mesh's curvature along it. With c and a the cosine and sine of the angle between ray and normal where the
ray enters, k the curvature, and t the way gone, all follow in closed form:

    q = sqrt((1 - k c t)^2 + (k a t)^2)          distance to the circle's centre, over its radius
    depth under the surface      (1 - q) / k = t (2 c - k t) / (1 + q)
    way of the foot on the surface             L = atan2(k a t, 1 - k c t) / k
    cosine and sine to the normal there          (c - k t) / q  and  a / q
    seen from the surface a ray goes along it at a / q^2, since what lies deeper is shorter by q.

In each point of the ray a straight line follows it in the sample's own frame, in tiles. The depth of what that line
meets first is where the ray is looked at next. Two looks are enough: the first from where the ray enters.

A line flatter than the lowest measured direction is asked as if it were raised to that. What the raised line meets, the
flat one comes to at the same way along the surface, and higher: of the depth still to go, it loses the share that its
slope is of the raised one's.
"""

from dataclasses import dataclass

import numpy as np

from processing.products import Mesostructure
from render.arrays import Bool, Float64, unit

STEPS = 2
# Of the raised line's slope: a level line would never come down, and what lies far ahead is out of its reach.
_FLATTEST = 0.3
# Of the depth of the lowest point: where the length of a tile changes along a ray, that point lies a little deeper.
_UNDER = 1.25


@dataclass(frozen=True, eq=False)
class Entry:
    """Where rays enter a mesh: `uv` (n, 2), and unit vectors `view` (n, 3) toward where each comes from, in (t, b, n).

    `stretch` (n, 2) and `bending` (n, 3) are those of `wrapping.Wrapping` there. A ray followed backward from where it
    leaves is one too.
    """

    uv: Float64
    view: Float64
    stretch: Float64
    bending: Float64


@dataclass(frozen=True, eq=False)
class Meeting:
    """What rays meet: `found` (n,), and `distance` (n,) from the entry in world units.

    Where nothing is met the distance is that to the deepest point of the ray, `deepest` (n,), infinite over surfaces
    that do not bend away. `uv` (n, 2), in the texels' plane, and unit `view` (n, 3), in tiles along (t, b, n), are what
    the materials are asked with; `turn` (n, 3, 3) takes vectors of the entry's frame to the frame under the meeting.
    """

    found: Bool
    distance: Float64
    deepest: Float64
    uv: Float64
    view: Float64
    turn: Float64


@dataclass(frozen=True, eq=False)
class _Arc:
    """The circle under each ray: `cosine`, `sine`, `curvature` (n,), and the unit `heading` (n, 2) along (t, b)."""

    cosine: Float64
    sine: Float64
    curvature: Float64
    heading: Float64


@dataclass(frozen=True, eq=False)
class _Place:
    """A ray's point over its circle: `depth` and `foot` (the way of the foot), (n,) in world units.

    `cosine` and `sine` (n,) are the ray's to the normal there, as seen from the surface; `turn` (n, 2) is cosine and
    sine of the angle by which the normal has turned.
    """

    depth: Float64
    foot: Float64
    cosine: Float64
    sine: Float64
    turn: Float64


def march(structure: Mesostructure, entry: Entry, steps: int = STEPS) -> Meeting:
    """First meetings of rays that enter a mesh wrapped in `structure`, each asked `steps` times.

    A ray whose deepest point lies higher than what is asked for there meets nothing.
    """
    arc = _arc(entry)
    scale = tile_scale(entry)
    deepest = _deepest(arc)
    distance = np.zeros(len(entry.uv))
    for _ in range(steps):
        place = _place(arc, distance)
        uv, view, slope = _line(structure, entry, arc, place)
        ahead = scale * structure.depth(uv, view) - place.depth
        depth = place.depth + np.where(ahead > 0.0, slope, 1.0) * ahead
        found, distance = _distance(arc, depth, deepest)
    return Meeting(found, distance, deepest, uv, view, _turn(arc, place))


def base(structure: Mesostructure, entry: Entry) -> Float64:
    """Distances (n,) at which rays are under every point of the sample; infinite where they do not come so deep."""
    arc = _arc(entry)
    found, distance = _distance(arc, tile_scale(entry) * (_UNDER * structure.deepest), _deepest(arc))
    return np.where(found, distance, np.inf)


def meets(front: Meeting, back: Meeting, length: Float64) -> Bool:
    """Whether rays hit the sample between where they enter and, `length` (n,) on, where they leave the mesh.

    `back` is of the same rays followed backward from where they leave. Either way knows the surface down to the ray's
    deepest point over it. Where both meet something this is the paper's test (Wang et al. 2005, 4.1), else one
    of them has passed by its half of the sample.
    """
    return np.asarray((front.found | back.found) & (front.distance + back.distance <= length))


def tile_scale(entry: Entry) -> Float64:
    """World length (n,) of a depth of one tile: the texture scale s."""
    return np.asarray(np.sqrt(entry.stretch[:, 0] * entry.stretch[:, 1]))


def _arc(entry: Entry) -> _Arc:
    # A ray along the surface would not come down at all, and divide by nothing.
    cosine = np.clip(entry.view[:, 2], 1e-4, 1.0)
    level = np.linalg.norm(entry.view[:, :2], axis=1, keepdims=True)
    heading = np.where(level > 1e-9, -entry.view[:, :2] / np.maximum(level, 1e-9), [1.0, 0.0])
    x, y = heading.T
    tt, tb, bb = entry.bending.T
    return _Arc(cosine, np.sqrt(1.0 - cosine**2), tt * x * x + 2.0 * tb * x * y + bb * y * y, heading)


def _deepest(arc: _Arc) -> Float64:
    with np.errstate(divide="ignore"):
        return np.where(arc.curvature > 0.0, arc.cosine / np.maximum(arc.curvature, 0.0), np.inf)


def _place(arc: _Arc, distance: Float64) -> _Place:
    """Where the rays are after a distance."""
    up, aside = 1.0 - arc.curvature * arc.cosine * distance, arc.curvature * arc.sine * distance
    share = np.maximum(np.hypot(up, aside), 1e-6)
    depth = distance * (2.0 * arc.cosine - arc.curvature * distance) / (1.0 + share)
    with np.errstate(divide="ignore", invalid="ignore"):
        bent = np.arctan2(aside, up) / arc.curvature
    foot = np.where(np.abs(aside) > 1e-4, bent, arc.sine * distance / np.maximum(up, 1e-6))
    cosine = np.maximum(arc.cosine - arc.curvature * distance, 0.0) / share
    return _Place(depth, foot, cosine, arc.sine / share**2, np.column_stack([up, aside]) / share[:, None])


def _line(structure: Mesostructure, entry: Entry, arc: _Arc, place: _Place) -> tuple[Float64, Float64, Float64]:
    """Where the straight lines along the rays cross the texels' plane (n, 2), and whence they come (n, 3), in tiles.

    Both of lines that are raised where they are too flat; last, their own slope (n,) as a share of the raised one.
    """
    scale = tile_scale(entry)
    tiles = arc.heading / entry.stretch
    flat = unit(np.column_stack([-place.sine[:, None] * tiles, place.cosine / scale]))
    view = structure.views.raised(flat)
    down = structure.plane - place.depth / scale
    step = place.foot[:, None] * tiles - view[:, :2] * (down / view[:, 2])[:, None]
    lower = flat[:, 2] < structure.views.lowest
    level, raised_level = (np.linalg.norm(each[:, :2], axis=1) for each in (flat, view))
    share = flat[:, 2] * raised_level / np.where(lower, view[:, 2] * level, 1.0)
    # Texture coordinates run along t and against b.
    return entry.uv + step * [1.0, -1.0], view, np.where(lower, np.maximum(share, _FLATTEST), 1.0)


def _distance(arc: _Arc, depth: Float64, deepest: Float64) -> tuple[Bool, Float64]:
    """Whether rays come down to a depth under the surface, and after what distance; else that to the deepest point."""
    drop = np.minimum(arc.curvature * depth, 1.0)
    square = arc.cosine**2 - drop * (2.0 - drop)
    found = square >= 0.0
    below = arc.cosine + np.sqrt(np.maximum(square, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.where(depth > 0.0, depth * (2.0 - drop) / below, 0.0)
    return found, np.where(found, distance, deepest)


def _turn(arc: _Arc, place: _Place) -> Float64:
    """Rotations (n, 3, 3) that take vectors in the entry's (t, b, n) to the frame of the foot."""
    x, y = arc.heading.T
    cos, sin = place.turn.T
    rows = [
        [1.0 - (1.0 - cos) * x * x, -(1.0 - cos) * x * y, -sin * x],
        [-(1.0 - cos) * x * y, 1.0 - (1.0 - cos) * y * y, -sin * y],
        [sin * x, sin * y, cos],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
