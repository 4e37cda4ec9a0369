"""Photographs with EXIF."""

import numpy as np
import pytest
from PIL import Image

from processing.errors import ImageError
from processing.formats.photo import read_photo

PICTURE = np.random.default_rng(1).integers(0, 256, (20, 30, 3)).astype(np.uint8)


def write(path, **tags):
    """A lossless or JPEG picture with EXIF tags by their numbers."""
    exif = Image.Exif()
    exif[0x0110] = tags.pop("model", "Test")
    block = exif if path.suffix == ".tif" else exif.get_ifd(0x8769)  # TIFF/EP keeps them in the first directory
    names = {"exposure": 0x829A, "f_number": 0x829D, "iso": 0x8827, "shutter": 0x9201}
    for name, value in tags.items():
        block[names[name]] = value
    Image.fromarray(PICTURE).save(path, exif=exif)
    return path


@pytest.mark.parametrize("suffix", ["png", "tif", "jpg"])
def test_pixels_and_exif(tmp_path, suffix):
    photo = read_photo(write(tmp_path / f"a.{suffix}", exposure=0.04, f_number=4.5, iso=200))
    assert photo.srgb8.shape == PICTURE.shape
    if suffix != "jpg":
        np.testing.assert_array_equal(photo.srgb8, PICTURE)
    assert (photo.exposure_s, photo.f_number, photo.iso, photo.model) == (0.04, 4.5, 200, "Test")


def test_the_dial_says_a_thirtieth_where_the_shutter_takes_a_32nd(tmp_path):
    assert read_photo(write(tmp_path / "a.jpg", exposure=1 / 30, shutter=5.0)).exposure_s == 1 / 32
    # Another time altogether is not a rounding: the label counts.
    assert read_photo(write(tmp_path / "b.jpg", exposure=1 / 30, shutter=7.0)).exposure_s == pytest.approx(1 / 30)


def test_without_exif_the_time_is_unknown(tmp_path):
    Image.fromarray(PICTURE).save(tmp_path / "a.png")
    photo = read_photo(tmp_path / "a.png")
    assert np.isnan(photo.exposure_s)
    assert photo.model == ""


def test_what_is_no_picture_is_named(tmp_path):
    whole = write(tmp_path / "whole.jpg", exposure=1.0)
    cut, text = tmp_path / "cut.jpg", tmp_path / "text.jpg"
    cut.write_bytes(whole.read_bytes()[:-300])
    text.write_text("hello")
    for path in (cut, text, tmp_path / "gone.jpg"):
        with pytest.raises(ImageError, match=path.name):
            read_photo(path)
