"""Batched minimum-norm least squares in three unknowns: s . H = delta per texel and channel."""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float64

# A light at arm's length leaves the plane of the half vectors by about 1 % over a sphere; that is no third
# measurement, and its solution would carry 30 times the noise of the others.
RANK_TOLERANCE = 0.03
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_SWEEPS = 12


@dataclass(frozen=True, eq=False)
class ResidualFit:
    """`vectors` s (..., 3) in the frame of H, with `rank` uint8 and `condition` number of the same leading axes.

    The condition number is the largest singular value over the smallest that was kept. Where there is no valid
    sample, s is NaN and the rank 0.
    """

    vectors: Float64
    rank: NDArray[np.uint8]
    condition: Float64


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Sums over the directions: `gram` (..., 6) of w H H^T as xx yy zz xy xz yz, and `right` (..., 3) of w delta H."""

    gram: Float64
    right: Float64

    def solve(self, rank_tolerance: float = RANK_TOLERANCE) -> ResidualFit:
        """The shortest s of least weighted error; singular values under the tolerance times the largest are zero."""
        shape = self.right.shape[:-1]
        gram = np.broadcast_to(self.gram, (*shape, 6)).reshape(-1, 6)
        vectors, rank, condition = _solve(gram, np.ascontiguousarray(self.right).reshape(-1, 3), rank_tolerance**2)
        return ResidualFit(vectors.reshape(*shape, 3), rank.reshape(shape), condition.reshape(shape))


def fit_residual(
    delta: Float64, half: Float64, weights: Float64, rank_tolerance: float = RANK_TOLERANCE
) -> ResidualFit:
    """Fit s . H = delta over the directions (first axis), per texel and channel.

    `delta` and `weights` are (direction, texel, channel), `half` (direction, texel, 3) or (direction, 3); weight 0
    leaves a sample out, whatever its delta. Source: Ma et al. 2004, 4.3.
    """
    right = np.zeros((*delta.shape[1:], 3))
    for one_delta, one_half, weight in zip(delta, half, weights, strict=True):
        moment = weight * np.where(weight > 0, one_delta, 0.0)
        right += moment[..., None] * np.atleast_2d(one_half)[:, None, :]
    return NormalEquations(gram_matrices(half, weights), right).solve(rank_tolerance)


def gram_matrices(half: Float64, weights: Float64) -> Float64:
    """Sums of w H H^T over the directions, (texel, channel, 6); arguments as in `fit_residual`."""
    gram = np.zeros((*weights.shape[1:], 6))
    for one_half, weight in zip(half, weights, strict=True):
        gram += weight[..., None] * outer_products(np.atleast_2d(one_half))[:, None, :]
    return gram


def left_over(delta: Float64, half: Float64, fit: ResidualFit) -> Float64:
    """delta - s . H, (direction, texel, channel); `half` as in `fit_residual`."""
    pattern = "dk,tck->dtc" if half.ndim == 2 else "dtk,tck->dtc"
    return np.asarray(delta - np.einsum(pattern, half, fit.vectors, optimize=True), np.float64)


def outer_products(half: Float64) -> Float64:
    """H H^T of vectors (n, 3) in the order of `NormalEquations.gram`, (n, 6)."""
    return np.stack([half[:, i] * half[:, j] for i, j in _PAIRS], axis=1)


@numba.njit(cache=True)
def _diagonalise(a: Float64, v: Float64) -> None:
    """Turn the symmetric a into its eigenvalues and v into their vectors as columns, by cyclic Jacobi rotations."""
    v[:] = np.eye(3)
    for _ in range(_SWEEPS):
        off = abs(a[0, 1]) + abs(a[0, 2]) + abs(a[1, 2])
        if off <= 1e-15 * (abs(a[0, 0]) + abs(a[1, 1]) + abs(a[2, 2])):
            return
        for p, q in ((0, 1), (0, 2), (1, 2)):
            if a[p, q] == 0.0:
                continue
            ratio = (a[q, q] - a[p, p]) / (2 * a[p, q])
            tangent = 1 / (abs(ratio) + np.sqrt(ratio * ratio + 1))
            if ratio < 0:
                tangent = -tangent
            cosine = 1 / np.sqrt(tangent * tangent + 1)
            sine = tangent * cosine
            for k in range(3):
                a[k, p], a[k, q] = cosine * a[k, p] - sine * a[k, q], sine * a[k, p] + cosine * a[k, q]
            for k in range(3):
                a[p, k], a[q, k] = cosine * a[p, k] - sine * a[q, k], sine * a[p, k] + cosine * a[q, k]
                v[k, p], v[k, q] = cosine * v[k, p] - sine * v[k, q], sine * v[k, p] + cosine * v[k, q]


@numba.njit(cache=True)
def _solve(gram: Float64, right: Float64, tolerance: float) -> tuple[Float64, NDArray[np.uint8], Float64]:
    """`tolerance` is on eigenvalues: the square of the one on singular values."""
    count = len(gram)
    vectors, condition = np.zeros((count, 3)), np.full(count, np.inf)
    rank = np.zeros(count, np.uint8)
    a, v = np.empty((3, 3)), np.empty((3, 3))
    for i in range(count):
        trace = gram[i, 0] + gram[i, 1] + gram[i, 2]
        if not trace > 0:
            vectors[i] = np.nan
            continue
        a[0, 0], a[1, 1], a[2, 2] = gram[i, 0] / trace, gram[i, 1] / trace, gram[i, 2] / trace
        a[0, 1] = a[1, 0] = gram[i, 3] / trace
        a[0, 2] = a[2, 0] = gram[i, 4] / trace
        a[1, 2] = a[2, 1] = gram[i, 5] / trace
        _diagonalise(a, v)
        largest = max(a[0, 0], a[1, 1], a[2, 2])
        smallest = largest
        for k in range(3):
            if a[k, k] > tolerance * largest:
                along = (v[0, k] * right[i, 0] + v[1, k] * right[i, 1] + v[2, k] * right[i, 2]) / (a[k, k] * trace)
                for axis in range(3):
                    vectors[i, axis] += along * v[axis, k]
                rank[i] += 1
                smallest = min(smallest, a[k, k])
        condition[i] = np.sqrt(largest / smallest)
    return vectors, rank, condition
