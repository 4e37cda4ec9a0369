"""Lafortune fits: on the bound, in any unit and order, and calm where the samples say little."""

import numpy as np
import pytest

from processing.errors import ImageError
from processing.sbrdf.lafortune import FitStatus, LafortuneFit, LobeLayout, fit_lafortune, lafortune_values
from tests.reference import lafortune as reference

CALM = (FitStatus.CONVERGED, FitStatus.AT_BOUND)


def hemisphere(rings=((0, 1), (20, 6), (40, 10), (60, 12))):
    angles = [(np.radians(polar), 2 * np.pi * k / count) for polar, count in rings for k in range(count)]
    return np.array([(np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)) for p, a in angles])


DIRECTIONS = hemisphere()
LIGHT, VIEW = np.repeat(DIRECTIONS, len(DIRECTIONS), axis=0), np.tile(DIRECTIONS, (len(DIRECTIONS), 1))


def materials(rng, texels, lobes=3, shared=False):
    """Diffuse, axis, exponent, albedo: lobes forward and back, from broad to as narrow as the directions tell."""
    axis = np.concatenate([rng.uniform(0.7, 1, (texels, lobes, 2)), rng.uniform(0.3, 1, (texels, lobes, 1))], axis=2)
    axis[..., :2] *= np.where(rng.random((texels, lobes, 1)) < 0.75, -1, 1)
    axis /= np.abs(axis).max(axis=2, keepdims=True)
    exponent = np.exp(rng.uniform(np.log(1.5), np.log(40), (texels, lobes)))
    diffuse, albedo = rng.uniform(0.05, 0.4, (texels, 3)), rng.uniform(0.1, 1, (texels, lobes, 3))
    if shared:
        axis[:], diffuse[:] = axis[:, :1], diffuse[:, :1]
    return tuple(one.astype(np.float32) for one in (diffuse, axis, exponent, albedo))


@pytest.fixture(scope="module")
def clean():
    return reference.values(*materials(np.random.default_rng(2), 12), LIGHT, VIEW)


@pytest.fixture(scope="module")
def noisy(clean):
    drawn = clean + 0.002 * np.random.default_rng(3).normal(size=clean.shape)
    return drawn.astype(np.float32)


def test_values_are_those_of_the_model_and_of_the_product():
    material = materials(np.random.default_rng(5), 7)
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
    clean = reference.values(*materials(np.random.default_rng(6), 8, shared=True), LIGHT, VIEW)
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
