"""Spheres that together hold a body: rays that meet none of them need not be traced."""

import numpy as np

from processing.lighting.triangle_body import TriangleBody
from processing.products.arrays import Float64

_SPHERES = 16  # of 64 as many rays fewer are traced as it takes longer to tell which


def covering_spheres(body: TriangleBody) -> Float64:
    """Centres and radii (n, 4): first the sphere around the whole body, then small ones around its triangles.

    Triangles are halved along the longest side of their box until there are 16 groups.
    """
    groups = [body.vertices[body.triangles]]
    while len(groups) < min(_SPHERES, len(body.triangles)):
        widest = max(range(len(groups)), key=lambda k: _radius(groups[k]) if len(groups[k]) > 1 else -1.0)
        groups += _halves(groups.pop(widest))
    whole = np.array([*body.centre, body.radius])
    return np.stack([whole, *(np.array([*_middle(group), _radius(group)]) for group in groups)])


def _halves(corners: Float64) -> list[Float64]:
    """Triangles (n, 3, 3) on either side of the median of their middles."""
    middles = corners.mean(axis=1)
    order = np.argsort(middles[:, np.ptp(middles, axis=0).argmax()], kind="stable")
    return [corners[order[: len(order) // 2]], corners[order[len(order) // 2 :]]]


def _middle(corners: Float64) -> Float64:
    return np.asarray((corners.min(axis=(0, 1)) + corners.max(axis=(0, 1))) / 2)


def _radius(corners: Float64) -> float:
    return float(np.linalg.norm(corners - _middle(corners), axis=-1).max())
