"""K-means of vectors in which values may be missing, by matrix products.

Seeds by k-means++ (Arthur and Vassilvitskii 2007), the best of a few candidates at each step, then Lloyd's rounds.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from processing.products.arrays import Float32, Float64

_SEED = 1984
_ROUNDS = 60
_TOLERANCE = 1e-4  # of the error: a round that lowers it by less was the last
_BLOCK = 1 << 24  # distances at a time: 64 MiB

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
    centres = _seeds(points, count)
    index, nearest, status = _nearest(points, centres)[0], np.inf, KMeansStatus.STOPPED
    for _ in range(_ROUNDS):
        index, distance = _nearest(points, centres)
        error = float(distance.sum(dtype=np.float64))
        if error >= nearest * (1 - _TOLERANCE):
            status = KMeansStatus.CONVERGED
            break
        nearest = error
        centres = points.means(index, distance, centres)
    return points.result(index, centres, status)


def nearest_centre(vectors: Float32, centres: Float32) -> Index:
    """Index (n,) of the centre (k, d) that is nearest to each vector (n, d) over the values that it has."""
    points = _Points.of(vectors)
    return _nearest(points, points.placed(centres))[0]


@dataclass(frozen=True, eq=False)
class _Points:
    """Vectors less their mean over their largest difference from it, 0 where missing; `present` None: nothing is."""

    value: Float32
    present: Float32 | None
    square: Float32
    mean: Float64
    size: float

    @classmethod
    def of(cls, vectors: Float32) -> "_Points":
        finite = np.isfinite(vectors)
        mean = np.where(finite, vectors, 0).sum(axis=0, dtype=np.float64) / np.maximum(finite.sum(axis=0), 1)
        value = np.where(finite, vectors - mean, 0)
        size = float(np.abs(value).max(initial=0.0)) or 1.0
        value = (value / size).astype(np.float32)
        present = None if (finite | ~finite.any(axis=0)).all() else finite.astype(np.float32)
        return cls(value, present, np.einsum("nd,nd->n", value, value), mean, size)

    def distances(self, rows: slice, centres: Float32) -> Float32:
        """Squared distances (row, centre) over the values that each vector has."""
        square = centres * centres
        own = square.sum(axis=1) if self.present is None else self.present[rows] @ square.T
        found: Float32 = self.square[rows, None] - 2 * (self.value[rows] @ centres.T) + own
        return np.maximum(found, 0, out=found)

    def means(self, index: Index, distance: Float32, centres: Float32) -> Float32:
        """Of each cluster; one without vectors goes to the vector farthest from its own centre."""
        one = np.ones(len(index), np.float32)
        members = csr_array((one, (index, np.arange(len(index)))), (len(centres), len(index)))
        counts = members.sum(axis=1)[:, None] if self.present is None else members @ self.present
        means: Float32 = np.asarray(members @ self.value / np.maximum(counts, 1), np.float32)
        empty = np.flatnonzero(np.bincount(index, minlength=len(centres)) == 0)
        means[empty] = self.value[np.argsort(-distance, kind="stable")[: len(empty)]]
        return means

    def placed(self, centres: Float32) -> Float32:
        """Centres (k, d) in these vectors' own units."""
        return ((centres - self.mean) / self.size).astype(np.float32)

    def result(self, index: Index, centres: Float32, status: KMeansStatus) -> KMeans:
        """In the vectors' units; the error is that of float32 centres, summed in double precision."""
        square = np.square(self.value - centres[index], dtype=np.float64)
        values = self.value.size if self.present is None else self.present.sum()
        if self.present is not None:
            square *= self.present
        error = square.sum() / max(values, 1) * self.size**2
        return KMeans(index, (centres * self.size + self.mean).astype(np.float32), status, float(error))


def _nearest(points: _Points, centres: Float32) -> tuple[Index, Float32]:
    """Index of the nearest centre and its squared distance, for every vector."""
    count = len(points.value)
    index, distance = np.empty(count, np.intp), np.empty(count, np.float32)
    for start in range(0, count, step := max(_BLOCK // len(centres), 1)):
        rows = slice(start, start + step)
        found = points.distances(rows, centres)
        index[rows] = found.argmin(axis=1)
        distance[rows] = found.min(axis=1)
    return index, distance


def _seeds(points: _Points, count: int) -> Float32:
    """Vectors drawn by their squared distance from those before: of several the one that leaves the least sum."""
    rng = np.random.default_rng(_SEED)
    every, last = slice(None), len(points.value) - 1
    chosen = [int(rng.integers(last + 1))]
    distance = points.distances(every, points.value[chosen])[:, 0]
    for _ in range(count - 1):
        total = np.cumsum(distance, dtype=np.float64)
        drawn = np.minimum(np.searchsorted(total, rng.random(2 + count.bit_length()) * total[-1]), last)
        trial = np.minimum(points.distances(every, points.value[drawn]), distance[:, None])
        best = int(trial.sum(axis=0, dtype=np.float64).argmin())
        chosen.append(int(drawn[best]))
        distance = trial[:, best]
    return points.value[chosen]
