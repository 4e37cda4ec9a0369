import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from processing.joint_lobe import fit_phong_beside_residual
from processing.measurements import sphere_measurements
from processing.phong import FitStatus
from processing.products import BlinnPhong, ReflectanceMaps
from processing.residual import fit_residual, left_over
from processing.srf import fit_phong, fit_srf

LOBE = BlinnPhong(np.array([0.3, 0.2, 0.1]), np.array([0.2, 0.2, 0.3]), 40.0)
SIZE, NOISE = 32, 0.003


def maps_of(value, directions, noise=NOISE):
    shape = (len(directions), SIZE, SIZE, 3)
    variance, distant = np.full(shape, noise**2, np.float32), np.full(len(directions), np.inf)
    return ReflectanceMaps(value.reshape(shape).astype(np.float32), variance, directions, distant, np.inf)


def exact_material(rng, directions, factor=1.0):
    """Maps of the lobe plus s . H with an s that has a mean and changes slowly, and what they are without noise."""
    measured = sphere_measurements(maps_of(np.ones((len(directions), SIZE**2, 3)), directions))
    smooth = np.stack([gaussian_filter(rng.normal(size=(SIZE, SIZE)), 4) for _ in range(9)], axis=-1)
    s = 0.4 * smooth.reshape(-1, 3, 3) + np.array([0.02, 0.0, -0.05])
    clean = LOBE.evaluate_cosines(measured.cos_light, measured.cos_half)
    clean = np.where(measured.valid, clean + np.einsum("dtk,tck->dtc", measured.half, s), 0.0)
    noisy = clean + NOISE * rng.normal(size=clean.shape)
    return maps_of(noisy * factor, directions, NOISE * factor), clean


def reconstruction_error(maps, lobe, clean):
    measured = sphere_measurements(maps)
    delta, valid = measured.delta(lobe), measured.valid
    fit = fit_residual(delta, measured.half, valid.astype(float))
    return (measured.value - left_over(delta, measured.half, fit) - clean)[valid]


def test_lobe_and_residual_are_recovered_to_the_noise_bound(rng, arm_directions):
    """Two unknowns per texel and channel and seven of the lobe, from N samples: the mean square is (2 T + 7) / N."""
    maps, clean = exact_material(rng, arm_directions)
    error = reconstruction_error(maps, fit_phong_beside_residual(sphere_measurements(maps)).phong, clean)
    bound = NOISE * np.sqrt((2 * SIZE**2 * 3 + 7) / error.size)
    # 6151 unknowns: their mean square is good to 2 %, its root to 1 %.
    assert np.sqrt(np.mean(error**2)) < 1.04 * bound


def test_a_lobe_fitted_alone_takes_the_residuals_mean_for_its_own(rng, arm_directions):
    """Why the joint fit is there: on the same material the other's error is a multiple of the bound."""
    maps, clean = exact_material(rng, arm_directions)
    measured = sphere_measurements(maps)
    alone = reconstruction_error(maps, fit_phong(measured).phong, clean)
    joint = reconstruction_error(maps, fit_phong_beside_residual(measured).phong, clean)
    assert np.mean(alone**2) > 4 * np.mean(joint**2)


def test_covariance_says_how_far_the_parameters_are_off(rng, arm_directions):
    truth = np.array([*LOBE.diffuse, *LOBE.specular, LOBE.exponent])
    normalised = []
    for _ in range(6):
        maps, _ = exact_material(rng, arm_directions)
        fit = fit_phong_beside_residual(sphere_measurements(maps))
        found = np.array([*fit.phong.diffuse, *fit.phong.specular, fit.phong.exponent])
        normalised.append((found - truth) / np.sqrt(np.diag(fit.covariance)))
    # 42 normalised errors, some correlated: their root mean square is 1 to within a third.
    assert 0.6 < np.sqrt(np.mean(np.square(normalised))) < 1.4


def test_no_exponent_nearby_leaves_less_error(rng, arm_directions):
    maps, _ = exact_material(rng, arm_directions)
    best = fit_phong_beside_residual(sphere_measurements(maps)).phong
    least = fit_srf(maps, best).mse_srf
    for factor in (0.98, 1.02):
        other = BlinnPhong(best.diffuse, best.specular, best.exponent * factor)
        assert fit_srf(maps, other).mse_srf > least


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_any_unit_gives_the_same_lobe(arm_directions, factor):
    here = fit_phong_beside_residual(sphere_measurements(exact_material(np.random.default_rng(3), arm_directions)[0]))
    maps, _ = exact_material(np.random.default_rng(3), arm_directions, factor)
    there = fit_phong_beside_residual(sphere_measurements(maps))
    np.testing.assert_allclose(there.phong.exponent, here.phong.exponent, rtol=1e-3)
    np.testing.assert_allclose(there.phong.diffuse / factor, here.phong.diffuse, rtol=1e-3)
    assert there.status == here.status == FitStatus.CONVERGED


def test_missing_and_black_materials_have_a_status(arm_directions):
    missing = maps_of(np.full((12, SIZE**2, 3), np.nan), arm_directions)
    fit = fit_phong_beside_residual(sphere_measurements(missing))
    assert fit.status == FitStatus.TOO_FEW_SAMPLES
    black = fit_phong_beside_residual(sphere_measurements(maps_of(np.zeros((12, SIZE**2, 3)), arm_directions)))
    assert (black.phong.diffuse == 0).all()
    assert (black.phong.specular == 0).all()
    assert black.status == FitStatus.AT_BOUND
