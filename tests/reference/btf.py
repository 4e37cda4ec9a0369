"""The best approximation of a BTF by a few terms, from the full singular value decomposition."""

import numpy as np


def eckart_young(reflectance, rank):
    """Relative root of the squared error that no sum of `rank` products stays under; the BTF has no NaN."""
    matrix = np.moveaxis(reflectance, 1, -1).reshape(-1, reflectance.shape[1]).astype(np.float64)
    singular = np.linalg.svd(matrix, compute_uv=False)
    return np.sqrt((singular[rank:] ** 2).sum() / (singular**2).sum())
