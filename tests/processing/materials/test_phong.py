import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ConvergenceError
from processing.materials import phong
from processing.materials.phong import (
    FitStatus,
    LobeSamples,
    average_lobes,
    fit_blinn_phong,
    sampled_exponents,
    solve_bounded_pair,
)
from processing.products import BlinnPhong
from tests.reference import phong as reference


def cosines(rng, count=2000):
    """N.L and N.H as on a sphere: both spread, the half angle down to a degree or so."""
    return rng.uniform(0.1, 1, count), np.cos(np.abs(rng.normal(0, 0.4, count)).clip(0, 1.5))


def material(rng):
    return BlinnPhong(rng.uniform(0.05, 0.5, 3), rng.uniform(0.05, 0.5, 3), float(np.exp(rng.uniform(1, 5))))


def noisy(rng, lobe, count=2000, relative=0.02):
    cos_light, cos_half = cosines(rng, count)
    clean = lobe.evaluate_cosines(cos_light, cos_half)
    sigma = relative * clean + 0.002
    return LobeSamples(clean + sigma * rng.normal(size=clean.shape), cos_light, cos_half, sigma**2), clean


def test_exact_samples_give_the_exact_lobe(rng):
    for _ in range(5):
        lobe = material(rng)
        cos_light, cos_half = cosines(rng)
        fit = fit_blinn_phong(LobeSamples(lobe.evaluate_cosines(cos_light, cos_half), cos_light, cos_half))
        # The exponent is sought over bins of 0.011 deg; see the module.
        np.testing.assert_allclose(fit.phong.exponent, lobe.exponent, rtol=1e-4)
        np.testing.assert_allclose(fit.phong.diffuse, lobe.diffuse, rtol=1e-4)
        np.testing.assert_allclose(fit.phong.specular, lobe.specular, rtol=1e-4)
        assert fit.status == FitStatus.CONVERGED


def test_no_general_solver_finds_less_error(rng):
    """Four starts of a bounded trust-region solver never beat the search over n alone."""
    for _ in range(4):
        samples, _ = noisy(rng, material(rng), count=400)
        bounds = sampled_exponents(samples.cos_half)
        _, least = reference.fit(samples.value, samples.cos_light, samples.cos_half, samples.variance**0.5, bounds)
        lobe = fit_blinn_phong(samples).phong
        error = samples.value - lobe.evaluate_cosines(samples.cos_light, samples.cos_half)
        assert (error**2 / samples.variance).sum() <= least * (1 + 1e-6)


def test_the_function_is_recovered_to_the_bound(rng):
    """Seven parameters from N samples of three channels: weighted squared error 7 on average, its root within 5 %.

    Over 120 fits the mean of chi-squared with 7 degrees of freedom is good to 5 %, its root to 2.5 %.
    """
    squares = []
    for _ in range(120):
        samples, clean = noisy(rng, material(rng))
        fitted = fit_blinn_phong(samples).phong.evaluate_cosines(samples.cos_light, samples.cos_half)
        squares.append(((fitted - clean) ** 2 / samples.variance).sum())
    assert np.sqrt(np.mean(squares) / 7) < 1.06


def test_covariance_says_how_far_parameters_are_off(rng):
    lobe = material(rng)
    truth = np.array([*lobe.diffuse, *lobe.specular, lobe.exponent])
    normalised = []
    for _ in range(60):
        fit = fit_blinn_phong(noisy(rng, lobe)[0])
        found = np.array([*fit.phong.diffuse, *fit.phong.specular, fit.phong.exponent])
        normalised.append((found - truth) / np.sqrt(np.diag(fit.covariance)))
    # 420 normalised errors: their root mean square is good to 3.5 %, and they are correlated.
    assert 0.85 < np.sqrt(np.mean(np.square(normalised))) < 1.15


