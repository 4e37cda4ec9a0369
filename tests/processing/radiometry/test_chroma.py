"""Colours that a JPEG of 4:2:0 mixed, shared out again."""

import io

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from processing.formats.photo import read_photo
from processing.radiometry.chroma import unmixed_colours


def coded(codes, subsampling):
    content = io.BytesIO()
    Image.fromarray(codes).save(content, "JPEG", quality=98, subsampling=subsampling)
    return content.getvalue()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(1, 9))
def test_grey_stays_and_so_does_an_even_colour(seed, height, width):
    rng = np.random.default_rng(seed)
    grey = np.repeat(rng.integers(0, 256, (height, width, 1)), 3, axis=-1).astype(np.uint8)
    np.testing.assert_array_equal(unmixed_colours(grey), grey)
    even = np.broadcast_to(rng.integers(0, 256, 3), (height, width, 3)).astype(np.uint8)
    assert np.abs(unmixed_colours(even).astype(int) - even).max() <= 1


def test_a_red_lamp_on_black_keeps_its_red(tmp_path):
    """Lamps of a few pixels, of one colour: mixing takes a tenth of their red, a quarter of what it takes is left."""
    rng = np.random.default_rng(1)
    scene = np.zeros((64, 64, 3), np.uint8)
    for row, column in rng.integers(0, 61, (40, 2)):
        scene[row : row + 3, column : column + 3] = 230, 120, 60
    path = tmp_path / "lamps.jpg"
    path.write_bytes(coded(scene, "4:2:0"))
    with Image.open(path) as image:
        mixed = np.asarray(image).astype(float)
    lit = scene[..., 0] > 0
    lost, left = (np.abs(codes[lit, 0] - 230).mean() for codes in (mixed, read_photo(path).srgb8.astype(float)))
    assert left < 0.5 * lost


def test_a_file_with_all_its_colours_is_read_as_it_is(tmp_path):
    scene = np.random.default_rng(2).integers(0, 256, (16, 24, 3)).astype(np.uint8)
    path = tmp_path / "full.jpg"
    path.write_bytes(coded(scene, "4:4:4"))
    with Image.open(path) as image:
        np.testing.assert_array_equal(read_photo(path).srgb8, np.asarray(image))
