"""K-means of vectors in which values may be missing.

Seeds by k-means++ (Arthur and Vassilvitskii 2007), the best of a few candidates at each step, then Lloyd's rounds.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32, Float64
from processing.sbrdf.k_means_kernel import nearest, rounds, seed

SEED, CANDIDATES = 1984, 8
ROUNDS = 100
TOLERANCE = 1e-4  # of the error: a round that lowers it by less was the last

Index = NDArray[np.intp]


class KMeansStatus(IntEnum):
    """How the rounds ended."""

    CONVERGED = 0  # the error no longer falls
    STOPPED = 1  # it still fell in the last round allowed


@dataclass(frozen=True, eq=False)
class KMeans:
    """`index` (n,) of each vector into `centres` (k, d) float32; `error`, the mean squared difference of its values.

    Where no vector of a cluster has a value its centre has the mean of all vectors, 0 where none has.
    """

    index: Index
    centres: Float32
    status: KMeansStatus
    error: float


def k_means(vectors: Float32, count: int) -> KMeans:
    """`count` centres, at least one, of vectors (n, d), n >= 1; NaN and infinities are missing. Same in every run."""
    points = _Points.of(vectors)
    draws = np.random.default_rng(SEED).random((count, CANDIDATES))
    centres = points.value[seed(points.value, points.present, draws)]
    index = np.zeros(len(vectors), np.intp)
    converged, _ = rounds(points.value, points.present, centres, index, (ROUNDS, TOLERANCE))
    nearest(points.value, points.present, centres, index)
    found = (centres * points.size + points.mean).astype(np.float32)
    status = KMeansStatus.CONVERGED if converged else KMeansStatus.STOPPED
    return KMeans(index, found, status, _error(vectors, found[index]))


def nearest_centre(vectors: Float32, centres: Float32) -> Index:
    """Index (n,) of the centre (k, d) that is nearest to each vector (n, d) over the values that it has."""
    points, index = _Points.of(vectors), np.zeros(len(vectors), np.intp)
    placed = ((centres - points.mean) / points.size).astype(np.float32)
    nearest(points.value, points.present, placed, index)
    return index


@dataclass(frozen=True, eq=False)
class _Points:
    """Vectors less their mean over their largest difference from it, 0 where missing, as the loops take them."""

    value: Float32
    present: Float32
    mean: Float64
    size: float

    @classmethod
    def of(cls, vectors: Float32) -> "_Points":
        finite = np.isfinite(vectors)
        mean = np.where(finite, vectors, 0).sum(axis=0, dtype=np.float64) / np.maximum(finite.sum(axis=0), 1)
        value = np.where(finite, vectors - mean, 0)
        size = float(np.abs(value).max(initial=0.0)) or 1.0
        # What is missing in all vectors is 0 in all: no difference, so it need not be told apart.
        whole = (finite | ~finite.any(axis=0)).all()
        present = np.ones((1, vectors.shape[1]), np.float32) if whole else finite.astype(np.float32)
        return cls((value / size).astype(np.float32), present, mean, size)


def _error(vectors: Float32, centres: Float32) -> float:
    finite = np.isfinite(vectors)
    square = np.square(np.where(finite, vectors, centres) - centres, dtype=np.float64)
    return float(square.sum() / max(finite.sum(), 1))
