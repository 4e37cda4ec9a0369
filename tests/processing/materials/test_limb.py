import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.materials.limb import find_sphere
from tests.reference.sphere import arm_lights, photograph

LIGHTS_DEG = (-60, -30, 30, 60)
DISTANCE = 22.0


def photographs(rng, *, centre=(101.3, 88.6), size=(180, 200), focal_px=1500.0, card=None, noise=0.002):
    albedo = texture(size, rng)
    clean = [
        photograph(light, size=size, centre=centre, focal_px=focal_px, distance=DISTANCE, albedo=albedo, card=card)
        for light in arm_lights(LIGHTS_DEG)
    ]
    return np.stack(clean) + noise * rng.normal(size=(len(clean), *size))


def texture(size, rng):
    """Marble: a smooth random field of albedos from 0.3 to 0.9."""
    spectrum = np.fft.rfft2(rng.normal(size=size))
    frequency = np.hypot(np.fft.fftfreq(size[0])[:, None], np.fft.rfftfreq(size[1])[None])
    field = np.fft.irfft2(spectrum * np.exp(-((frequency / 0.08) ** 2)), size)
    return (0.6 + 0.3 * np.tanh(field / field.std()))[..., None, None]


def radius_px(focal_px=1500.0):
    return focal_px / np.sqrt(DISTANCE**2 - 1)


def test_centre_and_radius_are_found_to_a_fraction_of_a_pixel(rng):
    sphere = find_sphere(photographs(rng))
    np.testing.assert_allclose(sphere.centre_px, (101.3, 88.6), atol=0.15)
    assert abs(sphere.radius_px - radius_px()) < 0.25


def test_the_error_is_what_sigma_says(rng):
    """Over several textures; the limb's last tenth of a pixel is a bias that texture does not average out."""
    errors = []
    for _ in range(6):
        sphere = find_sphere(photographs(rng))
        truth = np.array([101.3, 88.6, radius_px()])
        found = np.array([*sphere.centre_px, sphere.radius_px])
        errors.append((found - truth) / np.hypot(sphere.sigma_px, 0.1))
    assert np.sqrt(np.mean(np.square(errors))) < 2


def test_a_white_card_beside_the_sphere_does_not_disturb(rng):
    """A sixth of the sphere's area, twice as bright, a sixth of a radius away from the limb."""
    alone = find_sphere(photographs(rng))
    with_card = find_sphere(photographs(rng, card=(0.0, -1.3, 0.8, 0.24, 0.9)))
    np.testing.assert_allclose(with_card.centre_px, alone.centre_px, atol=0.25)
    assert abs(with_card.radius_px - alone.radius_px) < 0.25


def test_a_sphere_that_the_border_cuts_is_still_found(rng):
    sphere = find_sphere(photographs(rng, centre=(40.4, 88.6)))
    np.testing.assert_allclose(sphere.centre_px, (40.4, 88.6), atol=0.6)
    assert abs(sphere.radius_px - radius_px()) < 0.6


def test_missing_and_saturated_pixels_take_no_part(rng):
    images = photographs(rng)
    images[0, 60:90, 60:90] = np.nan
    images[:, ::17, ::13] = np.nan
    sphere = find_sphere(images)
    np.testing.assert_allclose(sphere.centre_px, (101.3, 88.6), atol=0.3)


@pytest.fixture(scope="module")
def images():
    return photographs(np.random.default_rng(1))


@settings(max_examples=8, deadline=None)
@given(st.floats(-6, 6), st.permutations(range(len(LIGHTS_DEG))))
def test_unit_of_the_radiance_and_order_of_the_lights_do_not_matter(images, decades, order):
    one, other = find_sphere(images), find_sphere(images[order] * 10**decades)
    np.testing.assert_allclose(other.centre_px, one.centre_px, atol=1e-6)
    assert other.radius_px == pytest.approx(one.radius_px, abs=1e-6)


@settings(max_examples=8, deadline=None)
@given(st.booleans(), st.booleans(), st.booleans())
def test_a_mirrored_or_turned_image_has_its_circle_there(images, upside_down, sideways, turned):
    """The rays start elsewhere and draw another sample of the same limb: to a fifth of sigma."""
    moved = images[:, :: -1 if upside_down else 1, :: -1 if sideways else 1]
    moved = moved.swapaxes(1, 2) if turned else moved
    one, other = find_sphere(images), find_sphere(moved)
    column, row = other.centre_px[::-1] if turned else other.centre_px
    height, width = images.shape[1:]
    there = (width - 1 - column if sideways else column, height - 1 - row if upside_down else row)
    np.testing.assert_allclose(there, one.centre_px, atol=0.2 * one.sigma_px[:2].max())
    assert other.radius_px == pytest.approx(one.radius_px, abs=0.2 * one.sigma_px[2])


@pytest.mark.parametrize(
    "images",
    [
        np.zeros((2, 60, 60)),
        np.full((2, 60, 60), np.nan),
        np.random.default_rng(0).normal(size=(2, 60, 60)),
        np.broadcast_to(np.arange(60) > 30, (1, 60, 60)).astype(float),
        np.zeros((60, 60)),
        np.zeros((0, 60, 60)),
    ],
    ids=["dark", "missing", "noise", "straight edge", "one image", "no light"],
)
def test_no_sphere_is_one_clear_error(images):
    with pytest.raises(ImageError):
        find_sphere(images)
