"""The loops over texels, channels and directions under `residual`: threads take a chunk of texels at a time."""

import numba
import numpy as np
from numpy.typing import NDArray

from processing.materials.sample_geometry import at
from processing.products.arrays import Float32, Float64

_SWEEPS = 30  # cyclic Jacobi needs 5 or 6 of nine rows
_CHUNK = 64  # texels; sums are kept by chunk and added in their order, so that the number of threads changes nothing


@numba.njit(cache=True, parallel=True)
def arrange(
    value: Float64, variance: Float64, cos_light: Float64, noise: float, misfit: Float64
) -> tuple[Float64, Float64]:
    """Values and weights (texel, 3, direction), both 0 where the sample is not valid."""
    directions, texels, channels = value.shape
    values, weights = np.zeros((texels, channels, directions)), np.zeros((texels, channels, directions))
    for t in numba.prange(texels):
        for d in range(directions):
            if not cos_light[at(t, len(cos_light)), d] > 0:
                continue
            for c in range(channels):
                own = np.float64(variance[d, t, c])
                if np.isfinite(value[d, t, c]) and own > 0 and own < np.inf:
                    values[t, c, d] = value[d, t, c]
                    weights[t, c, d] = 1 / (noise * own + misfit[c])
    return values, weights


@numba.njit(cache=True, parallel=True)
def invert(basis: Float64, weights: Float64, tolerance: float) -> tuple[Float64, NDArray[np.uint8], Float32]:
    """`tolerance` is on eigenvalues: the square of the one on singular values."""
    texels, channels, _ = weights.shape
    size = basis.shape[1]
    inverse = np.zeros((texels, channels, size, size))
    rank, condition = np.zeros((texels, channels), np.uint8), np.full((texels, channels), np.float32(np.inf))
    for chunk in numba.prange((texels + _CHUNK - 1) // _CHUNK):
        gram, vectors = np.empty((size, size)), np.empty((size, size))
        for t in range(chunk * _CHUNK, min((chunk + 1) * _CHUNK, texels)):
            for c in range(channels):
                if c > 0 and _same(weights[t, c], weights[t, c - 1]):
                    inverse[t, c], rank[t, c], condition[t, c] = inverse[t, c - 1], rank[t, c - 1], condition[t, c - 1]
                    continue
                _gram(basis[at(t, len(basis))], weights[t, c], gram)
                rank[t, c], condition[t, c] = _pseudo_inverse(gram, vectors, tolerance, inverse[t, c])
    return inverse, rank, condition


@numba.njit(cache=True)
def _same(one: Float64, other: Float64) -> bool:
    for d in range(len(one)):
        if one[d] != other[d]:
            return False
    return True


@numba.njit(cache=True, fastmath={"reassoc", "contract"})
def _gram(basis: Float64, weights: Float64, gram: Float64) -> None:
    size, directions = basis.shape
    for i in range(size):
        for j in range(i + 1):
            total = 0.0
            for d in range(directions):
                total += weights[d] * basis[i, d] * basis[j, d]
            gram[i, j] = gram[j, i] = total


@numba.njit(cache=True)
def _pseudo_inverse(gram: Float64, vectors: Float64, tolerance: float, inverse: Float64) -> tuple[int, float]:
    """Fill the inverse, which comes as zeros; the gram matrix is used up. Rank and condition, 0 and inf for none."""
    size, trace = len(gram), 0.0
    for i in range(size):
        trace += gram[i, i]
    if not trace > 0:
        return 0, np.inf
    gram /= trace
    _diagonalise(gram, vectors)
    largest = 0.0
    for i in range(size):
        largest = max(largest, gram[i, i])
    rank, smallest = 0, largest
    for k in range(size):
        if gram[k, k] > tolerance * largest:
            rank += 1
            smallest = min(smallest, gram[k, k])
            for i in range(size):
                for j in range(size):
                    inverse[i, j] += vectors[i, k] * vectors[j, k] / (gram[k, k] * trace)
    return rank, np.sqrt(largest / smallest)


@numba.njit(cache=True)
def _diagonalise(a: Float64, v: Float64) -> None:
    """Turn the symmetric a of trace 1 into its eigenvalues and v into their vectors as columns, by Jacobi rotations."""
    size = len(a)
    v[:] = 0.0
    for i in range(size):
        v[i, i] = 1.0
    for _ in range(_SWEEPS):
        off = 0.0
        for p in range(size):
            for q in range(p + 1, size):
                off += a[p, q] * a[p, q]
        if off <= 1e-26:  # eigenvalues are then good to 1e-13 of the trace, and better
            return
        for p in range(size):
            for q in range(p + 1, size):
                if a[p, q] * a[p, q] > 1e-28:
                    _rotate(a, v, p, q)


@numba.njit(cache=True)
def _rotate(a: Float64, v: Float64, p: int, q: int) -> None:
    ratio = (a[q, q] - a[p, p]) / (2 * a[p, q])
    tangent = 1 / (abs(ratio) + np.sqrt(ratio * ratio + 1))
    if ratio < 0:
        tangent = -tangent
    cosine = 1 / np.sqrt(tangent * tangent + 1)
    sine = tangent * cosine
    for k in range(len(a)):
        a[k, p], a[k, q] = cosine * a[k, p] - sine * a[k, q], sine * a[k, p] + cosine * a[k, q]
    for k in range(len(a)):
        a[p, k], a[q, k] = cosine * a[p, k] - sine * a[q, k], sine * a[p, k] + cosine * a[q, k]
        v[k, p], v[k, q] = cosine * v[k, p] - sine * v[k, q], sine * v[k, p] + cosine * v[k, q]


@numba.njit(cache=True, parallel=True, fastmath={"reassoc", "contract"})
def inner_products(
    basis: Float64, columns: Float64, value: Float64, weights: Float64, inverse: Float64
) -> tuple[Float64, Float64]:
    """Inner products (chunk, 3, c + 1, c + 1), those of the columns as they are and less their residuals."""
    texels, channels, directions = value.shape
    size, count = basis.shape[1], columns.shape[1]
    chunks = (texels + _CHUNK - 1) // _CHUNK
    raw = np.zeros((chunks, channels, count + 1, count + 1))
    projected = np.zeros((chunks, channels, count + 1, count + 1))
    for chunk in numba.prange(chunks):
        column, moment = np.empty((count + 2, directions)), np.empty((count + 1, size))
        for t in range(chunk * _CHUNK, min((chunk + 1) * _CHUNK, texels)):
            own, functions = columns[at(t, len(columns))], basis[at(t, len(basis))]
            for c in range(channels):
                for j in range(count):
                    for d in range(directions):
                        column[j, d] = own[j, d]
                column[count] = value[t, c]
                _accumulate(functions, column, weights[t, c], moment, raw[chunk, c])
                _subtract(moment, inverse[t, c], projected[chunk, c])
    return raw, raw + projected


@numba.njit(cache=True, fastmath={"reassoc", "contract"})
def _accumulate(basis: Float64, column: Float64, weights: Float64, moment: Float64, raw: Float64) -> None:
    """Add the products of the columns, the last of which is for use here; set the moments with the basis functions."""
    directions, weighted = column.shape[1], column[-1]
    for i in range(len(moment)):
        for d in range(directions):
            weighted[d] = weights[d] * column[i, d]
        for j in range(i + 1):
            total = 0.0
            for d in range(directions):
                total += weighted[d] * column[j, d]
            raw[i, j] += total
            if j < i:
                raw[j, i] += total
        for k in range(len(basis)):
            total = 0.0
            for d in range(directions):
                total += weighted[d] * basis[k, d]
            moment[i, k] = total


@numba.njit(cache=True, fastmath={"reassoc", "contract"})
def _subtract(moment: Float64, inverse: Float64, out: Float64) -> None:
    """Take moment inverse moment^T from out."""
    count, size = moment.shape
    for i in range(count):
        for k in range(size):
            along = 0.0
            for m in range(size):
                along += moment[i, m] * inverse[m, k]
            for j in range(count):
                out[i, j] -= along * moment[j, k]


@numba.njit(cache=True, parallel=True)
def fit(
    basis: Float64, lobe: Float64, k: Float64, value: Float64, weights: Float64, inverse: Float64
) -> tuple[Float32, NDArray[np.int64], Float64]:
    """Coefficients (texel, 3, k), NaN without samples; their number; by chunk [before, after, spread, peak] (3,)."""
    texels, channels, directions = value.shape
    size, chunks = basis.shape[1], (texels + _CHUNK - 1) // _CHUNK
    found, samples = np.full((texels, channels, size), np.float32(np.nan)), np.zeros((texels, channels), np.int64)
    sums = np.zeros((chunks, 4, channels))
    for chunk in numba.prange(chunks):
        delta, moment = np.empty(directions), np.empty(size)
        for t in range(chunk * _CHUNK, min((chunk + 1) * _CHUNK, texels)):
            functions = basis[at(t, len(basis))]
            for c in range(channels):
                y, w = value[t, c], weights[t, c]
                samples[t, c] = _moments(functions, lobe[at(t, len(lobe))], k[:, c], (y, w), delta, moment)
                if samples[t, c] > 0:
                    for i in range(size):
                        found[t, c, i] = (inverse[t, c, i] * moment).sum()
                    _add_squares(functions, found[t, c], y, w, delta, sums[chunk, :, c])
    return found, samples, sums


@numba.njit(cache=True)
def _moments(
    basis: Float64, lobe: Float64, k: Float64, samples: tuple[Float64, Float64], delta: Float64, moment: Float64
) -> int:
    """Set delta, the values less the lobe, and its weighted moments with the basis; the number of samples."""
    (value, weights), count = samples, 0
    moment[:] = 0.0
    for d in range(len(value)):
        if weights[d] > 0:
            count += 1
            delta[d] = value[d] - k[0] * lobe[0, d] - k[1] * lobe[1, d]
            for i in range(len(basis)):
                moment[i] += weights[d] * delta[d] * basis[i, d]
    return count


@numba.njit(cache=True)
def _add_squares(
    basis: Float64, found: Float64, value: Float64, weights: Float64, delta: Float64, sums: Float64
) -> None:
    """Add squares before and after the residual and about the mean, and keep the largest value."""
    count, mean = 0, 0.0
    for d in range(len(value)):
        if weights[d] > 0:
            count += 1
            mean += value[d]
    mean /= count
    for d in range(len(value)):
        if weights[d] > 0:
            left = delta[d]
            for i in range(len(basis)):
                left -= found[i] * basis[i, d]
            sums[0] += delta[d] * delta[d]
            sums[1] += left * left
            sums[2] += (value[d] - mean) ** 2
            sums[3] = max(sums[3], value[d])
