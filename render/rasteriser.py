"""A rasteriser in NumPy: which triangles lie under each pixel, which of them it sees, and where in them."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from render.arrays import Float64, Int32, Rows
from render.camera import Camera
from render.mesh import Mesh

# Candidate pixels that are tested at once: 3 float64 each, so about 100 MB.
_CANDIDATES = 2_000_000


@dataclass(frozen=True)
class Fragments:
    """Points of a mesh: flat `pixel` index, `triangle`, `barycentric` (n, 3) in space, `depth` along the camera's z."""

    pixel: Int32
    triangle: Int32
    barycentric: Float64
    depth: Float64

    def chosen(self, which: Rows) -> "Fragments":
        """Those that an index or a mask (n,) names."""
        return Fragments(self.pixel[which], self.triangle[which], self.barycentric[which], self.depth[which])

    def interpolate(self, mesh: Mesh, values: Rows) -> Float64:
        """Values per vertex (vertices, c) at the fragments, (n, c)."""
        corners = values[mesh.triangles[self.triangle]]
        return np.asarray(np.einsum("nk,nkc->nc", self.barycentric, corners))

    def next_pixels(self, mesh: Mesh, camera: Camera) -> tuple["Fragments", "Fragments"]:
        """Where the planes of the same triangles are seen one pixel to the right, and one below."""
        corners = camera.projected(mesh.positions)[mesh.triangles[self.triangle]]
        edges = np.linalg.inv(np.swapaxes(corners, 1, 2))
        right, below = (self._at(self.barycentric / self.depth[:, None] + edges[:, :, k]) for k in range(2))
        return right, below

    def _at(self, over_depth: Float64) -> "Fragments":
        one_over_depth = over_depth.sum(axis=1)
        return replace(self, barycentric=over_depth / one_over_depth[:, None], depth=1.0 / one_over_depth)


def rasterise(mesh: Mesh, camera: Camera) -> Fragments:
    """The nearest front face under each pixel centre; pixels ascend and occur once."""
    found = all_fragments(mesh, camera.projected(mesh.positions), camera.size)
    return found.chosen(first_of_each(found.pixel, found.depth))


def all_fragments(mesh: Mesh, image: Rows, size: tuple[int, int], *, front: bool = True) -> Fragments:
    """Every front face under each pixel centre, or every back face, in no order.

    `image` (vertices, 3) are homogeneous image points whose third component is the depth: with M = [X0 X1 X2] for the
    corners, M^-1 (u, v, 1) are the barycentric coordinates over the depth. There is no division before the test, so a
    triangle that reaches behind the camera needs no clipping.
    Source: Olano and Greer, Triangle Scan Conversion using 2D Homogeneous Coordinates, 1997, 3.
    """
    columns = np.swapaxes(image[mesh.triangles], 1, 2)
    # Image rows run downward, so a front face has a negative determinant in (right, down, forward).
    determinant = np.linalg.det(columns) * (1.0 if front else -1.0)
    scale = np.abs(columns).max(axis=(1, 2)) ** 3
    facing = np.flatnonzero(determinant < -1e-15 * scale)
    edges = np.linalg.inv(columns[facing])
    found = [
        _covered(edges[part], low, shape, facing[part], size) for part, low, shape in _boxes(columns[facing], size)
    ]
    return _joined(found)


def first_of_each(pixel: Int32, distance: Rows) -> Int32:
    """Numbers of the rows that are nearest in their pixel, pixels ascending."""
    order = np.lexsort((distance, pixel))
    return np.asarray(order[np.flatnonzero(np.diff(pixel[order], prepend=-1))])


def _boxes(columns: Rows, size: tuple[int, int]) -> Iterator[tuple[Int32, Int32, tuple[int, int]]]:
    """Triangles in groups of like extent: their numbers, first pixel (n, 2) as column and row, and the box's shape."""
    depth = columns[:, 2]
    behind = depth.min(axis=1) <= 0.0
    image_px = columns[:, :2] / np.where(depth > 0.0, depth, 1.0)[:, None]
    limit = np.array(size)
    low = np.where(behind[:, None], 0.0, np.ceil(image_px.min(axis=2))).clip(0, limit).astype(np.int32)
    high = np.where(behind[:, None], limit, np.floor(image_px.max(axis=2)) + 1).clip(0, limit).astype(np.int32)
    extent = high - low
    side = np.ceil(np.log2(np.maximum(extent.max(axis=1), 1))).astype(np.int32)
    seen = (extent > 0).all(axis=1) & (depth.max(axis=1) > 0.0)
    for power in np.unique(side[seen]):
        members = np.flatnonzero(seen & (side == power)).astype(np.int32)
        shape = (int(extent[members, 0].max()), int(extent[members, 1].max()))
        step = max(_CANDIDATES // (shape[0] * shape[1]), 1)
        for start in range(0, len(members), step):
            part = members[start : start + step]
            yield part, low[part], shape


def _covered(edges: Rows, low: Int32, shape: tuple[int, int], numbers: Rows, size: tuple[int, int]) -> Fragments:
    """Every pixel of the boxes that lies in its triangle, before the camera."""
    column = low[:, 0, None] + np.arange(shape[0])
    row = low[:, 1, None] + np.arange(shape[1])
    along_column, along_row, constant = (edges[:, :, k] for k in range(3))
    # (triangle, corner, row, column): linear in the pixel.
    over_depth = (
        along_row[:, :, None, None] * row[:, None, :, None]
        + along_column[:, :, None, None] * column[:, None, None, :]
        + constant[:, :, None, None]
    )
    inside = (over_depth >= 0.0).all(axis=1) & (row[:, :, None] < size[1]) & (column[:, None, :] < size[0])
    which, r, c = np.nonzero(inside)
    weights = over_depth[which, :, r, c]
    one_over_depth = weights.sum(axis=1)
    pixel = row[which, r].astype(np.int32) * size[0] + column[which, c].astype(np.int32)
    return Fragments(
        pixel.astype(np.int32),
        numbers[which].astype(np.int32),
        weights / one_over_depth[:, None],
        1.0 / one_over_depth,
    )


def _joined(found: list[Fragments]) -> Fragments:
    pixel = np.concatenate([f.pixel for f in found] or [np.zeros(0, np.int32)])
    triangle = np.concatenate([f.triangle for f in found] or [np.zeros(0, np.int32)])
    barycentric = np.concatenate([f.barycentric for f in found] or [np.zeros((0, 3))])
    depth = np.concatenate([f.depth for f in found] or [np.zeros(0)])
    return Fragments(pixel, triangle, barycentric, depth)
