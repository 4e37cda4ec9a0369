"""Lafortune fits: on the bound, in any unit and order, and calm where the samples say little."""

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.formats.measured_brdf import read_measured_brdf
from processing.sbrdf.lafortune import FitStatus, LafortuneFit, LobeLayout, fit_lafortune, lafortune_values
from processing.sbrdf.lafortune_starts import exponent_bounds
from tests.public_data import DATA
from tests.reference import lafortune as reference

CALM = (FitStatus.CONVERGED, FitStatus.AT_BOUND)


def hemisphere(rings=((0, 1), (20, 6), (40, 10), (60, 12))):
    angles = [(np.radians(polar), 2 * np.pi * k / count) for polar, count in rings for k in range(count)]
    return np.array([(np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)) for p, a in angles])


DIRECTIONS = hemisphere()
LIGHT, VIEW = np.repeat(DIRECTIONS, len(DIRECTIONS), axis=0), np.tile(DIRECTIONS, (len(DIRECTIONS), 1))


@pytest.fixture(scope="module")
def clean():
    return reference.values(*reference.materials(np.random.default_rng(2), 12), LIGHT, VIEW)


@pytest.fixture(scope="module")
def noisy(clean):
    drawn = clean + 0.002 * np.random.default_rng(3).normal(size=clean.shape)
    return drawn.astype(np.float32)


def test_values_are_those_of_the_model_and_of_the_product():
    material = reference.materials(np.random.default_rng(5), 7)
    fit = LafortuneFit(*material, np.zeros(7, np.int8), np.zeros(7, np.float32), np.zeros(7, np.int32))
    found, true = lafortune_values(fit, LIGHT, VIEW), reference.values(*material, LIGHT, VIEW)
    assert np.abs(found - true).max() < 2e-6 * true.max()  # float32, exponents up to 40
    product = fit.texels(1, 7, 2.0).evaluate(np.zeros(1, np.intp), np.array([3]), LIGHT[200], VIEW[200])
    assert product * LIGHT[200, 2] == pytest.approx(2 * true[3, 200][None], rel=1e-6)


def test_the_function_is_found_to_the_bound_of_its_noise(clean, noisy):
    """On average sigma sqrt(p / N); a wrong minimum is several times that."""
    fit = fit_lafortune(noisy, LIGHT, VIEW)
    error = np.sqrt(((lafortune_values(fit, LIGHT, VIEW) - clean) ** 2).mean(axis=(1, 2)))
    assert np.median(error) < 1.15 * 0.002 * np.sqrt(21 / noisy[0].size)
    assert set(fit.status) <= set(CALM)


def test_a_texel_that_is_not_finite_leaves_the_others_alone(noisy):
    whole = fit_lafortune(noisy, LIGHT, VIEW)
    broken = noisy.copy()
    broken[3] = np.nan
    fit = fit_lafortune(broken, LIGHT, VIEW)
    assert fit.status[3] == FitStatus.TOO_FEW_SAMPLES
    others = np.arange(len(noisy)) != 3
    assert np.array_equal(fit.chosen(others).exponent, whole.chosen(others).exponent)


def test_the_layout_of_the_paper_shares_c_and_a_grey_diffuse():
    clean = reference.values(*reference.materials(np.random.default_rng(6), 8, shared=True), LIGHT, VIEW)
    fit = fit_lafortune(clean.astype(np.float32), LIGHT, VIEW, layout=LobeLayout.SHARED)
    there = fit.albedo.sum(axis=2) > 0
    assert all(np.ptp(axis[own], axis=0).max() < 1e-6 for axis, own in zip(fit.axis, there, strict=True) if own.any())
    assert np.ptp(fit.diffuse, axis=1).max() == 0
    error = np.sqrt(((lafortune_values(fit, LIGHT, VIEW) - clean) ** 2).mean(axis=(1, 2)))
    assert np.median(error) < 1e-3 * clean.mean()


def test_samples_that_do_not_fit_their_directions_are_refused(noisy):
    with pytest.raises(ImageError, match="samples of texels"):
        fit_lafortune(noisy[:, 1:], LIGHT, VIEW)
    with pytest.raises(ImageError, match="lobes"):
        fit_lafortune(noisy, LIGHT, VIEW, lobes=4)


