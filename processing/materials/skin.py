"""A skin: an SRF synthesised by example over any mesh, without seams.

The surface is covered patch by patch. Each patch is laid flat along a smooth tangent field, finds the place in the
example that agrees best with what lies around it already, and is cut in along the line of least difference. All of it
happens on the surface: the atlas only says where its texels lie, so that borders of charts are nothing special.
"""

from dataclasses import dataclass, replace
from math import sqrt
from typing import NamedTuple

import numba
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from processing.errors import ImageError
from processing.materials.skin_atlas import Atlas, Texels, covered_texels, texels_per_unit_within, unwrap
from processing.materials.skin_cut import least_cut, share_within
from processing.materials.skin_example import CELL_TEXELS, Example, Fitter, example_of
from processing.materials.skin_field import tangent_field
from processing.materials.skin_patch import Layout, Sheet, empty_sheet, lay_flat, layout_of
from processing.materials.skin_seams import close_seams
from processing.materials.skin_surface import Int32, Surface, refine, weld
from processing.materials.skin_turn import STEPS, turning_table
from processing.products.arrays import Float32, Float64
from processing.products.srf import Srf

# Radius of a patch over the example's shorter side, and the width of the band over which it fades in, in texels.
_RADIUS = 0.25
_FEATHER_TEXELS = 3.0
_COVERED = 0.5


@dataclass(frozen=True, slots=True)
class SkinOptions:
    """`width` of the example on the mesh, in the mesh's units; atlas side at most about `size` texels; `seed`."""

    width: float
    size: int = 1024
    seed: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """An SRF made for one mesh, and that mesh cut into charts.

    `srf` is an atlas; `vertex` (n,) is the vertex of the given mesh that each vertex comes from, `triangles` (m, 3) are
    in the order given, `uv` (n, 2) has v downward, unit `tangents` (n, 3) are the t of the frame the residual is in,
    b = n x t. `patch` (y, x) numbers the patch that each texel shows, -1 where none is.
    """

    srf: Srf
    vertex: Int32
    triangles: Int32
    uv: Float64
    tangents: Float64
    patch: Int32


class _Canvas(NamedTuple):
    """The texels that are filled: coefficients, appearance, how far covered (0 to 1), and by which patch."""

    value: Float32
    seen: Float32
    cover: Float64
    patch: Int32


def drape(srf: Srf, positions: Float64, normals: Float64, triangles: Int32, options: SkinOptions) -> Skin:
    """Synthesise the SRF over a mesh with `positions` and unit `normals` (n, 3) and `triangles` (m, 3).

    The texture's columns run along t, which is level where the surface stands, its rows downward. The atlas is as fine
    as the example, or as `size` allows; lobe and basis stay. Undetermined residuals count as 0. A seed gives the same
    skin again. Raises ImageError where the mesh has no area, or the example is too coarse or too small on it.
    """
    place, places, place_normals = weld(positions, normals, triangles)
    corners = place[triangles]
    wanted = srf.residual.shape[2] / options.width
    resolution = min(wanted, texels_per_unit_within(places, corners, options.size))
    example = example_of(srf, resolution / wanted)
    radius = _RADIUS * min(example.coefficients.shape[:2])
    if radius < 2 * CELL_TEXELS:
        raise ImageError(
            f"the sample would have {2 * radius:.0f} texels for a patch of the skin: let it be wider, or the atlas finer"
        )
    atlas = unwrap(positions, triangles, resolution)
    surface = Surface(resolution * places, place_normals, corners, atlas.uv_texels[atlas.triangles])
    surface = refine(surface, 0.25 * radius)
    field = tangent_field(surface, 4.0 * radius)
    texels = covered_texels(surface.corner_uv, atlas.shape)
    layout = layout_of(surface, field, texels)
    canvas = _grow(example, layout, texels, radius, turning_table(srf.basis), np.random.default_rng(options.seed))
    return _finished(srf, atlas, place, field, texels, canvas, options)


