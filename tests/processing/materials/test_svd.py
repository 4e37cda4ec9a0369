import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.products import Btf, StoredBtf
from processing.svd import factor_btf, factor_texels
from tests.reference.btf import eckart_young, lit

LIGHTS, VIEWS = 6, 9


def directions(count, rng):
    xy = rng.uniform(-0.6, 0.6, (count, 2))
    return np.column_stack([xy, np.sqrt(1 - (xy**2).sum(axis=1))])


def smooth_btf(rng, terms=VIEWS, height=18, width=7):
    """Terms of falling strength, as of a real material."""
    maps = rng.normal(size=(terms, LIGHTS, height, width, 3)) * 0.4 ** np.arange(terms)[:, None, None, None, None]
    reflectance = np.einsum("klyxc,kv->lvyxc", maps, rng.normal(size=(terms, VIEWS)))
    return Btf(reflectance.astype(np.float32), directions(LIGHTS, rng), directions(VIEWS, rng))


def rebuilt(factored):
    return np.einsum("klyxc,kv->lvyxc", factored.eigenmaps.astype(np.float64), factored.weights)


@settings(max_examples=20, deadline=None)
@given(st.integers(1, VIEWS), st.integers(0, 2**32 - 1))
def test_error_is_the_least_that_the_rank_allows(rank, seed):
    btf = smooth_btf(np.random.default_rng(seed))
    factors = factor_btf(btf, rank)
    error = np.linalg.norm(lit(btf, rebuilt(factors.btf) - btf.reflectance)) / np.linalg.norm(lit(btf))
    # float32 factors add 1e-7 of the whole; it is all that full rank has.
    assert error <= 1.001 * eckart_young(btf, rank) + 1e-6
    assert factors.relative_rmse(rank) == pytest.approx(error, rel=1e-3, abs=1e-6)


def test_a_light_on_the_horizon_or_under_it_has_no_say_in_the_terms(rng):
    """However bright it is there; what is seen under it is projected all the same."""
    btf = smooth_btf(rng)
    dark, glints = btf.reflectance.copy(), btf.reflectance.copy()
    lights = btf.light_directions.copy()
    lights[4:] = [[0.8, 0.6, 0.0], [0.6, 0.0, -0.8]]
    dark[4:], glints[4:] = 0, rng.normal(size=glints[4:].shape) * 1e6
    expected, found = (factor_btf(Btf(values, lights, btf.view_directions), 3) for values in (dark, glints))
    np.testing.assert_array_equal(found.btf.weights, expected.btf.weights)
    np.testing.assert_array_equal(found.squared_singular_values, expected.squared_singular_values)
    assert np.abs(found.btf.eigenmaps[:, 4:]).max() > 1


def test_a_btf_of_three_terms_is_exact_at_rank_three(rng):
    factors = factor_btf(smooth_btf(rng, terms=3), 3)
    assert factors.relative_rmse(2) > 1e-3
    assert factors.relative_rmse(3) < 1e-6


def test_energy_rises_to_one(rng):
    energy = factor_btf(smooth_btf(rng), 2).energy
    assert (np.diff(energy) >= 0).all()
    assert energy[-1] == pytest.approx(1)


def test_factors_evaluate_to_the_measured_samples_at_full_rank(rng):
    btf = smooth_btf(rng)
    factored = factor_btf(btf, VIEWS).btf
    np.testing.assert_allclose(rebuilt(factored), btf.reflectance, atol=1e-5)
    np.testing.assert_allclose((factored.weights.astype(np.float64) ** 2).sum(axis=1), 1, atol=1e-6)


def test_blocks_from_disk_give_the_same_factors(tmp_path, rng):
    btf = smooth_btf(rng)
    btf.save(tmp_path)
    whole, streamed = factor_btf(Btf.load(tmp_path), 4), factor_btf(StoredBtf.open(tmp_path), 4)
    np.testing.assert_allclose(rebuilt(streamed.btf), rebuilt(whole.btf), atol=1e-5)


def test_scale_changes_the_eigenmaps_alone(rng):
    btf = smooth_btf(rng)
    reference = factor_btf(btf, 3)
    for factor in (1e-6, 1e6):
        scaled = factor_btf(Btf(btf.reflectance * np.float32(factor), btf.light_directions, btf.view_directions), 3)
        np.testing.assert_allclose(scaled.btf.weights, reference.btf.weights, atol=1e-4)
        assert scaled.relative_rmse(3) == pytest.approx(reference.relative_rmse(3), rel=1e-3)


def test_missing_samples_count_with_the_mean_of_their_row(rng):
    btf = smooth_btf(rng)
    hole = (2, 4, 3, 5, 1)
    filled, holed = btf.reflectance.copy(), btf.reflectance.copy()
    filled[hole] = np.delete(btf.reflectance[2, :, 3, 5, 1], 4).mean()
    holed[hole] = np.nan
    args = (btf.light_directions, btf.view_directions)
    expected, found = factor_btf(Btf(filled, *args), 4), factor_btf(Btf(holed, *args), 4)
    np.testing.assert_allclose(rebuilt(found.btf), rebuilt(expected.btf), atol=1e-5)
    assert found.missing == pytest.approx(1 / holed.size)


def test_rows_without_any_sample_are_black(rng):
    btf = smooth_btf(rng)
    btf.reflectance[1] = np.nan
    assert np.abs(factor_btf(btf, 4).btf.eigenmaps[:, 1]).max() == 0


def test_a_black_btf_has_black_maps_and_no_error(rng):
    btf = smooth_btf(rng)
    factors = factor_btf(Btf(btf.reflectance * 0, btf.light_directions, btf.view_directions), 2)
    assert (factors.btf.eigenmaps == 0).all()
    assert factors.relative_rmse(1) == 0
    assert (factors.energy == 1).all()


