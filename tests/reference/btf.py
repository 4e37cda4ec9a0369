"""The best approximation of a BTF, times the lights' cosine, from the full singular value decomposition."""

import numpy as np


def lit(btf, reflectance=None):
    """A BTF's reflectance, or another of its shape, times the lights' cosine in float64."""
    cosines = np.maximum(btf.light_directions[:, 2], 0.0)[:, None, None, None, None]
    return cosines * (btf.reflectance if reflectance is None else reflectance)


def eckart_young(btf, rank):
    """Relative root of the squared error that no sum of `rank` products stays under; the BTF has no NaN."""
    matrix = np.moveaxis(lit(btf), 1, -1).reshape(-1, btf.shape[1])
    singular = np.linalg.svd(matrix, compute_uv=False)
    return np.sqrt((singular[rank:] ** 2).sum() / (singular**2).sum())