def _finished(srf, atlas, place, field, texels, canvas, options):
    count = atlas.shape[0] * atlas.shape[1]
    flat = np.zeros((count, canvas.value.shape[1]), np.float32)
    flat[texels.index] = canvas.value
    texture = close_seams(flat.reshape(*atlas.shape, -1), atlas, place)
    residual = np.moveaxis(texture.reshape(*atlas.shape, 3, srf.basis.size), 2, 0)
    patch = np.full(count, -1, np.int32)
    patch[texels.index] = canvas.patch
    made = replace(srf, residual=np.ascontiguousarray(residual), wrap=True)
    return Skin(made, atlas.vertex, atlas.triangles, atlas.uv, field[place[atlas.vertex]], patch.reshape(atlas.shape))


def _grow(
    example: Example, layout: Layout, texels: Texels, radius: float, table: Float64, rng: Generator
) -> _Canvas:
    """Cover all texels, from the first triangle outward."""
    count = len(texels.index)
    canvas = _Canvas(
        np.zeros((count, example.coefficients.shape[2]), np.float32),
        np.zeros((count, example.appearance.shape[2]), np.float32),
        np.zeros(count),
        np.full(count, -1, np.int32),
    )
    sheet, cells = empty_sheet(layout), 2 * int(radius / CELL_TEXELS)
    fitter = Fitter(example, cells)
    number = 0
    for texel in _outward(layout, texels):
        if canvas.cover[texel] >= _COVERED:
            continue
        seed = _nearest_corner(layout, texels, texel)
        filled = lay_flat(layout, sheet, seed, radius, number)
        piece = Sheet(sheet.texel[:filled], sheet.xy[:filled], sheet.turn_rad[:filled], *sheet[3:])
        middle, radii = _fit(example, fitter, canvas, piece, cells, rng)
        _cut_in(canvas, piece, (example.coefficients, example.seen, table), middle, radii, number)
        canvas.cover[texel] = max(canvas.cover[texel], _COVERED)
        number += 1
    return canvas


def _fit(example, fitter, canvas, piece, cells, rng):
    """Middle of the place in the example (x, y) in texels, and the radii in texels of the line to cut along."""
    lying, mask = _binned(canvas, piece, cells)
    row, column = fitter.choose(lying, mask, rng)
    middle = (CELL_TEXELS * (column + 0.5 * cells), CELL_TEXELS * (row + 0.5 * cells))
    if mask.any():
        middle = _refined(canvas, piece, example.appearance, middle)
    taken = _window(example.appearance, middle, cells)
    error = ((lying - taken) ** 2).sum(axis=2)
    reach = 0.5 * cells - 0.5 - 0.5 * _FEATHER_TEXELS / CELL_TEXELS
    return middle, CELL_TEXELS * least_cut(error, mask, reach)


def _outward(layout: Layout, texels: Texels) -> NDArray[np.int64]:
    """Texels in order of their triangle's distance along the edges from where the first one lies; part by part."""
    n = len(layout.positions)
    source = np.repeat(np.arange(n), np.diff(layout.edge_start))
    length = np.linalg.norm(layout.positions[source] - layout.positions[layout.edge], axis=1)
    graph = sparse.csr_matrix((np.maximum(length, 1e-12), layout.edge, layout.edge_start), shape=(n, n))
    distance = np.full(n, np.inf)
    base = 0.0
    while np.isinf(distance).any():
        start = int(np.argmax(np.isinf(distance)))
        reached = dijkstra(graph, indices=start)
        part = np.isfinite(reached)
        distance[part] = base + reached[part]
        base += float(reached[part].max()) + 1.0
    nearest = distance[layout.triangles].min(axis=1)
    return np.argsort(nearest[texels.triangle], kind="stable")


def _nearest_corner(layout: Layout, texels: Texels, texel: int) -> int:
    second, third = texels.barycentric[texel]
    return int(layout.triangles[texels.triangle[texel], np.argmax([1.0 - second - third, second, third])])


