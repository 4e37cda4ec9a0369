"""The kernels of the Lafortune fit against their twins in NumPy."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.sbrdf.lafortune_kernel import BLOCK, ROWS, TILE, candidate_products, candidate_values, gram_of
from tests.reference import lafortune as reference

COUNT = 2 * BLOCK
RNG = np.random.default_rng(1)
DIRECTIONS = RNG.normal(size=(2, COUNT, 3))
DIRECTIONS[..., 2] = np.abs(DIRECTIONS[..., 2])
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=2, keepdims=True)
PRODUCTS = (DIRECTIONS[0] * DIRECTIONS[1]).T.astype(np.float32)
FACTOR = DIRECTIONS[0, :, 2].astype(np.float32)
VALUES = RNG.uniform(0, 1, (3, COUNT)).astype(np.float32)

components = st.floats(-1, 1)
lobes = st.lists(
    st.tuples(components, components, components, st.floats(0.5, 900), st.integers(0, 2)), min_size=1, max_size=3
)


def blocks():
    rows = np.concatenate([PRODUCTS, FACTOR[None], VALUES])
    return np.ascontiguousarray(rows.reshape(ROWS, -1, BLOCK).swapaxes(0, 1)).ravel()


def shaped(drawn):
    """C with the held component at +-1, and n."""
    held = np.array([one[4] for one in drawn])
    shapes = np.array([one[:4] for one in drawn])
    shapes[np.arange(len(held)), held] = np.where(shapes[np.arange(len(held)), held] < 0, -1, 1)
    return shapes, held


def close(found, true, exponent):
    """Inner products to some roundings of the columns' lengths, in which the power multiplies those of its base.

    Columns that are ten thousand times shorter than one sample are nothing.
    """
    length = np.sqrt(np.maximum(np.diag(true), 1e-8))
    return (np.abs(found - true) < 1e-6 * (30 + 2 * exponent) * np.outer(length, length)).all()


@settings(max_examples=40, deadline=None)
@given(lobes, st.integers(0, 99))
def test_the_gram_matrix_is_that_of_its_twin(drawn, seed):
    shapes, held = shaped(drawn)
    albedo = np.random.default_rng(seed).uniform(0, 1, (3, 1 + len(drawn))).astype(np.float32).astype(np.float64)
    size = TILE * (1 + len(drawn))
    gram = np.empty((size, size))
    gram_of(blocks(), shapes, held, albedo, np.empty(size * BLOCK, np.float32), gram)
    assert close(gram, reference.gram(np.float64(PRODUCTS), FACTOR, VALUES, shapes, held, albedo), shapes[:, 3].max())
    assert np.array_equal(gram, gram.T)


def test_products_with_candidates_are_those_of_their_twin():
    shapes, held = shaped([(-1, -1, 0.9, 20, 0), (0.7, 1, 0.5, 3, 1)])
    candidates, _ = shaped([(-1, -1, 0.4, 6, 0), (1, 0.8, 0.4, 2, 0), (0, 0, 1, 1.5, 2), (1, 1, 1, 60, 2)])
    albedo = RNG.uniform(0, 1, (3, 3))
    values = candidate_values(blocks(), candidates)
    products, squares = candidate_products(blocks(), values, shapes, albedo)
    basis = reference.columns(np.float64(PRODUCTS), FACTOR, shapes, held)[::TILE]
    residuals = VALUES - albedo[:, :1] * FACTOR - albedo[:, 1:] @ basis
    rows = np.concatenate([residuals, FACTOR[None], basis, np.zeros((2, COUNT))])
    others = reference.columns(np.float64(PRODUCTS), FACTOR, candidates, np.zeros(4, int))[::TILE]
    assert np.allclose(products, rows @ np.concatenate([rows, others]).T, rtol=1e-5, atol=1e-4)
    assert np.allclose(squares, (others**2).sum(axis=1), rtol=1e-5)
