import numpy as np
import pytest

from processing.materials.anisotropic import DrawnShapes, fit_anisotropic_beside_residual
from processing.materials.measurements import Measurements
from processing.materials.phong import FitStatus
from processing.materials.sample_geometry import SampleGeometry
from processing.products import AnisotropicPhong, BlinnPhong, ResidualBasis, half_vectors

NOISE, TEXELS = 0.003, 60
BRUSHED = AnisotropicPhong(
    np.array([0.3, 0.2, 0.1]), np.array([0.2, 0.2, 0.3]), np.array([60.0, 15.0]), np.radians(25.0)
)


def brushed(rng, lights, lobe=BRUSHED, factor=1.0):
    """A lobe plus s . H seen from forty texels' own views, under forty lights."""
    light = np.repeat(lights[:, None], TEXELS, axis=1)
    view = lights[rng.integers(0, len(lights), (1, TEXELS))]
    value = lobe.evaluate(light.reshape(-1, 3), np.broadcast_to(view, light.shape).reshape(-1, 3)).reshape(light.shape)
    s = 0.03 * rng.normal(size=(TEXELS, 3, 3))
    value = value + np.einsum("dtk,tck->dtc", half_vectors(light, view), s) + NOISE * rng.normal(size=value.shape)
    variance = np.full(value.shape, (NOISE * factor) ** 2, np.float32)
    return Measurements((value * factor).astype(np.float32), variance, light, view)


def test_a_brushed_material_is_recovered_within_its_own_deviations(rng, hemisphere):
    fit = fit_anisotropic_beside_residual(brushed(rng, hemisphere))
    lobe = fit.lobe
    truth = [*BRUSHED.diffuse, *BRUSHED.specular, *BRUSHED.exponents, BRUSHED.turn_rad]
    found = [*lobe.diffuse, *lobe.specular, *lobe.exponents, lobe.turn_rad]
    off = np.subtract(found, truth) / np.sqrt(np.diag(fit.covariance))
    # Nine errors in units of their deviation: beyond 4.5 is one case in ten thousand.
    assert np.abs(off).max() < 4.5
    assert fit.status == FitStatus.CONVERGED


def test_turned_by_a_quarter_it_is_the_same_lobe(rng, hemisphere):
    """Which exponent is called the first does not depend on how the sample lies."""
    across = AnisotropicPhong(BRUSHED.diffuse, BRUSHED.specular, BRUSHED.exponents[::-1], BRUSHED.turn_rad - np.pi / 2)
    here, there = (
        fit_anisotropic_beside_residual(brushed(np.random.default_rng(5), hemisphere, lobe))
        for lobe in (BRUSHED, across)
    )
    np.testing.assert_allclose(there.lobe.exponents, here.lobe.exponents, rtol=1e-3)
    np.testing.assert_allclose(there.lobe.turn_rad, here.lobe.turn_rad, atol=1e-3)


def test_absent_anisotropy_is_a_round_lobe(rng, hemisphere):
    fit = fit_anisotropic_beside_residual(brushed(rng, hemisphere, BlinnPhong(BRUSHED.diffuse, BRUSHED.specular, 30.0)))
    assert isinstance(fit.lobe, BlinnPhong)
    assert fit.gain < 25  # chance: chi-squared of two, beyond 25 once in 300 000
    np.testing.assert_allclose(fit.lobe.exponent, 30.0, rtol=0.05)


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_any_unit_gives_the_same_lobe(hemisphere, factor):
    here, there = (
        fit_anisotropic_beside_residual(brushed(np.random.default_rng(6), hemisphere, factor=one))
        for one in (1.0, factor)
    )
    np.testing.assert_allclose(there.lobe.exponents, here.lobe.exponents, rtol=1e-3)
    np.testing.assert_allclose(there.lobe.specular / factor, here.lobe.specular, rtol=1e-3)


def test_black_and_missing_have_no_anisotropy(rng, hemisphere):
    measured = brushed(rng, hemisphere)
    for value in (np.zeros_like(measured.value), np.full_like(measured.value, np.nan)):
        fit = fit_anisotropic_beside_residual(Measurements(value, measured.variance, measured.light, measured.view))
        assert isinstance(fit.lobe, BlinnPhong)
        assert fit.status in (FitStatus.AT_BOUND, FitStatus.TOO_FEW_SAMPLES)


@pytest.mark.parametrize("shape", [(3.0, 0.0, 0.0), (3.0, 1e-5, -2e-5), (2.5, 0.4, -0.7)])
def test_slopes_are_those_of_the_lobe(rng, hemisphere, shape):
    geometry = SampleGeometry.of(brushed(rng, hemisphere), ResidualBasis.HALF)
    shapes, shape = DrawnShapes([(0.0, 9.0)] * 3), np.array(shape)
    slopes = shapes.columns(geometry, shape)[:, 2:]
    for axis in range(3):
        step = 1e-5 * np.eye(3)[axis]
        ahead, behind = (shapes.columns(geometry, shape + sign * step)[:, 1] for sign in (1, -1))
        np.testing.assert_allclose(slopes[:, axis], (ahead - behind) / 2e-5, atol=1e-6)
