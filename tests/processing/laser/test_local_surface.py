"""Surfaces from noisy samples: the textbook's formulas, and what a resampling must be true to."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.laser import local_surface
from processing.laser.local_surface import Samples, predict_surface
from tests.reference.local_surface import predict

MODELS = {
    "roughness": local_surface._ROUGHNESS,
    "length": local_surface._LENGTH,
    "slope": local_surface._SLOPE,
    "offset": local_surface._OFFSET,
    "gap": local_surface._GAP,
    "edge": local_surface._EDGE,
    "rounds": local_surface._SHARE_ROUNDS,
}


def around(rng, places, surface, sigma):
    """Samples on a grid, moved at random under each place, of surface(x, y) (sample spacings) with noise."""
    grid = np.stack(np.meshgrid(*[np.arange(-2.0, 3.0)] * 2), axis=-1).reshape(-1, 2)
    corners = (np.abs(grid) == 2).all(axis=1)
    offset = grid[~corners] + rng.uniform(-0.5, 0.5, (places, 1, 2))
    sigma = np.broadcast_to(sigma, offset.shape[:2])
    value = surface(offset[..., 0], offset[..., 1]) + sigma * rng.standard_normal(sigma.shape)
    return Samples(offset, value, sigma**2 * np.ones(value.shape), np.ones(value.shape, bool))


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.003, 0.3), st.floats(-3, 3), st.floats(0, 6))
def test_every_place_is_what_the_textbook_says(seed, sigma, slope, jump):
    rng = np.random.default_rng(seed)
    samples = around(rng, 1, lambda x, y: slope * x + 0.3 * np.sin(3 * y) + jump * (x + 0.4 * y > 0.2), sigma)
    expected = predict(samples.offset[0], samples.value[0], samples.variance[0], MODELS)
    np.testing.assert_allclose(predict_surface(samples)[0], expected, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("sigma", [0.005, 0.05, 0.5])
@pytest.mark.parametrize("bend", [0.0, 0.05, 0.5])
def test_the_variance_tells_the_truth(sigma, bend):
    """On planes and on waves, whether noise or structure rules: errors are as large as said, within a factor."""
    rng = np.random.default_rng(3)
    turn = rng.uniform(0, 2 * np.pi, (1500, 1))

    def surface(x, y):
        return 0.4 * x + bend * (np.sin(1.1 * x + turn) - np.sin(turn))

    found = predict_surface(around(rng, 1500, surface, sigma))
    ratio = found[:, 0] / np.sqrt(found[:, 1])
    assert 0.5 < np.sqrt(np.mean(ratio**2)) < 1.2
    assert np.sqrt(np.mean(found[:, 0] ** 2)) < 0.75 * sigma + 0.05 * bend  # two good samples' worth, or the wave seen


def test_good_samples_are_believed_and_bad_ones_averaged():
    """Every fourth sample ten times better, as red pixels of a mosaic are: hardly worse than those alone."""
    rng = np.random.default_rng(4)
    samples = around(rng, 2000, lambda x, y: 0.2 * x, 0.5)
    good = np.zeros(samples.value.shape, bool)
    good[:, ::4] = True
    value = np.where(
        good, 0.2 * samples.offset[..., 0] + 0.1 * (samples.value - 0.2 * samples.offset[..., 0]), samples.value
    )
    mixed = Samples(samples.offset, value, np.where(good, 0.01, 1.0) * samples.variance, samples.measured)
    alone = Samples(samples.offset, value, mixed.variance, good)
    errors = [np.sqrt(np.mean(predict_surface(s)[:, 0] ** 2)) for s in (mixed, alone)]
    assert errors[0] < 1.02 * errors[1]
    assert errors[0] < 0.05  # of 0.05 each, five of them


def test_at_an_edge_the_value_is_one_of_two_surfaces():
    """Never between them; the right one but for a band around the edge, which the variance owns up to."""
    rng = np.random.default_rng(5)
    edge = rng.uniform(-1.5, 1.5, (2000, 1))
    turn = rng.uniform(0, 2 * np.pi, (2000, 1))
    found = predict_surface(around(rng, 2000, lambda x, y: 10.0 * (np.cos(turn) * x + np.sin(turn) * y > edge), 0.05))
    value, sigma, right = found[:, 0], np.sqrt(found[:, 1]), 10.0 * (edge[:, 0] < 0)
    assert np.mean(np.minimum(np.abs(value), np.abs(value - 10)) < 0.5) > 0.99
    wrong = np.abs(value - right) > 5
    assert wrong.mean() < 0.08  # less than a quarter of a spacing, of three: that much columns of samples leave open
    assert np.mean(wrong & (sigma < 1.0)) < 0.01
    assert np.mean((value - right) ** 2) < 1.5 * np.mean(sigma**2)
    assert np.mean(sigma[np.abs(edge[:, 0]) > 1.0] < 0.5) > 0.95


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(-1e3, 1e3), st.integers(1, 20))
def test_lifted_surfaces_and_missing_samples(seed, lift, missing):
    """A constant goes through, and samples that were not measured say nothing, whatever they hold."""
    rng = np.random.default_rng(seed)
    samples = around(rng, 5, lambda x, y: x**2 / 4, 0.1)
    measured = rng.permuted(np.arange(21) >= missing, axis=0) & np.ones((5, 1), bool)
    plain = predict_surface(Samples(samples.offset, samples.value, samples.variance, measured))
    junk = np.where(measured, samples.value + lift, np.nan)
    lifted = predict_surface(Samples(samples.offset, junk, np.where(measured, samples.variance, np.inf), measured))
    np.testing.assert_allclose(lifted - [lift, 0.0], plain, rtol=1e-4, atol=1e-6 * (1 + abs(lift)))
    assert np.isfinite(plain).all()


@pytest.mark.parametrize("variance", [1e-300, 1e-40, 1e-12, 1e12])
def test_no_variance_is_too_small_or_too_large(variance):
    """Samples that claim to be exact, beside others that are not: finite, and of exact ones the surface they show."""
    rng = np.random.default_rng(6)
    samples = around(rng, 60, lambda x, y: 0.3 * x - 0.1 * y + 2.0, 0.0)
    mixed = np.where(rng.random(samples.value.shape) < 0.5, variance, 0.01)
    for variances in (np.full(samples.value.shape, variance), mixed):
        found = predict_surface(Samples(samples.offset, samples.value, variances, samples.measured))
        assert np.isfinite(found).all()
        assert (found[:, 1] >= 0.0).all()
        if variance < 1.0:
            np.testing.assert_allclose(found[:, 0], 2.0, atol=0.1)
