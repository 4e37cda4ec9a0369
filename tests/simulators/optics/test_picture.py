"""The simulated camera of 8-bit pictures."""

import io

import numpy as np
import pytest
from PIL import Image

from simulators.picture import CURVES, PictureCamera, log_exposure


@pytest.mark.parametrize("name", CURVES)
def test_curves_rise_from_black_to_white(name):
    x = np.linspace(0, 1, 10_001)
    for channel in CURVES[name]:
        y = channel(x)
        assert (np.diff(y) > 0).all()
        np.testing.assert_allclose(y[[0, -1]], [0, 1], atol=1e-6)
    assert (np.diff(log_exposure(name)[1:], axis=0) > 0).all()


@pytest.mark.parametrize("name", CURVES)
def test_codes_of_an_even_wall_say_its_light(name):
    """Over many pixels the mean code is that of the true curve, within noise and rounding."""
    camera = PictureCamera(curve=name, sensitivity=1.0, f_number=1.0)
    light = np.exp(log_exposure(name))
    x128 = np.array([np.interp(128 / 255, c(x := np.linspace(0, 1, 100_001)), x) for c in CURVES[name]])
    codes = camera.develop(np.broadcast_to(light[90] * x128, (100, 100, 3)), 1.0, ("wall",))
    np.testing.assert_allclose(codes.mean(axis=(0, 1)), 90, atol=0.1)


def test_a_photograph_carries_its_exposure_and_the_same_key_gives_the_same_bits():
    camera = PictureCamera(iso=400, f_number=5.6)
    scene = np.random.default_rng(0).uniform(0, 3, (16, 24, 3))
    content = camera.photograph(scene, 1 / 60, ("a", 1))
    assert content == camera.photograph(scene, 1 / 60, ("a", 1))
    assert content != camera.photograph(scene, 1 / 60, ("a", 2))
    tags = Image.open(io.BytesIO(content)).getexif()
    exposure = tags.get_ifd(0x8769)
    assert (float(exposure[0x829A]), float(exposure[0x829D])) == pytest.approx((1 / 60, 5.6), rel=1e-6)
    assert exposure[0x8827] == 400
    assert tags[0x0110] == camera.model


def test_stops_are_interchangeable_but_for_noise():
    """Twice the time, twice the ISO and half the aperture's area bring the same picture back."""
    scene = np.full((64, 64, 3), 1.0)
    one = PictureCamera().develop(scene, 0.1, ("k",)).mean()
    other = PictureCamera(iso=200, f_number=8.0).develop(scene, 0.2, ("k",)).mean()
    assert one == pytest.approx(other, abs=0.2)
