"""A triangulated set of directions, to interpolate a measured material between them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import Delaunay, QhullError

from processing.errors import ImageError
from processing.products.arrays import Float64, Int32

CELLS = 128
_SPREAD = 1 << 15  # points of the disc over which shares are counted: their error is under 1e-4
# A point is in a region whose tests it fails by no more than this: on a border rounding would send it to and fro.
_TOLERANCE = 1e-12


@dataclass(frozen=True, eq=False)
class Regions:
    """The plane of the disc cut into convex regions, in each of which all weights are linear.

    A triangle of measured directions is one; so is the strip beyond each edge of their hull, whose points are nearest
    to that edge, and the wedge beyond each of the hull's corners. With q = (x, y) - `origin` (r, 2), second and third
    are `slopes` (r, 2, 2) times q, first is 1 less those of them that `counted` (r, 2) says are weights: of the three
    directions `corners` (r, 3). A point lies where none of the three is negative; `beyond` (r, 3) is the region across
    the border that a negative one tells of.
    """

    corners: Int32
    origin: Float64
    slopes: Float64
    counted: Float64
    beyond: Int32

    def tests(self, region: Int32, xy: Float64) -> Float64:
        """First, second and third (n, 3) of points (n, 2) in regions (n,)."""
        later = np.einsum("nij,nj->ni", self.slopes[region], xy - self.origin[region])
        first = 1 - (later * self.counted[region]).sum(axis=1)
        return np.column_stack([first, later])

    def walk(self, region: Int32, xy: Float64) -> Int32:
        """The regions (n,) that hold points (n, 2), from where to start: always across the border most trespassed."""
        region, moving = region.copy(), np.arange(len(region))
        for _ in range(len(self.corners)):
            tests = self.tests(region[moving], xy[moving])
            worst = tests.argmin(axis=1)
            outside = np.take_along_axis(tests, worst[:, None], axis=1)[:, 0] < -_TOLERANCE
            moving, worst = moving[outside], worst[outside]
            if not len(moving):
                break
            region[moving] = self.beyond[region[moving], worst]
        return region


@dataclass(frozen=True, eq=False)
class DirectionMesh:
    """Directions over the upper hemisphere, triangulated over the (x, y) disc.

    `directions` (n, 3) are unit vectors away from the sample, `triangles` (m, 3) index them (Delaunay).
    `cells` (128, 128), row = y and column = x over [-1, 1], names for each cell the region of `regions` that its centre
    lies in: from there it is a step or two to where a point lies, and a shader needs no search.
    """

    directions: Float64
    triangles: Int32
    regions: Regions
    cells: Int32

    @classmethod
    def from_directions(cls, directions: Float64) -> "DirectionMesh":
        """Triangulate; raises ImageError for fewer than three directions or all of them on one line of the disc."""
        directions = np.asarray(directions, np.float64)
        try:
            triangles = _triangles(directions[:, :2])
        except (QhullError, ValueError) as error:
            raise ImageError(
                f"{len(directions)} directions do not span an area of the disc: three or more, not on one line, are "
                "needed of lights and of views alike."
            ) from error
        regions = _regions(directions[:, :2], triangles)
        return cls(directions, triangles, regions, _cell_table(regions))

    def weights(self, direction: Float64) -> tuple[Int32, Float64]:
        """Indices (n, 3) of three measured directions and their weights (n, 3), for directions (n, 3).

        Barycentric coordinates in the triangle around the point of the disc, or around the point of the hull that is
        nearest to it: continuous everywhere, and a measured direction answers for itself.
        """
        xy = np.asarray(direction, np.float64)[:, :2]
        cell = np.clip(np.floor((xy + 1) * (CELLS / 2)).astype(np.intp), 0, CELLS - 1)
        region = self.regions.walk(self.cells[cell[:, 1], cell[:, 0]], xy)
        weights = self.regions.tests(region, xy)
        weights[:, 1:] *= self.regions.counted[region]
        weights = np.maximum(weights, 0.0)
        return self.regions.corners[region], weights / weights.sum(axis=1, keepdims=True)

    @cached_property
    def cosine_shares(self) -> Float64:
        """Share (n,) that each direction has of an integral over the hemisphere with the cosine, divided by pi.

        The cosine times the solid angle is area of the disc: interpolated values are averaged over it, at the points
        of a sunflower (Vogel 1979). The sum is 1.
        """
        turn = np.arange(_SPREAD) * np.pi * (3 - np.sqrt(5))
        radius = np.sqrt((np.arange(_SPREAD) + 0.5) / _SPREAD)
        points = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - radius**2)])
        index, weight = self.weights(points)
        return np.bincount(index.ravel(), weight.ravel(), len(self.directions)) / _SPREAD

    @property
    def lowest(self) -> float:
        """Cosine to the normal of the lowest direction."""
        return float(self.directions[:, 2].min())

    def raised(self, direction: Float64) -> Float64:
        """Unit vectors (n, 3) above the horizon, those below the lowest measured one raised to its height."""
        direction = np.asarray(direction, np.float64)
        level = np.linalg.norm(direction[:, :2], axis=1, keepdims=True)
        flat = direction[:, :2] * (np.sqrt(1 - self.lowest**2) / np.maximum(level, 1e-9))
        raised = np.column_stack([flat, np.full(len(direction), self.lowest)])
        return np.where(direction[:, 2:] < self.lowest, raised, direction)


def _triangles(xy: Float64) -> Int32:
    """Delaunay's, counterclockwise, without those of no area that lie along a straight border."""
    triangles = Delaunay(xy).simplices.astype(np.int32)
    a, b, c = (xy[triangles[:, k]] for k in range(3))
    whole = triangles[_cross(b - a, c - a) > 1e-12]
    if not len(whole):
        raise ValueError("all triangles are flat")
    return whole


