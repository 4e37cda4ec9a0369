"""Texels on both sides of a chart's border, moved so that bilinear lookup meets along it."""

import numpy as np
from scipy import sparse

from processing.materials.skin_atlas import Atlas
from processing.materials.skin_solver import conjugate_gradients
from processing.materials.skin_surface import Int32, directed_edges
from processing.products.arrays import Float32, Float64
from processing.products.texture import bilinear_taps

# How much a texel's own value counts beside one sample of the border: little, so that of jumps a tenth is left at most.
_KEEP = 0.01


def close_seams(texture: Float32, atlas: Atlas, place: Int32) -> Float32:
    """The texture (rows, columns, c) with no steps where charts meet.

    Minimises the squared difference of both sides' bilinear lookups over samples a texel apart along every border, plus
    `_KEEP` times the squared change of each texel. `place` (n,) is the welded vertex of each vertex of the atlas.
    Source: Liu et al., Seamless: Seam erasure and seam-aware decoupling of shape from mesh resolution, 2017, 3.
    """
    left, right = _border_samples(atlas, place)
    if not len(left):
        return texture
    rows, columns = texture.shape[:2]
    jump = _lookup(left, atlas.shape) - _lookup(right, atlas.shape)
    used = np.unique(jump.indices)
    jump = jump.tocsc()[:, used].tocsr()
    flat = texture.reshape(rows * columns, -1)
    moved = flat.copy()
    start = flat[used].astype(np.float64)
    normal = (jump.T @ jump + _KEEP * sparse.identity(len(used))).tocsr()
    # What remains after these steps is far below the step that was there.
    moved[used] = start + conjugate_gradients(normal, -(jump.T @ (jump @ start)), tolerance=1e-3, most_steps=100)
    return moved.reshape(texture.shape)


def border_edges(atlas: Atlas, place: Int32) -> tuple[Int32, Int32]:
    """Ends (e, 2) in the atlas of every edge where two charts meet: on one side and on the other, in one sense."""
    edges = directed_edges(atlas.triangles)
    ends = place[atlas.vertex[edges]]
    turned = ends[:, 0] > ends[:, 1]
    edges[turned], ends[turned] = edges[turned][:, ::-1], ends[turned][:, ::-1]
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    edges, ends = edges[order], ends[order]
    meets = (ends[1:] == ends[:-1]).all(axis=1) & (edges[1:] != edges[:-1]).any(axis=1)
    return edges[:-1][meets], edges[1:][meets]


def _border_samples(atlas: Atlas, place: Int32) -> tuple[Float64, Float64]:
    """Texture coordinates (s, 2) in texels of points along all borders, on either side, a texel apart."""
    sides = [atlas.uv_texels[edges] for edges in border_edges(atlas, place)]
    longest = np.maximum(*(np.linalg.norm(side[:, 1] - side[:, 0], axis=1) for side in sides))
    count = np.ceil(longest).astype(np.int64) + 1
    edge = np.repeat(np.arange(len(count)), count)
    along = (np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)) / (count[edge] - 1).clip(1)
    left, right = (side[edge, 0] + along[:, None] * (side[edge, 1] - side[edge, 0]) for side in sides)
    return left, right


def _lookup(uv_texels: Float64, shape: tuple[int, int]) -> sparse.csr_matrix:
    """The matrix (s, texels) of bilinear lookup at these places."""
    rows, columns, weights = bilinear_taps(uv_texels / np.array(shape[::-1]), *shape, wrap=True)
    index = (rows * shape[1] + columns).ravel()
    start = np.arange(0, len(index) + 1, 4)
    return sparse.csr_matrix((weights.ravel(), index, start), shape=(len(rows), shape[0] * shape[1]))