@settings(max_examples=15, deadline=None)
@given(st.floats(-6, 6), st.integers(0, 2**32 - 1))
def test_any_unit_gives_the_same_lobe(decades, seed):
    rng = np.random.default_rng(seed)
    samples, _ = noisy(rng, material(rng), count=300)
    factor = 10**decades
    scaled = LobeSamples(samples.value * factor, samples.cos_light, samples.cos_half, samples.variance * factor**2)
    here, there = fit_blinn_phong(samples), fit_blinn_phong(scaled)
    np.testing.assert_allclose(there.phong.exponent, here.phong.exponent, rtol=1e-4)
    np.testing.assert_allclose(there.phong.diffuse / factor, here.phong.diffuse, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(there.phong.specular / factor, here.phong.specular, rtol=1e-4, atol=1e-6)
    assert there.status == here.status


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0, 0.9))
def test_invalid_samples_are_as_if_they_were_not_there(seed, share):
    rng = np.random.default_rng(seed)
    samples, _ = noisy(rng, material(rng), count=300)
    keep = rng.random(300) >= share
    keep[:8] = True
    value, variance, cos_light, cos_half = (
        samples.value.copy(), samples.variance.copy(), samples.cos_light.copy(), samples.cos_half.copy()
    )  # fmt: skip
    kind = rng.integers(0, 5, 300)
    value[~keep & (kind == 0)] = np.nan
    variance[~keep & (kind == 1)] = np.inf
    variance[~keep & (kind == 2)] = 0.0
    cos_light[~keep & (kind == 3)] = -0.3
    cos_half[~keep & (kind == 4)] = np.nan
    marked = fit_blinn_phong(LobeSamples(value, cos_light, cos_half, variance))
    only = fit_blinn_phong(LobeSamples(value[keep], cos_light[keep], cos_half[keep], variance[keep]))
    assert marked.samples == keep.sum()
    np.testing.assert_allclose(marked.phong.diffuse, only.phong.diffuse, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(marked.phong.exponent, only.phong.exponent, rtol=1e-5)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 40), st.integers(2, 60))
def test_sums_by_half_angle_equal_their_numpy_twin(seed, count, bins):
    """Both ends of the range among the half angles."""
    rng = np.random.default_rng(seed)
    cos_half = np.concatenate([[0.0, 1.0], rng.uniform(0, 1, count)])
    cos_light, value, weights = (
        rng.uniform(0, 1, count + 2),
        rng.normal(size=(count + 2, 3)),
        rng.random((count + 2, 3)),
    )
    sums = phong._bins(value, weights, cos_light, cos_half, bins)
    twin = reference.half_angle_sums(value, weights, cos_light, cos_half, bins)
    np.testing.assert_allclose(sums, twin, atol=1e-9)


def test_order_of_the_samples_does_not_matter(rng):
    samples, _ = noisy(rng, material(rng))
    turn = rng.permutation(len(samples.cos_light))
    turned = LobeSamples(samples.value[turn], samples.cos_light[turn], samples.cos_half[turn], samples.variance[turn])
    np.testing.assert_allclose(
        fit_blinn_phong(turned).phong.exponent, fit_blinn_phong(samples).phong.exponent, rtol=1e-6
    )


def test_a_matt_material_has_no_lobe(rng):
    cos_light, cos_half = cosines(rng)
    fit = fit_blinn_phong(LobeSamples(cos_light[:, None] * [0.3, 0.2, 0.1], cos_light, cos_half))
    np.testing.assert_allclose(fit.phong.diffuse, [0.3, 0.2, 0.1], rtol=1e-6)
    assert fit.phong.specular.max() < 1e-6


def test_coefficients_are_never_negative(rng):
    """A material darker in the highlight than beside it wants a negative k_s."""
    cos_light, cos_half = cosines(rng)
    value = (0.4 * cos_light - 0.2 * cos_half**20)[:, None] + 0.005 * rng.normal(size=(2000, 3))
    fit = fit_blinn_phong(LobeSamples(value, cos_light, cos_half))
    assert (fit.phong.specular == 0).all()
    assert (fit.phong.diffuse > 0).all()
    assert fit.status == FitStatus.AT_BOUND


def test_black_is_black(rng):
    cos_light, cos_half = cosines(rng)
    fit = fit_blinn_phong(LobeSamples(np.zeros((2000, 3)), cos_light, cos_half))
    assert (fit.phong.diffuse == 0).all()
    assert (fit.phong.specular == 0).all()
    assert np.isfinite(fit.covariance).all()
    assert fit.status == FitStatus.AT_BOUND


def test_a_saturated_highlight_that_is_marked_does_not_flatten_the_lobe(rng):
    lobe = BlinnPhong(np.full(3, 0.2), np.full(3, 0.8), 60.0)
    cos_light, cos_half = cosines(rng)
    value = lobe.evaluate_cosines(cos_light, cos_half)
    marked = np.where(value > 0.6, np.nan, value)
    assert np.isnan(marked).any()
    fit = fit_blinn_phong(LobeSamples(marked, cos_light, cos_half))
    np.testing.assert_allclose(fit.phong.exponent, 60.0, rtol=1e-3)
    np.testing.assert_allclose(fit.phong.specular, 0.8, rtol=1e-3)


