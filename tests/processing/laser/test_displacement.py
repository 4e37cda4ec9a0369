"""Merging over laser locations, and the step from pixels to texels."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.laser.displacement import merge_displacements, tetrahedron_weights
from processing.laser.texel_range import texel_displacement
from tests.reference.displacement import merge_pixel


def stack(seed, sweeps=5, shape=(12, 14)):
    """Noisy views of one surface with different sigmas, a third of the samples missing."""
    rng = np.random.default_rng(seed)
    true = rng.uniform(0.0005, 0.004, shape)
    sigma = rng.uniform(5e-6, 60e-6, (sweeps, *shape))
    values = true + sigma * rng.normal(size=sigma.shape)
    missing = rng.random(sigma.shape) < 0.33
    return true, np.where(missing, np.nan, values), np.where(missing, np.nan, sigma**2)


def test_merged_error_is_the_weighted_mean_s():
    """Within 5 % of the bound 1 / sum(1 / variance), and the variance says so."""
    true, values, variances = stack(1, shape=(150, 150))
    merged = merge_displacements(values, variances)
    found = merged.used > 0
    error = (merged.displacement_m - true)[found]
    assert 0.97 < np.sqrt(np.mean(error**2 / merged.variance_m2[found])) < 1.05
    bound = 1 / np.nansum(1 / variances, axis=0)[found]
    assert np.mean(error**2) < 1.05**2 * np.mean(bound)
    assert np.nanmax(np.abs(merged.consistency - 1)) < 0.05


@given(seed=st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_order_of_sweeps_does_not_matter(seed):
    _, values, variances = stack(seed)
    order = np.random.default_rng(seed).permutation(len(values))
    one, other = merge_displacements(values, variances), merge_displacements(values[order], variances[order])
    np.testing.assert_allclose(one.displacement_m, other.displacement_m, rtol=1e-5)
    np.testing.assert_array_equal(one.used, other.used)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_holes_are_where_nothing_was_measured(seed):
    _, values, variances = stack(seed, sweeps=2)
    merged = merge_displacements(values, variances)
    np.testing.assert_array_equal(np.isnan(merged.displacement_m), np.isnan(values).all(axis=0))
    np.testing.assert_array_equal(merged.used + merged.rejected, np.isfinite(values).sum(axis=0))


def test_a_sweep_alone_passes_through():
    _, values, variances = stack(3, sweeps=1)
    merged = merge_displacements(values, variances)
    np.testing.assert_allclose(merged.displacement_m, values[0], rtol=1e-6)
    np.testing.assert_allclose(merged.variance_m2, variances[0], rtol=1e-6)


def test_one_false_point_among_five_is_rejected():
    true, values, variances = stack(4)
    values[2, 3, 4], variances[2, 3, 4] = true[3, 4] + 0.002, 1e-10
    values[:2, 3, 4], variances[:2, 3, 4] = true[3, 4], 1e-10
    merged = merge_displacements(values, variances)
    assert merged.rejected[3, 4] >= 1
    assert merged.displacement_m[3, 4] == pytest.approx(true[3, 4], abs=1e-4)


@given(seed=st.integers(0, 10**6), factor=st.floats(1e-3, 1e3))
@settings(max_examples=25, deadline=None)
def test_given_weights_count_by_their_ratio_and_none_by_nothing(seed, factor):
    """A sweep of weight 0 is as if it had not been taken, and so is one that knows nothing."""
    _, values, variances = stack(seed)
    weights = np.array([1.0, 0.0, 2.0, 0.5, 3.0])
    there, blind = weights > 0, np.where(weights[:, None, None] > 0, variances, np.inf)
    one = merge_displacements(values, variances, weights)
    for other in (
        merge_displacements(values, variances, weights * factor),
        merge_displacements(values[there], variances[there], weights[there]),
        merge_displacements(values, blind, np.maximum(weights, 1e-3)),
    ):
        np.testing.assert_allclose(one.displacement_m, other.displacement_m, rtol=1e-5)
        np.testing.assert_allclose(one.variance_m2, other.variance_m2, rtol=1e-5)
        np.testing.assert_array_equal(one.used, other.used)
    np.testing.assert_array_equal(np.isfinite(one.displacement_m), one.used > 0)
    assert not merge_displacements(values, variances, 0 * weights).used.any()


@given(
    seed=st.integers(0, 10**6),
    sweeps=st.integers(1, 9),
    paper=st.booleans(),
    single=st.booleans(),
    roughness_m=st.sampled_from([0.0, 25e-6, 1e-3]),
)
@settings(max_examples=30, deadline=None)
def test_merge_equals_its_twin(seed, sweeps, paper, single, roughness_m):
    """Also with false points, equal values, infinities, variances of 0, and in single precision."""
    rng = np.random.default_rng(seed)
    _, values, variances = stack(seed, sweeps, (6, 7))
    values = np.where(rng.random(values.shape) < 0.2, rng.uniform(0, 0.004, values.shape), values)
    values = np.where(rng.random(values.shape) < 0.2, 0.002, values)
    values[:, 0, :4], variances[:, 1, :4], variances[:, 2, :4] = np.inf, 0.0, np.inf
    dtype = np.float32 if single else np.float64
    values, variances = values.astype(dtype), variances.astype(dtype)
    weights = rng.uniform(0.0, 2.0, sweeps).round(1) if paper else None
    merged = merge_displacements(values, variances, weights, roughness_m)
    for place in np.ndindex(values.shape[1:]):
        one = (slice(None), *place)
        value, variance, used, rejected = merge_pixel(values[one], variances[one], weights, roughness_m)
        np.testing.assert_allclose(merged.displacement_m[place], value, rtol=1e-6)
        np.testing.assert_allclose(merged.variance_m2[place], variance, rtol=1e-5)
        assert (merged.used[place], merged.rejected[place]) == (used, rejected)


def many(kind, share, seed=1, locations=26, shape=(60, 60)):
    """True surface, and 26 locations of which a share is wrong at every pixel, with which ones."""
    rng = np.random.default_rng(seed)
    true = rng.uniform(0.0005, 0.0035, shape)
    sigma = rng.uniform(5e-6, 30e-6, (locations, *shape))
    values, variances = true + sigma * rng.normal(size=sigma.shape), sigma**2
    wrong = rng.random(sigma.shape) < share
    if kind == "anywhere":
        values = np.where(wrong, rng.uniform(0, 0.004, sigma.shape), values)
    else:
        values = np.where(wrong, values + rng.uniform(0.0003, 0.002, sigma.shape), values)
    if kind == "behind and sure of it":
        variances = np.where(wrong, variances.min(), variances)
    bound = 1 / np.where(wrong, 0, 1 / sigma**2).sum(axis=0)
    return true, values, variances, bound


@pytest.mark.parametrize("kind", ["anywhere", "behind", "behind and sure of it"])
@pytest.mark.parametrize("share", [0.0, 0.2, 0.4])
def test_many_false_points_cost_little(kind, share):
    """Up to 40 % false at every pixel: the bulk within 10 % of the right ones' weighted mean, one in a thousand off.

    What is false by less than four sigmas cannot be told. Without false points 5 % all over, and the variance is true.
    """
    true, values, variances, bound = many(kind, share)
    merged = merge_displacements(values, variances)
    error = (merged.displacement_m - true) / np.sqrt(bound)
    assert 1.4826 * np.median(np.abs(error)) < 1.1
    assert np.mean(np.abs(error) > 6) < 1e-3
    if share == 0.0:
        assert np.sqrt(np.mean(error**2)) < 1.05
        assert np.sqrt(np.mean((merged.displacement_m - true) ** 2 / merged.variance_m2)) == pytest.approx(1, abs=0.05)


def test_of_two_camps_the_larger_one_wins_however_sure_the_other_is():
    values = np.concatenate([np.full(7, 0.001), np.full(6, 0.003)])[:, None, None]
    variances = np.concatenate([np.full(7, 1e-9), np.full(6, 1e-12)])[:, None, None]
    merged = merge_displacements(values, variances)
    assert merged.displacement_m[0, 0] == pytest.approx(0.001, rel=1e-6)
    assert (merged.used[0, 0], merged.rejected[0, 0]) == (7, 6)
    assert merged.variance_m2[0, 0] == pytest.approx(1e-9 / 7, rel=1e-5)


def test_without_any_measurement_all_is_missing():
    nothing = np.full((26, 5, 6), np.nan, np.float32)
    merged = merge_displacements(nothing, nothing)
    assert np.isnan(merged.displacement_m).all()
    assert np.isnan(merged.variance_m2).all()
    assert np.isnan(merged.consistency).all()
    assert not merged.used.any()


@given(value=st.floats(1e-6, 0.004), sweeps=st.integers(1, 26))
@settings(max_examples=20, deadline=None)
def test_equal_values_are_their_mean(value, sweeps):
    merged = merge_displacements(np.full((sweeps, 1, 2), value), np.full((sweeps, 1, 2), 1e-10))
    np.testing.assert_allclose(merged.displacement_m, value, rtol=1e-6)
    np.testing.assert_allclose(merged.variance_m2, 1e-10 / sweeps, rtol=1e-6)


def test_rough_surfaces_keep_all_their_locations():
    """Locations that differ by 25 um of roughness, five of their sigmas, are no outliers, but for one in ten."""
    rng = np.random.default_rng(8)
    values = 0.002 + rng.normal(0, 25e-6, (8, 50, 50)) + rng.normal(0, 5e-6, (8, 50, 50))
    merged = merge_displacements(values, np.full(values.shape, 25e-12), roughness_m=25e-6)
    assert np.mean(merged.rejected) < 0.1 * 8


@given(seed=st.integers(0, 10**6), power=st.integers(-20, 20), roughness_m=st.sampled_from([0.0, 25e-6]))
@settings(max_examples=25, deadline=None)
def test_lengths_may_be_in_any_unit(seed, power, roughness_m):
    """Powers of two, which no rounding touches: the same samples agree, to the last bit."""
    rng, unit = np.random.default_rng(seed), 2.0**power
    _, values, variances = stack(seed, sweeps=7)
    values += rng.normal(0, 25e-6, values.shape) + np.where(rng.random(values.shape) < 0.1, 0.001, 0.0)
    plain = merge_displacements(values, variances, None, roughness_m)
    other = merge_displacements(unit * values, unit**2 * variances, None, unit * roughness_m)
    np.testing.assert_array_equal(other.displacement_m, np.float32(unit) * plain.displacement_m)
    np.testing.assert_array_equal(other.used, plain.used)
    np.testing.assert_array_equal(other.consistency, plain.consistency)


def test_locations_are_counted_beyond_a_byte():
    values = np.full((300, 1, 1), 0.002)
    values[:20] = 0.003
    merged = merge_displacements(values, np.full(values.shape, 1e-10))
    assert (merged.used[0, 0], merged.rejected[0, 0]) == (280, 20)


def test_two_that_contradict_say_so():
    """Without a majority the variance covers the disagreement."""
    merged = merge_displacements(np.array([[[0.001]], [[0.003]]]), np.full((2, 1, 1), 1e-10))
    assert merged.variance_m2[0, 0] > 0.9 * 0.002**2


def test_a_misplaced_laser_stands_out():
    """A sweep 100 um off is several of its sigmas from the others, which stay near one."""
    _, values, variances = stack(5, shape=(60, 60))
    values[3] += 100e-6
    consistency = merge_displacements(values, variances).consistency
    assert np.argmax(consistency) == 3
    assert consistency[3] > 2


def test_tetrahedron_volumes():
    """Source above, camera level, stripe along y: one metre of base, one of height, one of stripe: a sixth."""
    weights = tetrahedron_weights(
        np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [2.0, 0.0, 2.0]]), np.array([1.0, 0.0, 0.0])
    )
    np.testing.assert_allclose(weights, [1 / 6, 0.0, 1 / 3], atol=1e-12)


def grid(shape, pitch_px, start):
    rows, columns = np.indices(shape) * pitch_px
    return np.stack([columns + start, rows + start], axis=-1).astype(float)


@given(
    slope=st.tuples(st.floats(-3e-4, 3e-4), st.floats(-3e-4, 3e-4)),
    start=st.floats(4, 6),
    pitch_px=st.floats(0.6, 3.0),
)
@settings(max_examples=25, deadline=None)
def test_inclined_planes_come_through_exactly(slope, start, pitch_px):
    rows, columns = np.indices((60, 60))
    plane = 0.002 + slope[0] * (columns - 20) + slope[1] * (rows - 20)
    uv_px = grid((12, 12), pitch_px, start)
    value, variance = texel_displacement(plane, np.full(plane.shape, 1e-10), uv_px, 0.001 * pitch_px)
    expected = 0.002 + slope[0] * (uv_px[..., 0] - 20) + slope[1] * (uv_px[..., 1] - 20)
    np.testing.assert_allclose(value, expected, atol=3e-6)
    assert np.all(variance > 0)


def test_no_value_lies_between_two_surfaces():
    """Across a cliff of 2 mm every texel is on one side or the other, and doubts itself where it could be either."""
    columns = np.indices((40, 40))[1]
    cliff = np.where(columns < 20, 0.001, 0.003)
    uv_px = grid((17, 31), 1.0, 5.0) + np.array([0.37, 0.21])
    value, variance = texel_displacement(cliff, np.full(cliff.shape, 1e-10), uv_px, 0.0005)
    assert np.all(np.minimum(np.abs(value - 0.001), np.abs(value - 0.003)) < 30e-6)
    away = np.abs(uv_px[..., 0] - 19.5) > 2
    assert np.sqrt(variance[~away].max()) > 20 * np.sqrt(variance[away].max())


def test_holes_stay_holes():
    surface = np.full((40, 40), 0.002)
    surface[10:20, 10:20] = np.nan
    value, _ = texel_displacement(surface, np.full(surface.shape, 1e-10), grid((25, 25), 1.0, 5.0), 0.0005)
    assert np.isnan(value[6:14, 6:14]).all()
    assert np.isfinite(value[:3]).all()


def test_texels_outside_the_image_are_holes():
    surface = np.full((20, 20), 0.002)
    aside = grid((8, 8), 1.0, 40.0)
    for places in (aside, np.full((8, 8, 2), np.nan), 1e30 * aside, aside[:1, :1]):  # NaN: behind the camera
        value, variance = texel_displacement(surface, np.full(surface.shape, 1e-10), places, 0.0005)
        assert np.isnan(value).all()
        assert np.isnan(variance).all()