@pytest.fixture(scope="module")
def fitted(noisy):
    return fit_lafortune(noisy, LIGHT, VIEW)


def drawn(fit):
    return lafortune_values(fit, LIGHT, VIEW)


def apart(one, other):
    """Largest difference of two fits' functions over the root mean square of the first, (t,)."""
    return np.abs(drawn(one) - drawn(other)).max(axis=(1, 2)) / np.sqrt((drawn(one) ** 2).mean(axis=(1, 2)))


def test_the_parameters_keep_what_the_product_says_of_them(fitted):
    present = fitted.albedo.max(axis=2) > 0
    assert np.allclose(np.abs(fitted.axis[present]).max(axis=1), 1)
    assert (fitted.axis[~present] == 0).all()
    assert (fitted.exponent[~present] == 1).all()
    assert (fitted.albedo >= 0).all()
    assert (fitted.diffuse >= 0).all()
    low, high = exponent_bounds(LIGHT, VIEW)
    assert ((fitted.exponent >= low * (1 - 1e-6)) & (fitted.exponent <= high * (1 + 1e-6))).all()


def test_the_cost_is_the_mean_squared_error(fitted, noisy):
    error = ((drawn(fitted) - noisy) ** 2).mean(axis=(1, 2))
    assert np.allclose(fitted.cost, error, rtol=1e-3)  # its last step is counted by what it promised


@settings(max_examples=8, deadline=None)
@given(st.floats(-6, 6))
def test_the_unit_of_the_values_changes_nothing(fitted, noisy, power):
    """A power of two changes no digit; other factors round the values, which moves what they do not determine well."""
    two, scale = np.float32(2.0 ** round(3.3 * power)), np.float32(10**power)
    assert np.array_equal(drawn(fit_lafortune(noisy * two, LIGHT, VIEW)) / two, drawn(fitted))
    fit = fit_lafortune(noisy * scale, LIGHT, VIEW)
    difference = np.abs(drawn(fit) / scale - drawn(fitted)).max(axis=(1, 2))
    assert np.quantile(difference, 0.8) < 1e-4 * drawn(fitted).max()


def test_the_order_of_the_samples_changes_nothing_beyond_the_noise(fitted, noisy, clean):
    order = np.random.default_rng(4).permutation(len(LIGHT))
    fit = fit_lafortune(noisy[:, order], LIGHT[order], VIEW[order])
    assert np.median(apart(fit, fitted)) < 1e-3  # another part of the samples comes first


def test_texels_do_not_know_of_each_other_or_of_threads(fitted, noisy):
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        alone = LafortuneFit.joined([fit_lafortune(noisy[t : t + 1], LIGHT, VIEW) for t in range(3)])
    finally:
        numba.set_num_threads(threads)
    for one, other in zip(vars(alone).values(), vars(fitted.chosen(slice(3))).values(), strict=True):
        assert np.array_equal(one, other)


def test_missing_samples_are_as_if_they_had_not_been_taken(noisy):
    kept = np.random.default_rng(8).random(len(LIGHT)) < 0.6
    holed = np.where(kept[:, None], noisy, np.float32(np.nan))
    weighed = fit_lafortune(noisy, LIGHT, VIEW, variance=np.where(kept, 1.0, np.inf))
    assert np.array_equal(weighed.albedo, fit_lafortune(holed, LIGHT, VIEW).albedo)
    assert np.median(apart(fit_lafortune(noisy[:, kept], LIGHT[kept], VIEW[kept]), weighed)) < 1e-3


def test_a_start_saves_rounds_and_ends_in_the_same_place(fitted, noisy):
    again = fit_lafortune(noisy, LIGHT, VIEW, start=fitted)
    assert again.iterations.mean() < fitted.iterations.mean() / 4
    assert apart(again, fitted).max() < 1e-3


