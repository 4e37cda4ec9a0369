"""Array types of this package and the few vector operations that NumPy lacks."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
Float32 = NDArray[np.float32]
Int32 = NDArray[np.int32]
Bool = NDArray[np.bool_]
Rows = NDArray[Any]


def unit(vectors: Rows) -> Float64:
    """Vectors (..., 3) divided by their length; a zero vector stays zero."""
    vectors = np.asarray(vectors, dtype=np.float64)
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0.0, length, 1.0)


def dot(a: Rows, b: Rows) -> Float64:
    """Scalar product over the last axis, which stays with length 1."""
    return np.asarray(np.sum(np.asarray(a, dtype=np.float64) * b, axis=-1, keepdims=True))
