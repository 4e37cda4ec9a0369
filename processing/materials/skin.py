"""A skin: an SRF synthesised by example over any mesh, without seams.

The surface is covered patch by patch. Each patch is laid flat along a smooth tangent field, finds the place in the
example that agrees best with what lies around it already, and is cut in along the line of least difference. All of it
happens on the surface: the atlas only says where its texels lie, so that borders of charts are nothing special.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from processing.errors import ImageError
from processing.materials.skin_atlas import Texels, covered_texels, texels_per_unit_within, unwrap
from processing.materials.skin_canvas import (
    COVERED,
    FEATHER_TEXELS,
    Canvas,
    Source,
    cut_in,
    empty_canvas,
    lying,
    refined,
    window,
)
from processing.materials.skin_cut import least_cut
from processing.materials.skin_example import CELL_TEXELS, Example, Fitter, example_of
from processing.materials.skin_field import tangent_field
from processing.materials.skin_patch import Layout, Sheet, empty_sheet, further_out, lay_flat, layout_of
from processing.materials.skin_surface import Int32, Surface, refine, weld
from processing.materials.skin_turn import turning_table
from processing.products.arrays import Float64
from processing.products.srf import Srf

# Radius of a patch over the example's shorter side: a patch has many places to choose from, and whole bricks. From a
# sixth to a third cuts show equally little on stone, threads and bricks.
_RADIUS = 0.25
_LEAST_RADIUS_TEXELS = 8.0
_AHEAD = 0.3  # of a radius from an open texel: within what a patch shows in any case


@dataclass(frozen=True, slots=True)
class SkinOptions:
    """`width` of the example on the mesh, in the mesh's units; the atlas has about `size` texels on a side at most."""

    width: float
    size: int = 1024
    seed: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """An SRF made for one mesh, and that mesh cut into charts.

    `srf` is an atlas; `vertex` (n,) is the vertex of the given mesh that each vertex comes from, `triangles` (m, 3) are
    in the order given, `uv` (n, 2) has v downward, unit `tangents` (n, 3) are the t of the frame the residual is in,
    b = n x t. `patch` (y, x) numbers the patch that each texel shows, -1 where there is none.
    """

    srf: Srf
    vertex: Int32
    triangles: Int32
    uv: Float64
    tangents: Float64
    patch: Int32


def drape(srf: Srf, positions: Float64, normals: Float64, triangles: Int32, options: SkinOptions) -> Skin:
    """Synthesise the SRF over a mesh with `positions` and unit `normals` (n, 3) and `triangles` (m, 3).

    The sample's columns run along t, level where the surface stands, its rows downward. The atlas is as fine as the
    sample, or as `size` allows; lobe and basis stay. Patches come from where residuals are determined, as far as there
    is room; others count as 0. A seed gives the same skin again. Raises ImageError where the mesh has no area, or too
    few texels show the sample on it.
    """
    place, places, place_normals = weld(positions, normals, triangles)
    corners = place[triangles]
    wanted = srf.residual.shape[2] / options.width
    resolution = min(wanted, texels_per_unit_within(places, corners, options.size))
    example = example_of(srf, resolution / wanted)
    radius = _RADIUS * min(example.coefficients.shape[:2])
    if radius < _LEAST_RADIUS_TEXELS:
        texels = min(example.coefficients.shape[:2])
        raise ImageError(f"the sample would show with {texels} texels on the mesh: draw it wider or the texture finer")
    atlas = unwrap(positions, triangles, resolution)
    surface = Surface(resolution * places, place_normals, corners, atlas.uv_texels[atlas.triangles])
    surface = refine(surface, 0.25 * radius)
    field = tangent_field(surface, 4.0 * radius)
    texels = covered_texels(surface.corner_uv, atlas.shape)
    canvas = _grown(example, layout_of(surface, field, texels), texels, turning_table(srf.basis), options.seed)
    texture = _image(canvas.value, texels, atlas.shape)
    residual = np.moveaxis(texture.reshape(*atlas.shape, 3, srf.basis.size), 2, 0)
    made = replace(srf, residual=np.ascontiguousarray(residual), wrap=True)
    patch = _image(canvas.patch + 1, texels, atlas.shape) - 1
    return Skin(made, atlas.vertex, atlas.triangles, atlas.uv, field[place[atlas.vertex]], patch)