@numba.njit(cache=True)
def _binned(canvas: _Canvas, piece: Sheet, cells: int) -> tuple[Float64, Float64]:
    """Means of what lies in the patch already over square cells, rows downward, and where anything lies."""
    total, count = np.zeros((cells, cells, canvas.seen.shape[1])), np.zeros((cells, cells))
    for k in range(len(piece.texel)):
        texel = piece.texel[k]
        if canvas.cover[texel] >= _COVERED:
            column = int(np.floor(piece.xy[k, 0] / CELL_TEXELS + 0.5 * cells))
            row = int(np.floor(0.5 * cells - piece.xy[k, 1] / CELL_TEXELS))
            if 0 <= row < cells and 0 <= column < cells:
                count[row, column] += 1.0
                total[row, column] += canvas.seen[texel]
    for row in range(cells):
        for column in range(cells):
            if count[row, column] > 0.0:
                total[row, column] /= count[row, column]
                count[row, column] = 1.0
    return total, count


@numba.njit(cache=True)
def _refined(canvas: _Canvas, piece: Sheet, appearance: Float32, middle: tuple[float, float]) -> tuple[float, float]:
    """The middle moved by up to a texel, in halves, to where what lies there differs least."""
    # A thousand texels tell half a texel as well as all of them.
    stride = max(len(piece.texel) // 1000, 1)
    found, least = middle, np.inf
    there = np.empty(appearance.shape[2])
    for down in range(-2, 3):
        for right in range(-2, 3):
            x, y = middle[0] + 0.5 * right, middle[1] + 0.5 * down
            total = 0.0
            for k in range(0, len(piece.texel), stride):
                texel = piece.texel[k]
                if canvas.cover[texel] >= _COVERED:
                    _sample(appearance, x + piece.xy[k, 0], y - piece.xy[k, 1], there)
                    for channel in range(len(there)):
                        total += (there[channel] - canvas.seen[texel, channel]) ** 2
            if total < least:
                found, least = (x, y), total
    return found


@numba.njit(cache=True)
def _window(appearance: Float32, middle: tuple[float, float], cells: int) -> Float64:
    """What the example looks like round `middle`, over cells."""
    window = np.empty((cells, cells, appearance.shape[2]))
    for row in range(cells):
        for column in range(cells):
            right, down = CELL_TEXELS * (column + 0.5 - 0.5 * cells), CELL_TEXELS * (row + 0.5 - 0.5 * cells)
            _sample(appearance, middle[0] + right, middle[1] + down, window[row, column])
    return window


@numba.njit(cache=True)
def _cut_in(canvas, piece, source, middle, radii, number):
    """Blend the example into the texels within the line."""
    coefficients, seen, table = source
    k = table.shape[1]
    there = np.empty(3 * k)
    for at in range(len(piece.texel)):
        texel = piece.texel[at]
        x, y = piece.xy[at]
        share = share_within(x, y, radii, _FEATHER_TEXELS)
        if share <= 0.0:
            continue
        _sample(coefficients, middle[0] + x, middle[1] - y, there)
        turn = table[int(np.round(piece.turn_rad[at] / (2.0 * np.pi) * STEPS)) % STEPS]
        kept = (1.0 - share) * canvas.cover[texel]
        new = share / (share + kept)
        for channel in range(3):
            for row in range(k):
                total = 0.0
                for column in range(k):
                    total += turn[row, column] * there[k * channel + column]
                at_value = k * channel + row
                canvas.value[texel, at_value] = (1.0 - new) * canvas.value[texel, at_value] + new * total
        for component in range(canvas.seen.shape[1]):
            total = 0.0
            for channel in range(3 * k):
                total += canvas.value[texel, channel] * seen[channel, component]
            canvas.seen[texel, component] = total
        canvas.cover[texel] = share + kept
        if new >= 0.5:
            canvas.patch[texel] = number


@numba.njit(cache=True)
def _sample(image: Float32, x: float, y: float, value: Float64) -> None:
    """Bilinear lookup into `value` (c,) at a place in texels, the first one's centre at (0.5, 0.5); it repeats."""
    h, w, channels = image.shape
    left, top = np.floor(x - 0.5), np.floor(y - 0.5)
    fx, fy = x - 0.5 - left, y - 0.5 - top
    c0, r0 = int(left) % w, int(top) % h
    c1, r1 = (c0 + 1) % w, (r0 + 1) % h
    for c in range(channels):
        upper = (1.0 - fx) * image[r0, c0, c] + fx * image[r0, c1, c]
        lower = (1.0 - fx) * image[r1, c0, c] + fx * image[r1, c1, c]
        value[c] = (1.0 - fy) * upper + fy * lower
