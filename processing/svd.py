"""A BTF as a short sum of products, by singular value decomposition.

`factor_btf`: the matrix has a row per (texel, light, channel) and a column per view. It is tall: its Gram matrix, view
by view, is gathered in float64 over blocks of texel rows and gives the view weights; the eigenmaps are the projections
onto them. Two passes over data that need not fit in memory, and the rank-k error of the full decomposition.

`factor_texels`: the matrix has a row per texel and a column per (light, view, channel), which makes the smallest
factors. Neither side is short enough for a Gram matrix, so the strongest columns' space is found by iteration.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from processing.errors import ImageError
from processing.products import DirectionMesh, FactoredBtf, Provenance
from processing.products.arrays import Float32, Float64

_PASSES = 3  # of the iteration
_SPARE = 10  # functions beyond those that are kept


class BtfRows(Protocol):
    """A BTF that is read by blocks of texel rows: `Btf` in memory or `StoredBtf` on disk."""

    @property
    def light_directions(self) -> Float64:
        """Unit vectors (light, 3)."""

    @property
    def view_directions(self) -> Float64:
        """Unit vectors (view, 3)."""

    @property
    def provenance(self) -> Provenance:
        """What it was made from."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of light, view, y, x, channel."""

    def rows(self, rows: slice) -> Float32:
        """Texel rows under every light and view, (light, view, rows, x, channel)."""

    def row_spans(self) -> Iterator[slice]:
        """Spans of rows to read one after another."""


@dataclass(frozen=True, eq=False)
class Factorisation:
    """A factored BTF and its error.

    `squared_singular_values` (view,) fall; their sum is the sum of squares of the BTF. `missing` is the share of
    samples that were filled: they count with the mean of their row over the views, so a row without any sample is 0.
    Errors are those of the filled matrix.
    """

    btf: FactoredBtf
    squared_singular_values: Float64
    missing: float

    @property
    def energy(self) -> Float64:
        """Share of the sum of squares that the first k terms hold, (view,), at index k - 1; 1 for a black BTF."""
        total = self.squared_singular_values.sum()
        if total == 0:
            return np.ones(len(self.squared_singular_values))
        return np.asarray(np.cumsum(self.squared_singular_values) / total, np.float64)

    def relative_rmse(self, rank: int) -> float:
        """Root of the squared error of the first `rank` terms over the sum of squares: the least that rank allows."""
        total = self.squared_singular_values.sum()
        return float(np.sqrt(self.squared_singular_values[rank:].sum() / total)) if total > 0 else 0.0


@dataclass(frozen=True, eq=False)
class TexelFactors:
    """BTF(y, x, L, V) = sum_k M_k(y, x) F_k(L, V), the strongest first.

    `maps` (k, y, x) and `functions` (k, light, view, channel) are float32; a function has length 1, its map carries the
    singular value, whose square is in `squared_singular_values` (k,). `total` is the sum of squares of the BTF.
    """

    maps: Float32
    functions: Float32
    squared_singular_values: Float64
    total: float

    def relative_rmse(self, rank: int) -> float:
        """Root of the squared error of the first `rank` terms over the sum of squares."""
        left = self.total - self.squared_singular_values[:rank].sum()
        return float(np.sqrt(max(left, 0.0) / self.total)) if self.total > 0 else 0.0


def factor_btf(btf: BtfRows, rank: int) -> Factorisation:
    """Keep the `rank` strongest terms; each eigenmap carries its singular value, each weight vector has length 1.

    The sign of a term is that which makes its weights sum to 0 or more. Source: Eckart and Young 1936.
    Raises ImageError for a rank that the views do not offer.
    """
    lights, views, height, width, channels = btf.shape
    if not 1 <= rank <= views:
        raise ImageError(f"rank {rank} of a BTF with {views} views: choose 1 to {views}")
    gram, missing = _gram(btf)
    values, vectors = np.linalg.eigh(gram)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1][:, :rank]
    vectors = vectors * np.where(vectors.sum(axis=0) < 0, -1.0, 1.0)
    eigenmaps = np.empty((rank, lights, height, width, channels), np.float32)
    for rows in btf.row_spans():
        filled, _ = _filled(btf.rows(rows))
        eigenmaps[:, :, rows] = np.einsum("lvyxc,vk->klyxc", filled, vectors, optimize=True)
    factored = FactoredBtf(
        eigenmaps,
        np.ascontiguousarray(vectors.T, np.float32),
        DirectionMesh.from_directions(btf.light_directions),
        DirectionMesh.from_directions(btf.view_directions),
        btf.provenance,
    )
    return Factorisation(factored, values, missing / float(np.prod(btf.shape)))


def factor_texels(btf: BtfRows, rank: int) -> TexelFactors:
    """Keep the `rank` strongest maps over texels, to 1.001 of the least error; missing samples as in `Factorisation`.

    Four passes over blocks of texel rows: block Krylov iteration from random functions of a fixed seed, ten more than
    are kept (Musco and Musco 2015). Raises ImageError for a rank that texels and directions do not offer.
    """
    lights, views, height, width, channels = btf.shape
    most = min(height * width, lights * views * channels)
    if not 1 <= rank <= most:
        raise ImageError(f"rank {rank} of a BTF with {height} x {width} texels: choose 1 to {most}")
    columns = min(rank + _SPARE, most)
    spaces = [np.random.default_rng(0).normal(size=(lights * views * channels, columns)).astype(np.float32)]
    for _ in range(_PASSES):
        stronger = sum(block.T @ (block @ spaces[-1]) for block in _texel_blocks(btf))
        spaces.append(np.linalg.qr(stronger)[0])
    weights = np.linalg.qr(np.concatenate(spaces[1:], axis=1))[0]
    maps, total = [], 0.0
    for block in _texel_blocks(btf):
        maps.append(block @ weights)
        total += float(np.square(block, dtype=np.float64).sum())
    left, values, right = np.linalg.svd(np.concatenate(maps).astype(np.float64), full_matrices=False)
    kept = (right[:rank] @ weights.T).reshape(rank, lights, views, channels)
    strong = (left[:, :rank] * values[:rank]).T.reshape(rank, height, width)
    return TexelFactors(strong.astype(np.float32), kept.astype(np.float32), values[:rank] ** 2, total)


def _texel_blocks(btf: BtfRows) -> Iterator[Float32]:
    """Blocks (texel, light * view * channel) of the filled matrix."""
    lights, views, _, _, channels = btf.shape
    for rows in btf.row_spans():
        filled, _ = _filled(btf.rows(rows))
        texels = np.moveaxis(filled, (2, 3), (0, 1)).astype(np.float32)
        yield texels.reshape(-1, lights * views * channels)


def _gram(btf: BtfRows) -> tuple[Float64, int]:
    gram, missing = np.zeros((btf.shape[1], btf.shape[1])), 0
    for rows in btf.row_spans():
        filled, count = _filled(btf.rows(rows))
        matrix = np.moveaxis(filled, 1, 0).reshape(btf.shape[1], -1)
        gram += matrix @ matrix.T
        missing += count
    return gram, missing


def _filled(block: Float32) -> tuple[Float64, int]:
    """The block in float64 with missing samples at the mean over the views of their row, and how many there were."""
    values = block.astype(np.float64)
    valid = np.isfinite(values)
    missing = values.size - int(valid.sum())
    if missing == 0:
        return values, 0
    count = np.maximum(valid.sum(axis=1, keepdims=True), 1)
    mean = np.sum(values, axis=1, keepdims=True, where=valid) / count
    return np.where(valid, values, mean), missing
