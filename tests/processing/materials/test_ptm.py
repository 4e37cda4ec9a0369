"""Relightable images: the fast fit against numpy's own solver, and what it must not depend on."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.materials.ptm import (
    RANK_TOLERANCE,
    PtmStatus,
    as_lrgb,
    btf_pictures,
    display_values,
    fit_ptm,
    map_pictures,
    reproduction_db,
    stack_pictures,
)
from processing.products import Btf, LightStack, ReflectanceMaps, RelightableImage, ResidualBasis, sphere_normals
from processing.products.relightable_image import evaluate_basis, metric
from tests.reference.ptm import board, dome, least_squares

BASES = [ResidualBasis.BIQUADRATIC, ResidualBasis.HEMISPHERICAL]
LIGHTS = dome(20)
PICTURES = board(LIGHTS, (12, 16))
FLOATS = (PICTURES / np.float32(255)).astype(np.float32)


def over_peak(found, expected):
    return np.abs(found - expected).max() / np.abs(expected).max()


@pytest.mark.parametrize("basis", BASES)
@pytest.mark.parametrize("lights", [20, 24, 64])
def test_is_least_squares(basis, lights):
    """Of 8 and 16 bits and floats, whether or not the lights fill the kernel's groups of eight."""
    directions = dome(lights)
    pictures = board(directions, (12, 16))
    expected = least_squares(pictures / 255, evaluate_basis(basis, directions), RANK_TOLERANCE)
    for values in (pictures, pictures.astype(np.uint16) * 257, (pictures / np.float32(255)).astype(np.float32)):
        fit = fit_ptm(values, directions, basis)
        assert over_peak(fit.image.coefficients, expected) < 1e-6
        assert (fit.status == PtmStatus.FITTED).all()
        assert fit.rank == basis.size


@pytest.mark.parametrize("basis", BASES)
def test_missing_lights_are_left_out(basis):
    """Pixels that lack some lights are solved from the others, and say when these are too few."""
    values = FLOATS.copy()
    values[np.random.default_rng(3).random(values.shape) < 0.3] = np.nan
    values[3, 0, 0] = np.inf
    values[:, 2:4] = np.nan
    values[4:, 5] = np.nan
    fit = fit_ptm(values, LIGHTS, basis)
    usable = np.where(np.isfinite(values), values, np.nan)
    expected = least_squares(usable, evaluate_basis(basis, LIGHTS), RANK_TOLERANCE)
    assert over_peak(fit.image.coefficients, expected) < 1e-5  # squared condition of the few lights that are left
    assert (fit.status[2:4] == PtmStatus.NO_VALUES).all()
    assert not fit.image.coefficients[:, 2:4].any()
    assert (fit.status[5] >= PtmStatus.TOO_FEW).all()


@settings(max_examples=20, deadline=None)
@given(st.floats(1e-6, 1e6), st.permutations(range(len(LIGHTS))))
def test_scale_and_order_do_not_matter(factor, order):
    image = fit_ptm(FLOATS, LIGHTS).image.coefficients
    scaled = fit_ptm((FLOATS * np.float32(factor)).astype(np.float32), LIGHTS).image.coefficients
    assert over_peak(scaled / np.float32(factor), image) < 1e-6
    shuffled = fit_ptm(np.ascontiguousarray(FLOATS[order]), LIGHTS[order]).image.coefficients
    assert over_peak(shuffled, image) < 2e-6  # both are off by up to 1e-6


def test_lights_of_one_arc_leave_the_shortest_solution():
    """Coplanar lights say nothing about the other direction: nothing is made up there."""
    angles = np.deg2rad([-60, -50, -40, -30, -20, -10, 10, 20, 30, 40, 50, 60])
    arc = np.stack([np.sin(angles), np.zeros(12), np.cos(angles)], axis=-1)
    fit = fit_ptm(board(arc, (8, 9)), arc)
    assert fit.rank == 3
    assert (fit.status == PtmStatus.RANK_DEFICIENT).all()
    about_y = [index for index, name in enumerate(ResidualBasis.BIQUADRATIC.names) if "b" in name]
    assert np.abs(fit.image.coefficients[about_y]).max() < 1e-6
    assert reproduction_db(fit.image, board(arc, (8, 9)), arc) > 20


def test_one_light_is_too_few_and_finite():
    fit = fit_ptm(PICTURES[:1], LIGHTS[:1])
    assert (fit.status == PtmStatus.TOO_FEW).all()
    np.testing.assert_allclose(fit.image.evaluate(LIGHTS[0]), PICTURES[0] / 255, atol=1e-6)


def test_black_pictures_are_black():
    fit = fit_ptm(np.zeros_like(PICTURES), LIGHTS)
    assert not fit.image.coefficients.any()
    assert reproduction_db(fit.image, np.zeros_like(PICTURES), LIGHTS) == np.inf


def test_reproduces_what_is_exactly_of_its_kind():
    coefficients = np.random.default_rng(0).normal(size=(6, 5, 4, 3)).astype(np.float32)
    image = RelightableImage(coefficients, ResidualBasis.BIQUADRATIC)
    values = np.stack([image.evaluate(light) for light in LIGHTS])
    assert over_peak(fit_ptm(values, LIGHTS).image.coefficients, coefficients) < 1e-5


