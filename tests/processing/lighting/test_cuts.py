"""Cuts hold what they stand for: within the tolerance, by the highest nodes, one on every path."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from processing.lighting.cuts import Cuts, add_cut
from tests.reference import cuts as slow


def made(leaves, weights, tolerance):
    heights, values = np.empty(len(leaves), np.uint8), np.empty(len(leaves), np.float32)
    count = add_cut(np.asarray(leaves, np.float32), np.asarray(weights, np.float64), tolerance, heights, values)
    return Cuts(np.array([0, count]), heights[:count], values[:count])


leaf_values = st.integers(0, 7).flatmap(
    lambda height: arrays(np.float32, 1 << height, elements=st.floats(0, 1, width=32, allow_subnormal=False))
)


@settings(deadline=None, max_examples=150)
@given(leaf_values, st.floats(0, 1), st.integers(0, 2**32 - 1))
def test_a_cut_is_its_slow_twin(leaves, tolerance, seed):
    weights = np.random.default_rng(seed).uniform(0.5, 2, len(leaves))
    tolerance = tolerance * 1.0001 + 1e-4  # not on the edge that rounding decides
    twin = slow.cut(leaves, weights, tolerance)
    cut = made(leaves, weights, tolerance)
    assert cut.heights.tolist() == [height for height, _ in twin]
    assert np.allclose(cut.values, [value for _, value in twin], atol=1e-6)


@settings(deadline=None, max_examples=50)
@given(leaf_values, st.floats(0, 0.5))
def test_every_leaf_is_under_one_node_whose_error_is_within_the_tolerance(leaves, tolerance):
    cut = made(leaves, np.ones(len(leaves)), tolerance)
    unpacked = cut.leaves(0)
    assert len(unpacked) == len(leaves)
    starts = np.concatenate([[0], np.cumsum(1 << cut.heights.astype(np.int64))])
    assert (starts[:-1] % (1 << cut.heights.astype(np.int64)) == 0).all()
    squares = np.add.reduceat((unpacked - leaves.astype(np.float64)) ** 2, starts[:-1])
    assert (np.sqrt(squares) <= tolerance + 1e-5).all()


@given(st.floats(0, 1, width=32))
def test_a_constant_is_its_root_alone(value):
    cut = made(np.full(64, value, np.float32), np.ones(64), 0.0)
    assert cut.heights.tolist() == [6]
    assert cut.values[0] == np.float32(value)


def test_a_larger_tolerance_needs_no_more_nodes():
    leaves = np.random.default_rng(5).uniform(size=1024)
    sizes = [len(made(leaves, np.ones(1024), tolerance).heights) for tolerance in (0, 0.1, 0.3, 1, 100)]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] == 1024
    assert sizes[-1] == 1


def test_leaves_that_are_no_numbers_stay_leaves():
    leaves = np.ones(16, np.float32)
    leaves[5] = np.nan
    cut = made(leaves, np.ones(16), 10.0)
    assert np.array_equal(cut.leaves(0), leaves, equal_nan=True)
    assert cut.heights.tolist() == [2, 0, 0, 1, 3]


def test_scale_of_values_and_tolerance_is_one():
    leaves = np.random.default_rng(6).uniform(size=256).astype(np.float32)
    one, thousand = made(leaves, np.ones(256), 0.25), made(1024 * leaves, np.ones(256), 256.0)
    assert np.array_equal(one.heights, thousand.heights)
    assert np.allclose(1024 * one.values, thousand.values)


def test_the_mean_size_is_of_all_cuts():
    cuts = Cuts(np.array([0, 1, 4]), np.array([2, 1, 0, 0], np.uint8), np.zeros(4, np.float32))
    assert len(cuts) == 2
    assert cuts.mean_size == 2
    assert Cuts(np.zeros(1, np.int64), np.zeros(0, np.uint8), np.zeros(0, np.float32)).mean_size == pytest.approx(0)