def test_samples_of_unlike_noise_count_by_their_variance(clean):
    """Half of the samples are a hundred times noisier: they must not be felt."""
    rng = np.random.default_rng(9)
    sigma = np.where(rng.random(len(LIGHT)) < 0.5, 0.2, 0.002)
    values = (clean + sigma[:, None] * rng.normal(size=clean.shape)).astype(np.float32)
    fit = fit_lafortune(values, LIGHT, VIEW, variance=sigma**2)
    error = np.sqrt(((drawn(fit) - clean) ** 2).mean(axis=(1, 2)))
    assert np.median(error) < 1.25 * 0.002 * np.sqrt(21 / (values[0].size / 2))
    assert np.median(fit.cost) == pytest.approx(1, abs=0.1)


def test_a_matt_texel_has_no_lobe():
    rng = np.random.default_rng(10)
    true = np.broadcast_to(LIGHT[:, 2:] * [0.3, 0.2, 0.1], (6, len(LIGHT), 3))
    fit = fit_lafortune((true + 0.002 * rng.normal(size=true.shape)).astype(np.float32), LIGHT, VIEW)
    assert (fit.albedo == 0).mean() > 0.8  # noise may ask for one by Akaike's criterion
    assert np.abs(drawn(fit) - true).max() < 0.005
    exact = fit_lafortune(true.astype(np.float32), LIGHT, VIEW)
    assert (exact.albedo == 0).all()
    assert np.allclose(exact.diffuse, [0.3, 0.2, 0.1], rtol=1e-5)


def test_fewer_lobes_are_those_asked_for(noisy):
    for lobes in (1, 2):
        fit = fit_lafortune(noisy, LIGHT, VIEW, lobes=lobes)
        assert fit.exponent.shape == (len(noisy), lobes)
        assert np.isfinite(drawn(fit)).all()


@pytest.mark.parametrize("layout", list(LobeLayout))
@pytest.mark.parametrize(("name", "case"), reference.odd_texels(LIGHT, VIEW).items())
def test_no_texel_is_too_odd(name, case, layout):
    values, dead = case
    start = None
    if dead:
        axis, ones = np.full((1, 3, 3), [-1.0, -1.0, -1.0], np.float32), np.ones((1, 3), np.float32)
        status = np.zeros(1, np.int8)
        start = LafortuneFit(ones, axis, 1 + 9 * ones, axis * 0 + 1, status, np.zeros(1), np.zeros(1, np.int32))
    fit = fit_lafortune(values, LIGHT, VIEW, start=start, layout=layout)
    numbers = (fit.diffuse, fit.axis, fit.exponent, fit.albedo, fit.cost, drawn(fit))
    assert all(np.isfinite(one).all() for one in numbers), name
    assert fit.exponent.max() <= exponent_bounds(LIGHT, VIEW)[1] * (1 + 1e-6)


@pytest.mark.parametrize("paint", ["cayman", "acryl_blue", "garnet_red"])
def test_measured_paints_do_not_run_away(paint):
    """One sample at grazing is a million times the median, or near it: scipy gives a lobe of n = 4000 to it alone."""
    path = DATA / "brdf" / f"{paint}.brdf"
    if not path.exists():
        pytest.skip("public data is not here")
    brdf = read_measured_brdf(path)
    values = brdf.rgb() * brdf.light[:, 2:].astype(np.float32)
    fit = fit_lafortune(values[None], brdf.light, brdf.view)
    assert fit.exponent.max() <= exponent_bounds(brdf.light, brdf.view)[1] * (1 + 1e-6) < 1000
    assert fit.cost[0] < 0.2 * (values**2).mean()


@pytest.mark.parametrize(("step_deg", "least", "most"), [(15, 100, 200), (7.5, 400, 800)])
def test_the_narrowest_lobe_follows_the_spacing_of_the_directions(step_deg, least, most):
    """A hundredth is left at one step: log 100 over step^2 / 2."""
    steps = np.arange(0, 76, step_deg)
    rings = [(polar, max(1, round(360 * np.sin(np.radians(polar)) / step_deg))) for polar in steps]
    some = hemisphere(rings)
    light, view = np.repeat(some, len(some), axis=0), np.tile(some, (len(some), 1))
    assert least < exponent_bounds(light, view)[1] < most