def test_colour_times_luminance_is_the_nearest():
    """Exact where the colour does not change with the light, else no other colour of the pixel comes nearer."""
    rng = np.random.default_rng(1)
    image = fit_ptm(PICTURES, LIGHTS).image
    separate = as_lrgb(image)
    assert separate.colour.max() == 1
    assert as_lrgb(separate) is separate
    joint = separate.coefficients * separate.colour
    again = as_lrgb(RelightableImage(joint, image.basis, lights=LIGHTS))
    np.testing.assert_allclose(again.coefficients * again.colour, joint, atol=1e-5)

    def distances(colour):
        unit = colour / np.linalg.norm(colour, axis=-1, keepdims=True)
        luminance = np.einsum("yxc,kyxc->kyx", unit, image.coefficients)[..., None]
        error = image.coefficients - luminance * unit
        return np.einsum("kyxc,kl,lyxc->yx", error, metric(image.basis, LIGHTS), error)

    for _ in range(5):
        other = np.abs(separate.colour + rng.normal(0, 0.05, separate.colour.shape))
        assert (distances(separate.colour) <= distances(other) + 1e-7).all()


def test_stack_and_btf_give_the_same_pictures_of_the_same_thing():
    """A BTF holds no cosine, a stack does; the view nearest the normal is taken."""
    linear = np.random.default_rng(2).uniform(0.01, 0.3, (len(LIGHTS), 4, 5, 3)).astype(np.float32)
    linear[0, 0, 0] = np.nan
    stack = LightStack(linear, np.ones_like(linear), LIGHTS, np.full(len(LIGHTS), np.inf), 1e-3)
    no_cosine = linear / LIGHTS[:, 2, None, None, None].astype(np.float32)
    views = np.array([[0.6, 0, 0.8], [0, 0.1, np.sqrt(0.99)], [0, -0.8, 0.6]])
    reflectance = np.stack([np.zeros_like(no_cosine), no_cosine, np.ones_like(no_cosine)], axis=1)
    values, lights = stack_pictures(stack)
    of_btf, btf_lights = btf_pictures(Btf(reflectance, LIGHTS, views))
    np.testing.assert_allclose(of_btf, values, rtol=1e-5)
    np.testing.assert_array_equal(btf_lights, lights)
    assert np.isnan(values[0, 0, 0]).all()
    assert (values[np.isfinite(values)] < 0.9999).mean() == pytest.approx(0.995, abs=0.003)


def test_a_sphere_is_seen_as_its_camera_sees_it():
    """A matt sphere's picture is its cosine, y up: light from above brightens the upper rows."""
    size = 40
    lights = LIGHTS * [1, -1, -1]  # of the sphere's frame
    cosine = np.maximum(sphere_normals(size) @ lights.T, 0)  # (q, p, light)
    maps = np.repeat(np.moveaxis(cosine, -1, 0)[..., None], 3, axis=-1).astype(np.float32)
    values, directions = map_pictures(
        ReflectanceMaps(maps, np.ones_like(maps), lights, np.full(len(lights), np.inf), np.inf)
    )
    np.testing.assert_allclose(directions, LIGHTS)
    x, y = np.meshgrid(*[((np.arange(size) + 0.5) * 2 / size - 1) * np.sqrt(0.5)] * 2)
    normal = np.stack([x, -y, np.sqrt(1 - x * x - y * y)], axis=-1)
    seen = np.isfinite(values[0, ..., 0])
    assert seen.mean() > 0.8
    expected = display_values(np.maximum(np.moveaxis(normal @ LIGHTS.T, -1, 0), 0)[..., None].astype(np.float32))
    ratio = values[:, seen, 0] / np.maximum(expected[:, seen, 0], 0.05)
    well_lit = expected[:, seen, 0] > 0.4
    off = np.abs(ratio[well_lit] / np.median(ratio[well_lit]) - 1)
    assert np.percentile(off, 95) < 0.005
    assert off.max() < 0.05  # beyond the outermost texel's centre its value goes on
    picture = fit_ptm(values, directions).image.evaluate(np.array([0.0, 0.8, 0.6]))
    assert np.nanmean(picture[5:15]) > 1.3 * np.nanmean(picture[25:35])


def test_display_values_of_any_scale():
    np.testing.assert_allclose(display_values(FLOATS * np.float32(1e-6)), display_values(FLOATS), atol=1e-5)
    assert not display_values(np.zeros((1, 2, 2, 3), np.float32)).any()


@pytest.mark.parametrize(
    ("values", "lights"), [(PICTURES[:, :, :, :1], LIGHTS), (PICTURES[1:], LIGHTS), (PICTURES.astype(float), LIGHTS)]
)
def test_what_does_not_fit_is_refused(values, lights):
    with pytest.raises(ImageError):
        fit_ptm(values, lights)


def test_bases_of_the_view_are_refused():
    with pytest.raises(ImageError, match="half"):
        RelightableImage(np.zeros((3, 2, 2, 3), np.float32), ResidualBasis.HALF)