def _regions(xy: Float64, triangles: Int32) -> Regions:
    """Triangles first, then the strips beyond the hull's edges, then the wedges at the starts of these edges."""
    sides = np.stack([triangles[:, [1, 2, 0]], triangles[:, [2, 0, 1]]], axis=-1)
    owner = {tuple(side): number // 3 for number, side in enumerate(sides.reshape(-1, 2).tolist())}
    hull = [side for side in owner if side[::-1] not in owner]
    strip = {side: len(triangles) + number for number, side in enumerate(hull)}
    wedge = {side[0]: len(triangles) + len(hull) + number for number, side in enumerate(hull)}
    before = {end: (start, end) for start, end in hull}

    a, b, c = (xy[triangles[:, k]] for k in range(3))
    area = _cross(b - a, c - a)[:, None]
    inside = np.stack([_turned_left(a - c), _turned_left(b - a)], axis=1) / area[:, :, None]
    across = [[owner.get(side[::-1], strip.get(side, -1)) for side in map(tuple, rows)] for rows in sides.tolist()]

    start, end = np.array(hull).T
    way = xy[end] - xy[start]
    along = way / (way * way).sum(axis=1, keepdims=True)
    strips = np.stack([along, -_turned_left(along)], axis=1)
    last = np.array([hull.index(before[p]) for p in start.tolist()])
    wedges = np.stack([along[last], -along], axis=1)
    h = len(hull)
    return Regions(
        np.concatenate([triangles, np.column_stack([start, end, start]), np.tile(start[:, None], 3)]).astype(np.int32),
        np.concatenate([a, xy[start], xy[start]]),
        np.concatenate([inside, strips, wedges]),
        np.concatenate([np.ones((len(triangles), 2)), np.tile([1.0, 0.0], (h, 1)), np.zeros((h, 2))]),
        np.array(
            across
            + [[wedge[q], wedge[p], owner[p, q]] for p, q in hull]
            + [[wedge[p], strip[before[p]], strip[p, q]] for p, q in hull],
            dtype=np.int32,
        ),
    )


def _turned_left(vectors: Float64) -> Float64:
    """Vectors (n, 2) turned by a quarter to the left."""
    return np.stack([-vectors[:, 1], vectors[:, 0]], axis=1)


def _cross(a: Float64, b: Float64) -> Float64:
    product: Float64 = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product


def _cell_table(regions: Regions) -> Int32:
    centre = (np.arange(CELLS) + 0.5) * (2 / CELLS) - 1
    points = np.stack(np.meshgrid(centre, centre), axis=-1).reshape(-1, 2)
    return regions.walk(np.zeros(len(points), np.int32), points).reshape(CELLS, CELLS)


def toward(points: Float64, direction: Float64, distance: float) -> Float64:
    """Unit vectors (..., 3) from points (..., 3) to what lies `distance` from their origin in a unit direction (3,)."""
    if np.isinf(distance):
        return np.broadcast_to(np.asarray(direction, np.float64), points.shape).copy()
    vector = direction * distance - points
    return np.asarray(vector / np.linalg.norm(vector, axis=-1, keepdims=True), np.float64)


def falloff(points: Float64, direction: Float64, distance: float) -> Float64:
    """Irradiance at normal incidence at points (..., 3) over that at the origin, (...); arguments as in `toward`."""
    if np.isinf(distance):
        return np.ones(points.shape[:-1])
    way = direction * distance - points
    return np.asarray(distance**2 / (way * way).sum(axis=-1), np.float64)
