import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from processing.materials.joint_lobe import fit_phong_beside_residual
from processing.materials.measurements import sphere_measurements
from processing.materials.phong import FitStatus
from processing.materials.srf import fit_phong, fit_srf
from processing.products import BlinnPhong, ReflectanceMaps, ResidualBasis

LOBE = BlinnPhong(np.array([0.3, 0.2, 0.1]), np.array([0.2, 0.2, 0.3]), 40.0)
SIZE, NOISE = 24, 0.003


def maps_of(value, directions, noise=NOISE):
    shape = (len(directions), SIZE, SIZE, 3)
    variance, distant = np.full(shape, noise**2, np.float32), np.full(len(directions), np.inf)
    return ReflectanceMaps(value.reshape(shape).astype(np.float32), variance, directions, distant, np.inf)


def exact_material(rng, directions, factor=1.0, lobe=LOBE):
    """Maps of the lobe plus s . H with an s that has a mean and changes slowly, and what they are without noise."""
    measured = sphere_measurements(maps_of(np.ones((len(directions), SIZE**2, 3)), directions))
    smooth = np.stack([gaussian_filter(rng.normal(size=(SIZE, SIZE)), 4) for _ in range(9)], axis=-1)
    s = 0.4 * smooth.reshape(-1, 3, 3) + np.array([0.02, 0.0, -0.05])
    clean = 1 - measured.delta(lobe)
    clean = np.where(measured.valid, clean + np.einsum("dtk,tck->dtc", measured.half, s), 0.0)
    noisy = clean + NOISE * rng.normal(size=clean.shape)
    return maps_of(noisy * factor, directions, NOISE * factor), clean


def reconstruction_error(maps, lobe, clean):
    """Of lobe and residual at all valid samples."""
    measured, fit = sphere_measurements(maps), fit_srf(maps, lobe)
    residual = fit.srf.residual.reshape(3, -1, 3)
    shown = measured.value - measured.delta(fit.srf.phong) + np.einsum("dtk,ctk->dtc", measured.half, residual)
    return (shown - clean)[measured.valid]


def lobe_of(maps, basis=ResidualBasis.HALF):
    return fit_phong_beside_residual(sphere_measurements(maps), basis).lobe


def test_lobe_and_residual_are_recovered_to_the_noise_bound(rng, arm_directions):
    """Two unknowns per texel and channel and seven of the lobe, from N samples: the mean square is (2 T + 7) / N."""
    maps, clean = exact_material(rng, arm_directions)
    error = reconstruction_error(maps, None, clean)
    bound = NOISE * np.sqrt((2 * SIZE**2 * 3 + 7) / error.size)
    # 3463 unknowns: their mean square is good to 2.4 %, its root to 1.2 %.
    assert np.sqrt(np.mean(error**2)) < 1.05 * bound


def test_a_lobe_fitted_alone_takes_the_residuals_mean_for_its_own(rng, arm_directions):
    """Why the joint fit is there: on the same material the other's error is a multiple of the bound."""
    maps, clean = exact_material(rng, arm_directions)
    alone = reconstruction_error(maps, fit_phong(sphere_measurements(maps)).phong, clean)
    assert np.mean(alone**2) > 4 * np.mean(reconstruction_error(maps, None, clean) ** 2)


def test_covariance_says_how_far_the_parameters_are_off(rng, arm_directions):
    truth = np.array([*LOBE.diffuse, *LOBE.specular, LOBE.exponent])
    normalised = []
    for _ in range(12):
        fit = lobe_of(exact_material(rng, arm_directions)[0])
        found = np.array([*fit.phong.diffuse, *fit.phong.specular, fit.phong.exponent])
        normalised.append((found - truth) / np.sqrt(np.diag(fit.covariance)))
    # 84 normalised errors, some correlated: their root mean square is 1 to within a third.
    assert 0.67 < np.sqrt(np.mean(np.square(normalised))) < 1.33


