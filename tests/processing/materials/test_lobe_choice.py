import numba
import numpy as np
import pytest

from processing.materials.lobe_choice import choose_lobe
from processing.materials.measurements import Measurements, sphere_measurements
from processing.materials.srf import fit_srf
from processing.products import AnisotropicPhong, BlinnPhong, ReflectanceMaps, ResidualBasis

SIZE, NOISE = 16, 0.003
DIFFUSE, SPECULAR = np.array([0.3, 0.2, 0.1]), np.array([0.2, 0.2, 0.3])
BRUSHED = AnisotropicPhong(DIFFUSE, SPECULAR, np.array([60.0, 15.0]), np.radians(25.0))


def sphere_of(rng, lights, lobes, factor=1.0):
    """Maps of a sphere: the sum of the lobes, and s . H."""
    shape, distant = (len(lights), SIZE, SIZE, 3), np.full(len(lights), np.inf)
    variance, directions = np.full(shape, (NOISE * factor) ** 2, np.float32), lights * (1, 1, -1)
    empty = sphere_measurements(ReflectanceMaps(np.zeros(shape, np.float32), variance, directions, distant, np.inf))
    value = np.einsum("dtk,tck->dtc", empty.half, 0.03 * rng.normal(size=(SIZE**2, 3, 3)))
    value = value - sum(empty.delta(lobe) for lobe in lobes) + NOISE * rng.normal(size=value.shape)
    return ReflectanceMaps((factor * value).reshape(shape).astype(np.float32), variance, directions, distant, np.inf)


@pytest.mark.parametrize("factor", [1e-6, 1.0, 1e6])
def test_a_brushed_sphere_gets_its_anisotropic_lobe(rng, hemisphere, factor):
    maps = sphere_of(rng, hemisphere, [BRUSHED], factor)
    choice = choose_lobe(sphere_measurements(maps), ResidualBasis.HALF)
    np.testing.assert_allclose(choice.lobe.exponents, BRUSHED.exponents, rtol=0.02)
    assert choice.error < 0.1 * choice.round_error
    assert fit_srf(maps, choice.lobe).mse_srf < 0.1 * fit_srf(maps).mse_srf


def test_what_is_round_stays_round_also_where_one_lobe_cannot_follow_it(rng, hemisphere):
    """A haze about a highlight: no lobe of one exponent has that, and a drawn-out one is no better."""
    haze, highlight = (BlinnPhong(DIFFUSE / 2, SPECULAR / 2, exponent) for exponent in (8.0, 150.0))
    for lobes in ([haze], [haze, highlight]):
        maps = sphere_of(rng, hemisphere, lobes)
        assert choose_lobe(sphere_measurements(maps), ResidualBasis.HALF).lobe is None


def test_black_has_no_lobe_to_draw_out(rng, hemisphere):
    measured = sphere_measurements(sphere_of(rng, hemisphere, [BRUSHED]))
    black = Measurements(np.zeros_like(measured.value), measured.variance, measured.light, measured.view)
    choice = choose_lobe(black, ResidualBasis.HALF)
    assert choice.lobe is None
    assert np.isnan([choice.error, choice.round_error]).all()


def test_saturated_highlights_that_are_marked_do_not_hide_it(rng, hemisphere):
    measured = sphere_measurements(sphere_of(rng, hemisphere, [BRUSHED]))
    value = np.where(measured.value > 0.4, np.nan, measured.value)
    assert 1e-3 < np.isnan(value).mean() < 0.2
    choice = choose_lobe(Measurements(value, measured.variance, measured.light, measured.view), ResidualBasis.HALF)
    np.testing.assert_allclose(choice.lobe.exponents, BRUSHED.exponents, rtol=0.05)


@pytest.mark.parametrize("basis", [ResidualBasis.HALF, ResidualBasis.HEMISPHERICAL])
def test_the_number_of_threads_changes_no_bit(rng, hemisphere, basis):
    maps, threads = sphere_of(rng, hemisphere, [BRUSHED]), numba.get_num_threads()
    shared = fit_srf(maps, None, basis)
    numba.set_num_threads(1)
    try:
        alone = fit_srf(maps, None, basis)
    finally:
        numba.set_num_threads(threads)
    assert alone.srf.phong.as_dict() == shared.srf.phong.as_dict()
    np.testing.assert_array_equal(alone.srf.residual, shared.srf.residual)
