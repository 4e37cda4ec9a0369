"""A BTF as a short sum of products, by singular value decomposition.

`factor_btf`: the matrix has a row per (texel, light, channel) and a column per view; or, where the maps are to be grey,
a row per (texel, light) and a column per (view, channel). It is tall: its Gram matrix is gathered in float64, light by
light, and gives the view weights; the eigenmaps are the projections onto them. Two passes over data that need not fit
in memory, and the rank-k error of the full decomposition. Rows count times the light's cosine, so that errors are those
of what leaves the surface; a row's projection is the same with it and without.

`factor_texels`: the matrix has a row per texel and a column per (light, view, channel), which makes the smallest
factors. Neither side is short enough for a Gram matrix, so the strongest columns' space is found by iteration.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from processing.errors import ImageError
from processing.products import DirectionMesh, FactoredBtf, Provenance
from processing.products.arrays import Float32, Float64
from processing.products.btf import Block
from processing.threads import products_in_one_thread

_PASSES = 3  # of the iteration
_PART = 1 << 19  # samples: 4 MiB in float64
_SPARE = 10  # functions beyond those that are kept
_DARK = 0.025  # of white: half a step of the eye's lightness; errors in what is darker count no more

Colour = Literal["colour", "grey"]


class BtfRows(Protocol):
    """A BTF that is read block by block: `Btf` in memory or `StoredBtf` on disk."""

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

    def blocks(self) -> Iterator[Block]:
        """Lights, rows, and what all views see of them, (light, view, row, x, channel); each sample once.

        A block is good until the next is asked for.
        """


@dataclass(frozen=True, eq=False)
class Factorisation:
    """A factored BTF and its error, both of the BTF times the light's cosine.

    `squared_singular_values`, one for each column of the matrix, fall; their sum is the sum of squares of that product.
    `missing` is the share of samples that were filled: they count with the mean of their row over the columns, so a row
    without any sample is 0. Errors are those of the filled matrix.
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


def factor_btf(btf: BtfRows, rank: int, colour: Colour = "colour", white: float = math.inf) -> Factorisation:
    """Keep the `rank` strongest terms of the BTF times the light's cosine, which the product's maps are without.

    Each weight vector has length 1. A light under the horizon has no say in which terms these are.
    Grey maps serve all channels, whose weights differ: a third of the bytes and of the look-ups for as many terms. The
    sign of a term is that which makes its weights sum to 0 or more. Source: Eckart and Young 1936.
    Where `white` is told, 1/sr, terms are those of pictures exposed so: what is brighter with the light's cosine counts
    as that, and errors count over what a texel shows in the mean over the views plus a fortieth of white, for the eye
    sees ratios. Singular values are then of what is so weighed.
    Raises ImageError for a rank that the views do not offer.
    """
    lights, views, height, width, channels = btf.shape
    shared = channels if colour == "grey" else 1
    if not 1 <= rank <= views * shared:
        raise ImageError(f"rank {rank} of a BTF with {views} views: choose 1 to {views * shared} for {colour} maps")
    eigenmaps = np.empty((rank, lights, height, width, channels // shared), np.float32)
    with products_in_one_thread():
        gram, missing = _gram(btf, shared, white)
        values, vectors = np.linalg.eigh(gram)
        values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1][:, :rank]
        vectors = vectors * np.where(vectors.sum(axis=0) < 0, -1.0, 1.0)
        weights = np.ascontiguousarray(vectors.T, np.float32)
        for light, rows, matrix in _matrices(btf, shared, white):
            whole = _filled(matrix)[0] if missing else matrix
            eigenmaps[:, light, rows] = (weights @ whole).reshape(rank, -1, width, channels // shared)
    factored = FactoredBtf(
        eigenmaps,
        weights.reshape(rank, views, channels) if shared > 1 else weights,
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
        block = np.moveaxis(btf.rows(rows), 1, 0)
        filled, _ = _filled(block.reshape(views, -1))
        texels = np.moveaxis(filled.reshape(block.shape), (2, 3), (0, 1))
        yield np.moveaxis(texels, 2, 3).reshape(-1, lights * views * channels)


def _matrices(btf: BtfRows, shared: int, white: float) -> Iterator[tuple[int, slice, Float32]]:
    """Light, rows, and the transposed matrix's part (view * shared, sample); parts stay in the processor's cache."""
    views = btf.shape[1]
    height = max(_PART // math.prod(btf.shape[i] for i in (1, 3, 4)), 1)
    brightest = (white / np.maximum(btf.light_directions[:, 2], 1e-6)).astype(np.float32)
    for lights, rows, block in btf.blocks():
        for light, seen in enumerate(block, start=lights.start):
            for start in range(0, rows.stop - rows.start, height):
                part = seen[:, start : start + height]
                span = slice(rows.start + start, rows.start + start + part.shape[1])
                if shared > 1:
                    part = np.moveaxis(part, 3, 1)
                matrix = part.reshape(views * shared, -1)
                yield light, span, matrix if math.isinf(white) else np.minimum(matrix, brightest[light])


def _gram(btf: BtfRows, shared: int, white: float) -> tuple[Float64, int]:
    columns = btf.shape[1] * shared
    gram, missing = np.zeros((columns, columns)), 0
    cosines = np.maximum(btf.light_directions[:, 2], 0.0)
    texel = 1 if shared > 1 else btf.shape[4]
    for light, _, matrix in _matrices(btf, shared, white):
        products = _products(matrix, texel, cosines[light], white)
        if not np.isfinite(products.trace()):
            filled, count = _filled(matrix)
            products = _products(filled, texel, cosines[light], white)
            missing += count
        gram += products
    return gram, missing


def _products(matrix: Float32, texel: int, cosine: float, white: float) -> Float64:
    """Sums of products of the matrix's rows times the light's cosine; `texel` columns in turn are of one texel."""
    exact = matrix.astype(np.float64)
    if math.isinf(white):
        return np.asarray(cosine**2 * (exact @ exact.T))
    shown = np.maximum(exact.mean(axis=0).reshape(-1, texel).mean(axis=1), 0.0)
    exact *= np.repeat(cosine / np.maximum(cosine * shown + _DARK * white, np.finfo(np.float64).tiny), texel)
    return np.asarray(exact @ exact.T)


def _filled(matrix: Float32) -> tuple[Float32, int]:
    """The matrix with missing samples at the mean over its first axis, and how many there were."""
    valid = np.isfinite(matrix)
    if valid.all():
        return matrix, 0
    count = np.maximum(valid.sum(axis=0), 1)
    mean = np.sum(matrix, axis=0, where=valid, dtype=np.float64) / count
    return np.where(valid, matrix, mean).astype(np.float32), matrix.size - int(valid.sum())