@pytest.mark.parametrize("basis", list(ResidualBasis))
def test_no_exponent_nearby_leaves_less_error(rng, arm_directions, basis):
    """Where a basis cannot follow s . H, channels count by what they leave over: the least sum of all is near."""
    maps, _ = exact_material(rng, arm_directions)
    fit = fit_srf(maps, None, basis)
    best = fit.srf.phong
    for factor in (0.9, 1.1):
        other = BlinnPhong(best.diffuse, best.specular, best.exponent * factor)
        assert fit_srf(maps, other, basis).mse_srf > fit.mse_srf


def test_what_a_basis_can_say_as_well_is_the_lobes(rng, arm_directions):
    """N.L is among the functions: k_d is not determined beside them, and must not be left to chance."""
    fit = fit_srf(exact_material(rng, arm_directions)[0], None, ResidualBasis.HALF_LIGHT)
    alone = fit_phong(sphere_measurements(exact_material(rng, arm_directions)[0])).phong
    np.testing.assert_allclose(fit.srf.phong.diffuse, alone.diffuse, atol=0.05)
    np.testing.assert_allclose(fit.srf.phong.exponent, 40.0, rtol=0.02)


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_any_unit_gives_the_same_lobe(arm_directions, factor):
    here = lobe_of(exact_material(np.random.default_rng(3), arm_directions)[0])
    there = lobe_of(exact_material(np.random.default_rng(3), arm_directions, factor)[0])
    np.testing.assert_allclose(there.phong.exponent, here.phong.exponent, rtol=1e-3)
    np.testing.assert_allclose(there.phong.diffuse / factor, here.phong.diffuse, rtol=1e-3)
    assert there.status == here.status == FitStatus.CONVERGED


def test_order_of_lights_does_not_matter(rng, arm_directions):
    maps, _ = exact_material(rng, arm_directions)
    turn = rng.permutation(12)
    turned = ReflectanceMaps(
        maps.reflectance_cos[turn], maps.variance[turn], arm_directions[turn], maps.light_distances, np.inf
    )
    np.testing.assert_allclose(lobe_of(turned).phong.exponent, lobe_of(maps).phong.exponent, rtol=1e-6)


def test_missing_and_black_materials_have_a_status(arm_directions):
    missing = fit_srf(maps_of(np.full((12, SIZE**2, 3), np.nan), arm_directions))
    assert missing.lobe.status == FitStatus.TOO_FEW_SAMPLES
    assert np.isnan(missing.srf.residual).all()
    black = fit_srf(maps_of(np.zeros((12, SIZE**2, 3)), arm_directions))
    assert (black.srf.phong.diffuse == 0).all()
    assert (black.srf.phong.specular == 0).all()
    assert black.lobe.status == FitStatus.AT_BOUND


def test_one_light_gives_a_finite_lobe(rng, arm_directions):
    """A residual per texel says all that one light shows: the lobe is whatever, but a number."""
    fit = fit_srf(exact_material(rng, arm_directions[:1])[0])
    assert np.isfinite([*fit.srf.phong.diffuse, *fit.srf.phong.specular, fit.srf.phong.exponent]).all()
    assert fit.lobe.status != FitStatus.CONVERGED


def test_a_mirror_like_lobe_stays_within_what_the_texels_resolve(rng, arm_directions):
    """n = 10000 has half its maximum at 0.7 deg, a texel of this map spans 5: told, finite, and no worse than none."""
    sharp = BlinnPhong(LOBE.diffuse, LOBE.specular, 1e4)
    maps, _ = exact_material(rng, arm_directions, lobe=sharp)
    fit = fit_srf(maps)
    assert 1 <= fit.srf.phong.exponent <= 1e5
    matt = fit_srf(maps, BlinnPhong(fit.srf.phong.diffuse, np.zeros(3), 1.0))
    assert fit.mse_srf <= matt.mse_srf * 1.0001


def test_saturated_highlights_that_are_marked_do_not_flatten_the_lobe(rng, arm_directions):
    maps, _ = exact_material(rng, arm_directions)
    value = maps.reflectance_cos.copy()
    value[value > 0.3] = np.nan
    assert 0.001 < np.isnan(value).mean() < 0.2
    found = lobe_of(maps_of(value, arm_directions)).phong
    np.testing.assert_allclose(found.exponent, 40.0, rtol=0.05)
    np.testing.assert_allclose(found.specular, LOBE.specular, rtol=0.05)
