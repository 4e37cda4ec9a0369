"""The atlas of a mesh: charts without overlap, and what lies under each of its texels and gutters."""

from dataclasses import dataclass
from math import sqrt

import numba
import numpy as np
import xatlas
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.materials.skin_surface import Int32
from processing.products.arrays import Float64

# Unfolding takes time that grows faster than a chart: more than this share of the surface is not put into one.
_LARGEST_CHART = 0.005
# Bilinear lookup inside a chart reads texels up to a texel's diagonal outside, on either side of the gap.
_GUTTER_TEXELS = 1.5
_PADDING_TEXELS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Atlas:
    """A mesh cut into charts: `vertex` (n,) is each corner's vertex in the mesh, `triangles` (m, 3) in its order.

    `uv_texels` (n, 2) counts texels to the right and downward in a texture of `shape` (rows, columns).
    """

    vertex: Int32
    triangles: Int32
    uv_texels: Float64
    shape: tuple[int, int]

    @property
    def uv(self) -> Float64:
        """Texture coordinates (n, 2) from 0 to 1, v downward."""
        return self.uv_texels / np.array(self.shape[::-1], np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Texels:
    """Texels of the atlas that the mesh or its gutters need: flat `index` (t,), ascending by `triangle` (t,).

    `barycentric` (t, 2) are the weights of the triangle's second and third corner; in a gutter they leave [0, 1].
    """

    index: NDArray[np.int64]
    triangle: Int32
    barycentric: Float64


def unwrap(positions: Float64, triangles: Int32, texels_per_unit: float) -> Atlas:
    """Charts by xatlas, packed at `texels_per_unit` with room for gutters.

    Raises ImageError where the surface has no area.
    """
    area = _area(positions, triangles)
    if not area > 0.0:
        raise ImageError("the mesh has no area to lay a skin on")
    atlas = xatlas.Atlas()
    unit = 1.0 / sqrt(area)  # float32 inside: of a size that does not matter
    centred = (positions - positions.mean(axis=0)) * unit
    atlas.add_mesh(centred.astype(np.float32), triangles.astype(np.uint32))
    charts, packing = xatlas.ChartOptions(), xatlas.PackOptions()
    charts.max_chart_area = _LARGEST_CHART
    packing.padding, packing.bilinear = _PADDING_TEXELS, True
    packing.texels_per_unit = texels_per_unit / unit
    atlas.generate(charts, packing)
    vertex, corners, uv = atlas[0]
    shape = (int(atlas.height), int(atlas.width))
    scaled = uv.astype(np.float64) * np.array(shape[::-1], np.float64)
    return Atlas(vertex.astype(np.int32), corners.astype(np.int32), scaled, shape)


def texels_per_unit_within(positions: Float64, triangles: Int32, size: int) -> float:
    """The resolution at which an atlas has about `size` texels on a side: charts fill half of it."""
    return sqrt(0.5 * size * size / max(_area(positions, triangles), 1e-300))


def covered_texels(corner_uv: Float64, shape: tuple[int, int]) -> Texels:
    """The triangle under each texel's centre, or the nearest one for texels that bilinear lookup reads beside it."""
    triangle, barycentric = _cover(corner_uv, shape)
    index = np.flatnonzero(triangle >= 0)
    order = index[np.argsort(triangle.ravel()[index], kind="stable")]
    return Texels(order, triangle.ravel()[order], barycentric.reshape(-1, 2)[order])


def _area(positions: Float64, triangles: Int32) -> float:
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2.0


@numba.njit(cache=True)
def _cover(corner_uv: Float64, shape: tuple[int, int]) -> tuple[Int32, Float64]:
    triangle = np.full(shape, -1, np.int32)
    barycentric = np.zeros((*shape, 2))
    distance = np.full(shape, _GUTTER_TEXELS**2)
    for m in range(len(corner_uv)):
        a, b, c = corner_uv[m]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        if area == 0.0:
            continue
        left, top = min(a[0], b[0], c[0]), min(a[1], b[1], c[1])
        right, bottom = max(a[0], b[0], c[0]), max(a[1], b[1], c[1])
        for row in range(max(int(top - 2), 0), min(int(bottom + 3), shape[0])):
            for column in range(max(int(left - 2), 0), min(int(right + 3), shape[1])):
                x, y = column + 0.5 - a[0], row + 0.5 - a[1]
                second = (x * (c[1] - a[1]) - (c[0] - a[0]) * y) / area
                third = ((b[0] - a[0]) * y - x * (b[1] - a[1])) / area
                if second >= 0.0 and third >= 0.0 and second + third <= 1.0:
                    near = 0.0
                else:
                    near = min(
                        _to_segment(x, y, b - a),
                        _to_segment(x, y, c - a),
                        _to_segment(x - b[0] + a[0], y - b[1] + a[1], c - b),
                    )
                # Beside a sliver its coordinates run away; another triangle or none has that texel.
                if near < distance[row, column] and max(abs(second), abs(third), abs(1 - second - third)) < 4.0:
                    distance[row, column] = near
                    triangle[row, column] = m
                    barycentric[row, column, 0] = second
                    barycentric[row, column, 1] = third
    return triangle, barycentric


@numba.njit(cache=True)
def _to_segment(x: float, y: float, side: Float64) -> float:
    """Squared distance of (x, y) to the segment from the origin to `side`."""
    along = (x * side[0] + y * side[1]) / max(side[0] ** 2 + side[1] ** 2, 1e-30)
    along = min(max(along, 0.0), 1.0)
    return float((x - along * side[0]) ** 2 + (y - along * side[1]) ** 2)
