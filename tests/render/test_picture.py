"""Linear radiance becomes display values in one place."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from render.picture import Picture, contact_sheet, encode_srgb8, exposure_for, save_animation, save_image


def uniform(radiance: float, coverage: float = 1.0, size: int = 4) -> Picture:
    """A picture of one premultiplied value."""
    return Picture(
        np.full((size, size, 3), radiance, dtype=np.float32), np.full((size, size), coverage, dtype=np.float32)
    )


def test_srgb_encoding_of_known_values():
    """IEC 61966-2-1: the middle grey 18 % is 118, the linear piece ends at 0.0031308."""
    linear = np.array([-1.0, 0.0, 0.0031308, 0.18, 0.5, 1.0, 7.0])
    np.testing.assert_array_equal(encode_srgb8(linear), [0, 0, 10, 118, 188, 255, 255])


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(0.0, 50.0), min_size=2, max_size=20))
def test_brighter_stays_brighter_on_the_display(values):
    ordered = np.sort(values)
    shown = [int(uniform(value).srgb8(1.0)[0, 0, 0]) for value in ordered]
    assert shown == sorted(shown)


def test_below_the_shoulder_the_display_is_linear():
    np.testing.assert_array_equal(uniform(0.4).srgb8(1.5)[0, 0], encode_srgb8(np.full(3, 0.6)))


def test_half_covered_pixel_is_half_object_half_backdrop():
    covered, empty = uniform(0.5).srgb8(1.0), uniform(0.0, 0.0).srgb8(1.0)
    half = uniform(0.25, 0.5).srgb8(1.0)
    assert (empty < half).all()
    assert (half < covered).all()


def test_exposure_brings_the_highlights_to_the_level():
    radiance = np.linspace(0.0, 2.0, 101, dtype=np.float32)[None, :, None] * np.ones((1, 101, 3), dtype=np.float32)
    picture = Picture(radiance, np.ones((1, 101), dtype=np.float32))
    assert exposure_for([picture], level=0.5, percentile=100.0) == pytest.approx(0.25)
    assert exposure_for([picture, uniform(8.0)], level=0.8, percentile=100.0) == pytest.approx(0.1)


@pytest.mark.parametrize("picture", [uniform(0.0), uniform(0.0, 0.0)])
def test_exposure_of_a_dark_or_empty_picture_is_one(picture):
    assert exposure_for([picture]) == 1.0


@settings(max_examples=25, deadline=None)
@given(arrays(np.float32, (6, 4, 3), elements=st.floats(0, 1, width=32)), st.sampled_from([1, 2]))
def test_averaging_keeps_the_mean(radiance, factor):
    picture = Picture(radiance, np.ones((6, 4), dtype=np.float32)).averaged(factor)
    assert picture.radiance.shape == (6 // factor, 4 // factor, 3)
    np.testing.assert_allclose(picture.radiance.mean(axis=(0, 1)), radiance.mean(axis=(0, 1)), atol=1e-6)
    np.testing.assert_array_equal(picture.coverage, 1.0)


def test_contact_sheet_places_every_image():
    images = [np.full((2, 3, 3), value, dtype=np.uint8) for value in (10, 20, 30)]
    sheet = contact_sheet(images, 2, gap_px=1)
    assert sheet.shape == (5, 7, 3)
    assert [sheet[0, 0, 0], sheet[0, 4, 0], sheet[3, 0, 0], sheet[3, 4, 0], sheet[2, 0, 0]] == [10, 20, 30, 0, 0]


def test_image_file_holds_the_pixels(tmp_path):
    image = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    save_image(tmp_path / "picture.png", image)
    with Image.open(tmp_path / "picture.png") as loaded:
        np.testing.assert_array_equal(np.asarray(loaded), image)


@pytest.mark.parametrize("suffix", ["png", "webp", "gif"])
def test_animation_has_every_frame_and_repeats(tmp_path, suffix):
    images = [np.full((8, 8, 3), 40 * k, dtype=np.uint8) for k in range(5)]
    path = tmp_path / f"moving.{suffix}"
    save_animation(path, images, frame_time_s=0.05)
    with Image.open(path) as loaded:
        assert loaded.n_frames == 5
        assert loaded.info["loop"] == 0
        loaded.seek(3)
        # WebP is lossy, a GIF has its palette.
        assert abs(int(np.asarray(loaded.convert("RGB"))[4, 4, 0]) - 120) <= 6
