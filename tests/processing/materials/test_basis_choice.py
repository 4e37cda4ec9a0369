import numpy as np
import pytest

from processing.errors import ImageError
from processing.materials.basis_choice import choose_basis
from processing.materials.measurements import Measurements
from processing.products import BlinnPhong, ResidualBasis, half_vectors

LOBE = BlinnPhong(np.array([0.3, 0.2, 0.1]), np.array([0.2, 0.2, 0.3]), 40.0)
TEXELS, NOISE = 80, 0.003


def material(rng, lights, basis):
    """A lobe plus a residual of a basis, under forty lights and from straight above."""
    light, view = lights[:, None], np.array([[[0.0, 0.0, 1.0]]])
    functions = basis.evaluate(lights, np.broadcast_to(view[0], lights.shape))
    weights = 0.05 * rng.normal(size=(TEXELS, 3, basis.size))
    value = LOBE.evaluate(lights, view[0])[:, None] + np.einsum("dk,tck->dtc", functions, weights)
    value += NOISE * rng.normal(size=value.shape)
    return Measurements(value.astype(np.float32), np.full(value.shape, NOISE**2, np.float32), light, view)


@pytest.mark.parametrize("basis", [ResidualBasis.HALF, ResidualBasis.BIQUADRATIC, ResidualBasis.HEMISPHERICAL])
def test_the_basis_that_made_a_material_is_chosen(rng, hemisphere, basis):
    choice = choose_basis(material(rng, hemisphere, basis))
    assert choice.basis == basis
    assert set(choice.errors) == set(ResidualBasis)
    # Noise, and what up to nine unknowns from thirty directions add to it at the ten others, most at the margin.
    assert choice.errors[basis] < 4 * NOISE**2
    assert choice.errors[basis] > 0.9 * NOISE**2


def test_the_smaller_of_two_that_are_as_good_is_chosen(rng, hemisphere):
    """H is a part of the larger basis."""
    choice = choose_basis(
        material(rng, hemisphere, ResidualBasis.HALF), LOBE, (ResidualBasis.HALF_LIGHT, ResidualBasis.HALF)
    )
    assert choice.basis == ResidualBasis.HALF


def test_order_of_directions_hardly_matters(rng, hemisphere):
    measured = material(rng, hemisphere, ResidualBasis.HALF)
    turned = measured.directions(rng.permutation(len(hemisphere)))
    assert choose_basis(turned, LOBE).basis == choose_basis(measured, LOBE).basis == ResidualBasis.HALF


def test_what_cannot_tell_the_bases_apart_is_refused(rng, hemisphere):
    measured = material(rng, hemisphere, ResidualBasis.HALF)
    with pytest.raises(ImageError, match="3 directions"):
        choose_basis(measured.directions(slice(0, 3)))
    nothing = Measurements(np.full_like(measured.value, np.nan), measured.variance, measured.light, measured.view)
    with pytest.raises(ImageError, match="no sample"):
        choose_basis(nothing)


def test_half_vectors_are_seen_from_above(hemisphere):
    """The materials of these tests have H over the whole upper cap, so that no basis is singular."""
    half = half_vectors(hemisphere, np.array([0.0, 0.0, 1.0]))
    assert np.linalg.svd(half, compute_uv=False)[2] > 1


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_any_unit_gives_the_same_choice(rng, hemisphere, factor):
    measured = material(rng, hemisphere, ResidualBasis.HALF)
    scaled = Measurements(
        (measured.value * factor).astype(np.float32),
        (measured.variance * factor**2).astype(np.float32),
        measured.light,
        measured.view,
    )
    bases = (ResidualBasis.HALF, ResidualBasis.HALF_LIGHT)
    here, there = (choose_basis(one, None, bases) for one in (measured, scaled))
    assert there.basis == here.basis
    np.testing.assert_allclose([there.errors[b] / factor**2 for b in bases], [here.errors[b] for b in bases], rtol=1e-3)
