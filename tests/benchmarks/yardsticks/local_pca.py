"""Clusters of points, each with a mean and a basis of its own (Kambhatla and Leen 1997), for texels of BTFs.

Müller, Meseth and Klein 2003 cluster the texels' reflectance functions like that.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class LocalPca:
    """Points (n, p) as mean[label] + weight @ basis[label]: `label` (n,), `mean` (c, p), `basis` (c, k, p)."""

    label: Array
    mean: Array
    basis: Array

    def weights(self, points: Array) -> Array:
        """Coefficients (n, k) of points (n, p)."""
        away = points - self.mean[self.label]
        return np.asarray(np.einsum("np,nkp->nk", away, self.basis[self.label]))


def local_pca(points: Array, clusters: int, terms: int, rounds: int = 12) -> LocalPca:
    """Points (n, p) go in turns to the cluster that leaves them least error, and clusters get their best bases.

    Starts from means that lie far apart, the first point's among them; a cluster that loses all its points takes the
    point that is worst off.
    """
    label = _nearest(points, _far_apart(points, clusters))
    for _ in range(rounds):
        mean, basis = _bases(points, label, clusters, terms)
        errors = np.stack([_errors(points, mean[c], basis[c]) for c in range(clusters)])
        label = errors.argmin(axis=0)
        for empty in np.setdiff1d(np.arange(clusters), label):
            label[errors.min(axis=0).argmax()] = empty
    mean, basis = _bases(points, label, clusters, terms)
    return LocalPca(label, mean, basis)


def _bases(points: Array, label: Array, clusters: int, terms: int) -> tuple[Array, Array]:
    """Means (c, p) and the strongest directions (c, k, p) about them."""
    mean, basis = np.zeros((clusters, points.shape[1])), np.zeros((clusters, terms, points.shape[1]))
    for c in range(clusters):
        own = points[label == c]
        if len(own):
            mean[c] = own.mean(axis=0)
            basis[c] = np.linalg.eigh((own - mean[c]).T @ (own - mean[c]))[1][:, ::-1][:, :terms].T
    return mean, basis


def _errors(points: Array, mean: Array, basis: Array) -> Array:
    away = points - mean
    return np.asarray((away**2).sum(axis=1) - ((away @ basis.T) ** 2).sum(axis=1))


def _far_apart(points: Array, count: int) -> Array:
    """Points (count, p), each the farthest from those before it."""
    chosen = [points[0]]
    nearest = np.full(len(points), np.inf)
    for _ in range(count - 1):
        nearest = np.minimum(nearest, ((points - chosen[-1]) ** 2).sum(axis=1))
        chosen.append(points[nearest.argmax()])
    return np.stack(chosen)


def _nearest(points: Array, centres: Array) -> Array:
    return np.asarray(np.argmin([((points - centre) ** 2).sum(axis=1) for centre in centres], axis=0))