@pytest.mark.parametrize("rank", [0, VIEWS + 1])
def test_an_impossible_rank_is_named(rng, rank):
    with pytest.raises(ImageError, match="views"):
        factor_btf(smooth_btf(rng), rank)


def of_texels(factors):
    return np.einsum("kyx,klvc->lvyxc", factors.maps.astype(np.float64), factors.functions)


@settings(max_examples=8, deadline=None)
@given(st.integers(1, 40), st.integers(0, 2**32 - 1), st.booleans())
def test_maps_of_texels_come_within_a_thousandth_of_the_least_error(rank, seed, noisy):
    """Also where the singular values hardly fall: noise is what makes iterations slow."""
    rng = np.random.default_rng(seed)
    btf = smooth_btf(rng, terms=40)
    if noisy:
        btf.reflectance[...] += rng.normal(scale=0.02, size=btf.shape).astype(np.float32)
    factors = factor_texels(btf, rank)
    error = np.linalg.norm(of_texels(factors) - btf.reflectance) / np.linalg.norm(btf.reflectance)
    matrix = np.moveaxis(btf.reflectance, (2, 3), (0, 1)).reshape(18 * 7, -1).astype(np.float64)
    squares = np.linalg.svd(matrix, compute_uv=False) ** 2
    least = np.sqrt(squares[rank:].sum() / squares.sum())
    assert least - 1e-6 <= error <= 1.001 * least + 1e-6
    assert factors.relative_rmse(rank) == pytest.approx(error, rel=1e-3, abs=2e-3)  # a root of float32's roundings
    np.testing.assert_allclose((factors.functions.astype(np.float64) ** 2).sum(axis=(1, 2, 3)), 1, atol=1e-5)


def test_maps_of_texels_from_disk_with_missing_samples_and_of_a_black_btf(tmp_path, rng):
    btf = smooth_btf(rng)
    btf.reflectance[:, 2, 3, 4] = np.nan
    btf.save(tmp_path)
    whole, streamed = factor_texels(Btf.load(tmp_path), 4), factor_texels(StoredBtf.open(tmp_path), 4)
    np.testing.assert_allclose(of_texels(streamed), of_texels(whole), atol=1e-5)
    assert np.isfinite(whole.maps).all()
    black = factor_texels(Btf(btf.reflectance * 0, btf.light_directions, btf.view_directions), 2)
    assert np.nanmax(np.abs(black.maps)) == 0
    assert black.relative_rmse(1) == 0


def test_maps_of_one_texel_and_an_impossible_rank(rng):
    btf = smooth_btf(rng, height=1, width=1)
    np.testing.assert_allclose(of_texels(factor_texels(btf, 1)), btf.reflectance, atol=1e-5)
    for rank in (0, 2):
        with pytest.raises(ImageError, match="choose 1 to 1"):
            factor_texels(btf, rank)


@settings(max_examples=10, deadline=None)
@given(st.integers(1, 3 * VIEWS), st.integers(0, 2**32 - 1))
def test_grey_maps_have_the_least_error_of_a_matrix_with_channels_as_columns(rank, seed):
    btf = smooth_btf(np.random.default_rng(seed), terms=3 * VIEWS)
    factors = factor_btf(btf, rank, "grey")
    maps, weights = factors.btf.eigenmaps.astype(np.float64), factors.btf.weights
    error = np.linalg.norm(lit(btf, np.einsum("klyx,kvc->lvyxc", maps[..., 0], weights) - btf.reflectance))
    matrix = np.moveaxis(lit(btf), 1, 3).reshape(-1, 3 * VIEWS)
    squares = np.linalg.svd(matrix, compute_uv=False) ** 2
    assert error <= 1.001 * np.sqrt(squares[rank:].sum()) + 1e-6 * np.sqrt(squares.sum())
    assert maps.shape[4] == 1


def test_grey_maps_need_no_more_terms_than_columns(rng):
    with pytest.raises(ImageError, match="choose 1 to 27 for grey maps"):
        factor_btf(smooth_btf(rng), 3 * VIEWS + 1, "grey")


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_values_whose_squares_float32_does_not_hold_are_factored(rng, scale):
    btf = smooth_btf(rng, terms=3)
    factors = factor_btf(Btf(btf.reflectance * np.float32(scale), btf.light_directions, btf.view_directions), 3)
    assert factors.relative_rmse(3) < 1e-6
    np.testing.assert_allclose(rebuilt(factors.btf) / scale, btf.reflectance, atol=1e-5)


def test_grey_maps_of_missing_samples_from_disk_are_those_in_memory(tmp_path, rng):
    """Several shards in both directions, rows of chunks that end early, NaN and a light that was never on."""
    reflectance = rng.random((9, 11, 20, 18, 3)).astype(np.float16).astype(np.float32)
    reflectance[0, 0, 0, 0], reflectance[4], reflectance[2, 3] = np.nan, np.nan, np.inf
    btf = Btf(reflectance, directions(9, rng), directions(11, rng))
    Btf(np.where(np.isinf(reflectance), np.nan, reflectance), *(btf.light_directions, btf.view_directions)).save(
        tmp_path
    )
    whole, streamed = factor_btf(btf, 5, "grey"), factor_btf(StoredBtf.open(tmp_path), 5, "grey")
    np.testing.assert_array_equal(whole.btf.eigenmaps, streamed.btf.eigenmaps)
    assert whole.missing == streamed.missing == pytest.approx(np.mean(~np.isfinite(reflectance)))
    assert np.abs(whole.btf.eigenmaps[:, 4]).max() == 0
