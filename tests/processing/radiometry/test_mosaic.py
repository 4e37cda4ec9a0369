"""Sensor model, demosaicing, display."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.radiometry.display import srgb8, tonemap
from processing.radiometry.mosaic import cfa_channels, demosaic, grey_mosaic, white_balance
from processing.radiometry.sensor import Sensor

quick = settings(max_examples=30, deadline=None)
PATTERNS = [[[0, 1], [1, 2]], [[2, 1], [1, 0]], [[1, 0], [2, 1]], [[1, 2], [0, 1]]]
patterns = st.sampled_from(PATTERNS).map(lambda p: np.array(p, np.uint8))


@quick
@given(st.floats(0, 2000), st.floats(100, 60000), st.floats(0.01, 50), st.floats(0, 100))
def test_a_noise_profile_says_gain_and_read_noise(black, span, gain, read_noise):
    slope, offset = 1 / (gain * span), (read_noise / gain / span) ** 2
    sensor = Sensor.from_noise_profile(black, black + span, slope, offset)
    assert sensor.gain_e_per_dn == pytest.approx(gain)
    assert sensor.read_noise_e == pytest.approx(read_noise, abs=1e-9)
    assert not sensor.assumed


def test_rounding_adds_a_twelfth_of_a_count():
    assert Sensor(0, 100, 6, 0).dark_variance_e2 == pytest.approx(3)
    assert Sensor(10, 110, 2, 0).saturation_e == pytest.approx(199)


@pytest.mark.parametrize("numbers", [(100, 100, 1, 1), (0, 100, 0, 1), (0, np.nan, 1, 1)])
def test_what_is_no_sensor_is_refused(numbers):
    with pytest.raises(ImageError):
        Sensor(*numbers)
    with pytest.raises(ImageError):
        Sensor.from_noise_profile(0, 100, 0, 1)


@quick
@given(patterns, st.integers(2, 9), st.integers(2, 9), st.floats(-5, 5), st.floats(-1, 1), st.floats(-1, 1))
def test_demosaicing_a_plane_gives_the_plane(cfa, height, width, level, across, down):
    """Bilinear interpolation is exact on linear images, away from the border where neighbours lack."""
    rows, columns = np.indices((height, width))
    plane = level + across * columns + down * rows
    image, variance = demosaic(plane, np.ones_like(plane), cfa)
    np.testing.assert_allclose(image[1:-1, 1:-1], plane[1:-1, 1:-1, None] * np.ones(3), atol=1e-5)
    assert (variance <= 1 + 1e-6).all()
    own = np.take_along_axis(image, cfa_channels(cfa, plane.shape)[..., None].astype(int), -1)[..., 0]
    np.testing.assert_allclose(own, plane, rtol=1e-6, atol=1e-6)


def test_missing_samples_are_filled_from_neighbours_of_their_colour():
    mosaic = np.full((6, 6), 2.0)
    mosaic[2, 2] = np.nan  # red; its red neighbours are two pixels away
    mosaic[3, 2] = np.nan  # green; has green neighbours diagonally, none of the four beside it
    image, variance = demosaic(mosaic, np.ones((6, 6)), np.array(PATTERNS[0], np.uint8))
    assert np.isnan(image[2, 2, 0])
    assert np.isnan(variance[2, 2, 0])
    assert image[2, 3, 0] == 2
    assert image[2, 2, 1] == 2


def test_demosaiced_variance_is_that_of_the_mean():
    _, variance = demosaic(np.ones((8, 8)), np.ones((8, 8)), np.array(PATTERNS[0], np.uint8))
    np.testing.assert_allclose(variance[2, 2], [1, 1 / 4, 1 / 4])  # on red: itself, four greens, four blues
    np.testing.assert_allclose(variance[2, 3], [1 / 2, 1, 1 / 2])  # on green: two reds, itself, two blues


@pytest.mark.parametrize(
    ("mosaic", "cfa"), [((4, 4, 3), [[0, 1], [1, 2]]), ((4, 5), [[0, 1], [1, 3]]), ((4, 5), [0, 1, 1, 2])]
)
def test_what_is_no_mosaic_is_refused(mosaic, cfa):
    with pytest.raises(ImageError):
        demosaic(np.zeros(mosaic), np.zeros(mosaic), np.array(cfa, np.uint8))


@quick
@given(patterns, st.lists(st.floats(0.1, 10), min_size=3, max_size=3))
def test_a_grey_scene_through_coloured_filters_is_grey(cfa, filters):
    scene = np.random.default_rng(0).uniform(1, 2, (40, 40)).round(1)
    scene[10:30, 10:30] = 2.0  # what is brightest is as bright in all channels
    mosaic = scene * np.array(filters)[cfa_channels(cfa, scene.shape)]
    np.testing.assert_allclose(grey_mosaic(mosaic, cfa), scene / 2, rtol=1e-9)
    for dark in (mosaic * 0, mosaic * np.nan):
        with pytest.raises(ImageError, match="light"):
            grey_mosaic(dark, cfa)


def test_white_balance_keeps_green():
    image, variance = white_balance(np.ones((2, 2, 3)), np.ones((2, 2, 3)), np.array([4.0, 2.0, 1.0]))
    np.testing.assert_allclose(image[0, 0], [2, 1, 0.5])
    np.testing.assert_allclose(variance[0, 0], [4, 1, 0.25])


def test_srgb_codes():
    """The standard's own points: black, white, the end of the straight part, and 0.21586 = code 128."""
    values = np.array([-1, 0, 0.0031308, 0.21586, 1, 7, np.nan, np.inf])
    np.testing.assert_array_equal(srgb8(values), [0, 0, 10, 128, 255, 255, 0, 255])


@quick
@given(st.floats(1e-6, 1e6))
def test_a_tone_mapped_picture_does_not_depend_on_the_unit(scale):
    image = np.random.default_rng(0).lognormal(size=(8, 9, 3))
    difference = np.abs(tonemap(image * scale).astype(int) - tonemap(image))
    assert difference.max() <= 1  # rounding of a code


def test_tone_mapping_keeps_order_and_marks_what_is_not_known():
    image = np.geomspace(1e-3, 1e4, 64).reshape(8, 8)
    assert (np.diff(tonemap(image).ravel().astype(int)) >= 0).all()
    image = np.stack([image] * 3, -1)
    image[0, 0], image[0, 1] = np.inf, np.nan
    picture = tonemap(image)
    assert picture[0, 0].tolist() == [255] * 3
    assert picture[0, 1].tolist() == [0] * 3
    assert not tonemap(np.zeros((3, 3, 3))).any()
    assert (tonemap(np.full((3, 3, 3), np.inf)) == 255).all()
