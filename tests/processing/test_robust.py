"""Statistics that a minority of wrong values does not move."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.robust import biweight, bulk_deviation, principal_axes, weighted_median_place

quick = settings(max_examples=40, deadline=None)
seeds = st.integers(0, 2**32 - 1)


def test_deviation_of_a_normal_sample_with_a_fifth_of_nonsense():
    """Median and deviation of 20 000 are good to 1.2 %; a fifth of far values raises the quantile from 0.5 to 0.625."""
    errors = 3.0 * np.random.default_rng(0).normal(size=20000)
    assert abs(bulk_deviation(errors) / 3.0 - 1) < 0.05
    errors[:4000] = 1e9
    assert 3.0 < bulk_deviation(errors) < 1.4 * 3.0  # 0.887 / 0.674 = 1.31


@quick
@given(seeds, st.floats(1e-9, 1e9))
def test_weights_fall_with_the_error_whatever_its_unit(seed, unit):
    errors = np.sort(np.random.default_rng(seed).uniform(0, 10, 50))
    weights = biweight(errors, 1.0)
    assert (np.diff(weights) <= 0).all()
    assert (weights[errors >= 4.685] == 0).all()
    assert biweight(np.zeros(1), 1e-300)[0] == 1
    np.testing.assert_allclose(biweight(-unit * errors, unit), weights, atol=1e-12)


@quick
@given(seeds, st.integers(1, 9))
def test_half_of_the_weight_lies_on_either_side_of_the_median(seed, count):
    rng = np.random.default_rng(seed)
    values = rng.integers(-3, 4, (count, 4, 5)).astype(float)
    weights = rng.integers(0, 3, values.shape).astype(float)  # whole numbers: ties are exact
    place = weighted_median_place(values, weights)
    median, total = np.take_along_axis(values, place, axis=0), weights.sum(axis=0)
    known = total > 0
    assert (np.where(values <= median, weights, 0).sum(axis=0) >= total / 2)[known].all()
    assert (np.where(values < median, weights, 0).sum(axis=0) < total / 2)[known].all()
    assert (np.take_along_axis(weights, place, axis=0)[0] > 0)[known].all()
    order = rng.permutation(count)
    turned = weighted_median_place(values[order], weights[order])
    np.testing.assert_array_equal(np.take_along_axis(values[order], turned, axis=0)[:, known], median[:, known])
    beside = weighted_median_place(np.moveaxis(values, 0, 1), np.moveaxis(weights, 0, 1), axis=1)
    np.testing.assert_array_equal(np.moveaxis(beside, 1, 0), place)


@quick
@given(seeds, st.integers(2, 3))
def test_axes_are_those_of_the_scatter_and_points_without_weight_do_not_count(seed, dimensions):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(20, dimensions)) * 10.0 ** np.arange(dimensions) + rng.normal(size=dimensions)
    weights = rng.uniform(0.1, 1, 20)
    centre, scatter, axes = principal_axes(points, weights)
    np.testing.assert_allclose(axes.T @ axes, np.eye(dimensions), atol=1e-12)
    along = (points - centre) @ axes
    np.testing.assert_allclose(weights @ along, 0, atol=1e-9 * np.abs(along).max())
    np.testing.assert_allclose((weights[:, None] * along).T @ along, np.diag(scatter), atol=1e-9 * scatter.max())
    assert (np.diff(scatter) >= 0).all()
    more, none = np.concatenate([points, 1e3 * points]), np.concatenate([weights, 0 * weights])
    np.testing.assert_allclose(principal_axes(more, none)[1], scatter, rtol=1e-9)