def _grown(example: Example, layout: Layout, texels: Texels, turning: Float64, seed: int) -> Canvas:
    """All texels covered, patch by patch, from one triangle of each part outward."""
    source, rng = Source(example.coefficients, example.seen, turning), np.random.default_rng(seed)
    canvas, sheet = empty_canvas(source, len(texels.index)), empty_sheet(layout)
    cells = 2 * int(_RADIUS * min(example.coefficients.shape[:2]) / CELL_TEXELS)
    fitter, radius = Fitter(example, cells), 0.5 * cells * CELL_TEXELS
    number = 0
    distance, order = _outward(layout, texels)
    for texel in order:
        if canvas.cover[texel] >= COVERED:
            continue
        corner = _nearest_corner(layout, texels, texel)
        # A patch that begins further out has more to cover; if that misses the texel, one at its own corner does not.
        for start in (further_out(layout, distance, corner, _AHEAD * radius), corner):
            if canvas.cover[texel] < COVERED:
                piece = sheet.first(lay_flat(layout, sheet, start, radius, number))
                middle, radii = _fitted(fitter, canvas, piece, rng)
                cut_in(canvas, piece, source, middle, radii, number)
                number += 1
    return canvas


def _fitted(fitter: Fitter, canvas: Canvas, piece: Sheet, rng: Generator) -> tuple[tuple[float, float], Float64]:
    """Middle (x, y) of the best place in the example, and the radii of the line to cut along, both in texels."""
    cells, appearance = fitter.cells, fitter.example.appearance
    there, mask = lying(canvas, piece, cells)
    row, column = fitter.choose(there, mask, rng)
    middle = (CELL_TEXELS * (column + 0.5 * cells), CELL_TEXELS * (row + 0.5 * cells))
    if mask.any():
        middle = refined(canvas, piece, appearance, middle)
    error = ((there - window(appearance, middle, cells)) ** 2).sum(axis=2)
    reach = 0.5 * cells - 0.5 - 0.5 * FEATHER_TEXELS / CELL_TEXELS
    return middle, CELL_TEXELS * least_cut(error, mask, reach)


def _outward(layout: Layout, texels: Texels) -> tuple[Float64, NDArray[np.int64]]:
    """Distance of the vertices along the edges from the first one of each connected part; texels in that order."""
    n = len(layout.positions)
    source = np.repeat(np.arange(n), np.diff(layout.edge_start))
    length = np.linalg.norm(layout.positions[source] - layout.positions[layout.edge], axis=1)
    graph = sparse.csr_matrix((np.maximum(length, 1e-12), layout.edge, layout.edge_start), shape=(n, n))
    _, part = connected_components(graph, directed=False)
    starts = np.unique(part, return_index=True)[1]
    distance = dijkstra(graph, indices=starts, min_only=True)
    triangle = texels.triangle
    nearest = distance[layout.triangles].min(axis=1)[triangle]
    return distance, np.lexsort((nearest, part[layout.triangles[triangle, 0]]))


def _nearest_corner(layout: Layout, texels: Texels, texel: int) -> int:
    second, third = texels.barycentric[texel]
    return int(layout.triangles[texels.triangle[texel], np.argmax([1.0 - second - third, second, third])])


def _image(values: NDArray[Any], texels: Texels, shape: tuple[int, int]) -> NDArray[Any]:
    """Values per texel (t, ...) as the atlas (rows, columns, ...), 0 where nothing is needed."""
    flat = np.zeros((shape[0] * shape[1], *values.shape[1:]), values.dtype)
    flat[texels.index] = values
    return flat.reshape(*shape, *values.shape[1:])