def test_a_mirror_lobe_sampled_coarsely_stays_within_what_the_samples_resolve():
    """Half angles every 7.5 deg cannot tell n = 2000 from anything narrower than half a step."""
    half_angle = np.radians(np.repeat(np.arange(0, 90, 7.5), 20))
    cos_light = np.tile(np.linspace(0.2, 1, 20), 12)
    value = (0.2 * cos_light + 0.9 * np.cos(half_angle) ** 2000)[:, None] * np.ones(3)
    bounds = sampled_exponents(np.cos(half_angle))
    fit = fit_blinn_phong(LobeSamples(value, cos_light, np.cos(half_angle)))
    assert bounds[1] == pytest.approx(np.log(0.5) / np.log(np.cos(np.radians(7.5))))
    assert fit.phong.exponent <= bounds[1] * 1.0001
    assert fit.status == FitStatus.AT_BOUND


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_samples_is_a_status(count):
    value = np.full((5, 3), np.nan)
    value[:count] = 0.5
    fit = fit_blinn_phong(LobeSamples(value, np.full(5, 0.5), np.linspace(0.5, 1, 5)))
    assert fit.status == FitStatus.TOO_FEW_SAMPLES
    assert np.isfinite(fit.phong.diffuse).all()
    with pytest.raises(ConvergenceError, match="too_few_samples"):
        fit.check()


@pytest.mark.parametrize("value", [5e-324, 1e170, 1e300])
@pytest.mark.parametrize("variance", [None, 1e-300, 1e300])
def test_values_at_the_end_of_the_number_range_are_a_status(rng, value, variance):
    """They, or their squares, are no numbers any more."""
    cos_light, cos_half = cosines(rng, 50)
    known = None if variance is None else np.full((50, 3), variance)
    fit = fit_blinn_phong(LobeSamples(np.full((50, 3), value), cos_light, cos_half, known))
    assert fit.status == FitStatus.DIVERGED
    assert np.isfinite(fit.phong.diffuse).all()


def test_small_values_are_no_trouble_where_their_squares_are_none(rng):
    lobe = BlinnPhong(np.full(3, 0.2), np.full(3, 0.8), 60.0)
    cos_light, cos_half = cosines(rng)
    value = 1e-170 * lobe.evaluate_cosines(cos_light, cos_half)
    fit = fit_blinn_phong(LobeSamples(value, cos_light, cos_half, np.full((2000, 3), 1e-300)))
    np.testing.assert_allclose(fit.phong.specular, 0.8e-170, rtol=1e-4)
    assert np.isfinite(fit.covariance).all()


def test_average_is_over_the_usable_sets(rng):
    fits = [fit_blinn_phong(noisy(rng, material(rng))[0]) for _ in range(3)]
    few = fit_blinn_phong(LobeSamples(np.full((5, 3), np.nan), np.ones(5), np.ones(5)))
    mean = average_lobes([*fits, few])
    np.testing.assert_allclose(mean.diffuse, np.mean([fit.phong.diffuse for fit in fits], axis=0))
    with pytest.raises(ConvergenceError):
        average_lobes([few])


@given(st.lists(st.floats(-5, 5), min_size=8, max_size=8))
def test_bounded_pair_is_the_best_of_the_quadrant(numbers):
    """No point of a fine grid over the quadrant has less error."""
    columns, value = np.array(numbers[:6]).reshape(3, 2), np.array([*numbers[6:], 1.0])
    a, b = columns.T
    k = solve_bounded_pair(*(np.array([float(x)]) for x in (a @ a, a @ b, b @ b, a @ value, b @ value)))[:, 0]
    assert (k >= 0).all()
    grid = np.stack(np.meshgrid(np.linspace(0, 3, 40), np.linspace(0, 3, 40)), axis=-1).reshape(-1, 2)
    least = ((grid @ columns.T - value) ** 2).sum(axis=1).min()
    assert ((columns @ k - value) ** 2).sum() <= least + 1e-6 * (1 + value @ value)


def test_single_precision_gives_the_same_lobe(rng):
    """Values rounded to float32 move the lobe by no more than their rounding."""
    samples, _ = noisy(rng, material(rng))
    rounded = LobeSamples(
        samples.value.astype(np.float32), samples.cos_light, samples.cos_half, samples.variance.astype(np.float32)
    )
    here, there = fit_blinn_phong(samples).phong, fit_blinn_phong(rounded).phong
    np.testing.assert_allclose(there.exponent, here.exponent, rtol=1e-5)
    np.testing.assert_allclose(there.diffuse, here.diffuse, rtol=1e-5)
