"""Conjugate gradients for several right-hand sides at once."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse


def conjugate_gradients(
    matrix: sparse.csr_matrix, right: NDArray[Any], *, tolerance: float, most_steps: int
) -> NDArray[Any]:
    """x (n, c) of matrix x = right for a Hermitian positive definite matrix (n, n), preconditioned by its diagonal.

    Ends when every column's residual is below `tolerance` times its right side, or after `most_steps`. All columns go
    through the matrix together, which is what the time goes into.
    """
    inverse = 1.0 / matrix.diagonal().real[:, None]
    x = np.zeros_like(right)
    residual = right.copy()
    direction = inverse * residual
    product = _products(residual, direction)
    goal = tolerance**2 * _products(right, right)
    for _ in range(most_steps):
        if (_products(residual, residual) <= goal).all():
            break
        image = matrix @ direction
        length = product / np.maximum(_products(direction, image), 1e-300)
        x += length * direction
        residual -= length * image
        scaled = inverse * residual
        last, product = product, _products(residual, scaled)
        direction = scaled + product / np.maximum(last, 1e-300) * direction
    return x


def _products(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    """Scalar products of the columns."""
    return np.asarray(np.sum(np.conj(a) * b, axis=0).real)
