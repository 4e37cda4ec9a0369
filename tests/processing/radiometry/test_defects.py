"""Hot pixels of a merged mosaic, and what must not be taken for them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from processing.errors import ImageError
from processing.radiometry.defects import fill_hot_pixels, find_hot_pixels, without_hot_pixels
from processing.radiometry.hdr import PixelStatus, Radiance, merge_exposures
from processing.radiometry.mosaic import demosaic
from simulators.optics import Optics
from simulators.pose import Pose
from tests.processing.radiometry.test_hdr import EXPOSURE_S, SENSOR, photograph
from tests.reference import defects as twin

CFA = np.array([[0, 1], [1, 2]], np.uint8)
RESPONSE = np.array([[0.5, 1.0], [1.0, 0.6]])  # of a sensor's colours to white light
quick = settings(max_examples=40, deadline=None)


def through_filters(light):
    """A white scene (h, w) as the mosaic sees it."""
    rows, columns = np.indices(light.shape)
    return light * RESPONSE[rows % 2, columns % 2]


def merged(radiance, rng):
    return merge_exposures(photograph(radiance, EXPOSURE_S, rng), EXPOSURE_S, SENSOR)


def scattered(shape, rng, share=2e-3):
    """A mask of single pixels, none near another or the border."""
    mask = np.zeros(shape, bool)
    cells = rng.random((shape[0] // 8, shape[1] // 8)) < 64 * share
    mask[4::8, 4::8][: cells.shape[0], : cells.shape[1]] = cells
    return np.pad(np.roll(mask, rng.integers(-1, 2, 2), (0, 1))[4:-4, 4:-4], 4)


@pytest.mark.parametrize("level", [0.0, 30.0, 3000.0])
def test_hot_pixels_of_a_smooth_scene_are_found_and_filled(level):
    rng = np.random.default_rng(2)
    scene = through_filters(np.full((240, 320), level))
    hot = scattered(scene.shape, rng)
    mosaic = merged(scene + np.where(hot, 500 + level * 1.5 + rng.uniform(0, 2e4, hot.shape), 0), rng)
    np.testing.assert_array_equal(find_hot_pixels(mosaic), hot)
    clean = without_hot_pixels(mosaic)
    np.testing.assert_array_equal(clean.status == PixelStatus.HOT, hot)
    np.testing.assert_array_equal(np.isnan(clean.value), hot)
    filled = fill_hot_pixels(clean)
    image, variance = demosaic(filled.value, filled.variance, CFA)
    white = level * np.array([0.5, 1.0, 0.6])
    assert (np.abs(image - white) < 7 * np.sqrt(variance)).all()


def test_noise_gives_no_false_alarm():
    """Three million pixels from darkness to the white level: under 1e-6 of them, with 95 % certainty."""
    scene = through_filters(np.tile(np.geomspace(0.1, 4e5, 2000), (1500, 1)))
    assert not find_hot_pixels(merged(scene, np.random.default_rng(0))).any()


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(0, 2**32), st.floats(0.5, 2), st.floats(0.5, 8))
def test_what_a_lens_draws_is_kept(seed, blur_px, roughness):
    """Points, lines, edges, corners and grain of any contrast, as fine as a lens of half a pixel draws them."""
    rng = np.random.default_rng(seed)
    ideal = np.exp(roughness * rng.normal(size=(96, 96)) * (rng.random((96, 96)) < rng.uniform(0, 1)))
    corner = rng.integers(20, 76, 2)
    ideal[: corner[0], : corner[1]] *= 10 ** rng.uniform(-2, 2)
    ideal[rng.integers(0, 96, 40), rng.integers(0, 96, 40)] += 10 ** rng.uniform(0, 3, 40)
    scene = through_filters(gaussian_filter(ideal, blur_px, truncate=4))
    assert not find_hot_pixels(merged(scene * 3e5 / scene.max(), rng)).any()


@pytest.mark.parametrize("sample", ["brick", "charuco", "sphere", "mirror"])
def test_simulated_scenes_keep_their_detail(sample, tmp_path):
    """Edges, corners and glints of the rig's own scenes; the sensor's dark current is known as the truth."""
    optics = Optics(1, "small", tmp_path)
    rng = np.random.default_rng(3)
    for lamp, turn in (("lamp1", 0.0), ("lamp4", 1.0)):
        pose = Pose(sample, 0, turn, np.radians(70), 0.0, ((lamp, 1.0),), np.radians(50), False, None)
        scene, dark = optics.rate("cam3", pose), optics.sensor("cam3").dark_e_s
        assert not (find_hot_pixels(merged(scene, rng)) & (dark < 100)).any()


@quick
@given(st.integers(0, 2**32), st.integers(1, 30), st.integers(1, 30))
def test_kernel_equals_its_numpy_twin(seed, height, width):
    rng = np.random.default_rng(seed)
    value = rng.normal(0, 1, (height, width)).astype(np.float32)
    value[rng.random(value.shape) < 0.1] += 1e4
    value[rng.random(value.shape) < 0.05] = np.nan
    mosaic = Radiance(value, np.full(value.shape, 0.01, np.float32), np.zeros(value.shape, np.uint8))
    np.testing.assert_array_equal(find_hot_pixels(mosaic), twin.find_hot_pixels(value, mosaic.variance))


def test_what_lies_beside_saturation_is_not_judged():
    value = np.full((9, 9), 10, np.float32)
    value[4, 4] = 1e5
    dim = Radiance(value, np.ones_like(value), np.zeros(value.shape, np.uint8))
    assert find_hot_pixels(dim).sum() == 1
    dim.value[4, 5] = np.nan
    assert not find_hot_pixels(dim).any()


def test_hot_pixels_in_corners_and_beside_the_unknown_are_filled_from_what_is_known():
    value = np.full((6, 6), 2.0, np.float32)
    status = np.zeros(value.shape, np.uint8)
    for y, x in ((0, 0), (5, 5), (2, 2)):
        value[y, x], status[y, x] = np.nan, PixelStatus.HOT
    filled = fill_hot_pixels(Radiance(value, np.ones_like(value), status))
    np.testing.assert_array_equal(filled.value, 2)
    alone = fill_hot_pixels(Radiance(np.full((1, 1), np.nan, "f4"), np.ones((1, 1), "f4"), np.full((1, 1), 4, "u1")))
    assert np.isnan(alone.value).all()


@pytest.mark.parametrize("texture", [0, 0.02, 0.1])
def test_the_variance_of_a_guess_is_that_of_its_error(texture):
    """Equal in texture; where there is none, the spread of eight neighbours cannot tell it from noise."""
    rng = np.random.default_rng(0)
    truth = 1e4 * np.exp(texture * rng.normal(size=(300, 300)))
    mosaic = merged(truth, rng)
    hot = np.zeros(truth.shape, bool)
    hot[5::9, 5::9] = True
    mosaic.value[hot], mosaic.variance[hot], mosaic.status[hot] = np.nan, np.nan, PixelStatus.HOT
    filled = fill_hot_pixels(mosaic)
    ratio = filled.variance[hot].mean() / ((filled.value - truth)[hot] ** 2).mean()
    # 1100 pixels: a mean square is known to 4 % of itself, with texture's heavier tails to 5 %; five times that.
    assert (0.75 < ratio < 1.25) if texture else (1 < ratio < 5)


def test_without_hot_pixels_nothing_is_filled():
    plain = Radiance(np.ones((6, 6), np.float32), np.ones((6, 6), np.float32), np.zeros((6, 6), np.uint8))
    np.testing.assert_array_equal(fill_hot_pixels(plain).value, plain.value)


def test_a_colour_image_is_refused():
    three = np.zeros((8, 8, 3), np.float32)
    with pytest.raises(ImageError, match="mosaic"):
        find_hot_pixels(Radiance(three, three, three.astype(np.uint8)))
