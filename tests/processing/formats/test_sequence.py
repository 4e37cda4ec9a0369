"""Folders of pictures and animations, as other people leave them."""

import cv2
import numpy as np
import pytest
from PIL import Image

from processing.errors import ImageError
from processing.formats.sequence import read_picture, read_sequence

RNG = np.random.default_rng(0)
GREY, COLOUR = RNG.integers(0, 256, (6, 8)), RNG.integers(0, 256, (6, 8, 3))


def test_names_are_sorted_as_people_count(tmp_path):
    for number in (10, 9, 1, 2):
        Image.fromarray(np.full((4, 5), number, np.uint8)).save(tmp_path / f"frame{number}.png")
    (tmp_path / "notes.txt").write_text("no picture")
    (tmp_path / "._frame1.png").write_bytes(b"left by another system's copy")
    Image.fromarray(np.full((4, 5), 11, np.uint8)).save(tmp_path / "frame10²3.png")  # digits that are no decimals
    frames = read_sequence(tmp_path)
    assert [int(frame[0, 0]) for frame in frames] == [1, 2, 9, 10, 11]
    assert [int(frame[0, 0]) for frame in frames[1:3]] == [2, 9]


@pytest.mark.parametrize(("suffix", "bits"), [(".png", 8), (".png", 16), (".tif", 8), (".tif", 16), (".bmp", 8)])
@pytest.mark.parametrize("content", [GREY, COLOUR], ids=["grey", "colour"])
def test_pictures_are_read_as_they_are_stored(tmp_path, suffix, content, bits):
    stored = (content * (1 if bits == 8 else 257)).astype(np.uint8 if bits == 8 else np.uint16)
    path = tmp_path / f"picture{suffix}"
    assert cv2.imwrite(str(path), stored[..., ::-1] if stored.ndim == 3 else stored)
    read = read_picture(path)
    assert read.dtype == stored.dtype
    np.testing.assert_array_equal(read, stored)


def test_colour_with_transparency_keeps_its_bits(tmp_path):
    stored = RNG.integers(0, 65536, (6, 8, 4)).astype(np.uint16)
    assert cv2.imwrite(str(tmp_path / "a.png"), stored)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png"), stored[..., 2::-1])


def test_animations_are_sequences(tmp_path):
    frames = [Image.fromarray(np.full((6, 8), 40 * k, np.uint8)) for k in range(1, 5)]
    frames[0].save(tmp_path / "turn.gif", save_all=True, append_images=frames[1:])
    read = read_sequence(tmp_path / "turn.gif")
    assert [frame.shape for frame in read] == [(6, 8, 3)] * 4
    assert [int(frame[0, 0, 0]) for frame in read] == [40, 80, 120, 160]


def test_what_is_no_sequence_is_refused(tmp_path):
    with pytest.raises(ImageError, match="no picture in it"):
        read_sequence(tmp_path)
    with pytest.raises(ImageError, match="neither a folder"):
        read_sequence(tmp_path / "absent")
    Image.new("L", (8, 6)).save(tmp_path / "a.png")
    Image.new("L", (6, 8)).save(tmp_path / "b.png")
    with pytest.raises(ImageError, match=r"b\.png: 6 x 8 pixels, but 8 x 6 in a\.png"):
        read_sequence(tmp_path)
    (tmp_path / "b.png").write_text("no picture")
    with pytest.raises(ImageError, match=r"b\.png"):
        read_sequence(tmp_path)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif"])
@pytest.mark.parametrize("damage", ["truncated", "text", "empty", "absent"])
def test_damaged_pictures_are_named(tmp_path, suffix, damage):
    path = tmp_path / f"picture{suffix}"
    Image.fromarray(RNG.integers(0, 256, (64, 64, 3)).astype(np.uint8)).save(path)
    if damage == "truncated":
        path.write_bytes(path.read_bytes()[:700])
    elif damage == "absent":
        path.unlink()
    else:
        path.write_text("not a picture" if damage == "text" else "")
    with pytest.raises(ImageError, match="picture"):
        read_picture(path)


def test_pictures_without_counts_are_refused(tmp_path):
    Image.fromarray(np.ones((4, 5), np.float32)).save(tmp_path / "float.tif")
    with pytest.raises(ImageError, match="8 or 16 bits"):
        read_picture(tmp_path / "float.tif")
    Image.fromarray(np.full((4, 5), 70_000, np.int32)).save(tmp_path / "long.tif")
    with pytest.raises(ImageError, match="70000; 8 or 16 bits"):
        read_picture(tmp_path / "long.tif")


def test_pictures_too_large_to_be_opened_are_named(tmp_path, monkeypatch):
    path = tmp_path / "large.png"
    Image.new("L", (64, 64)).save(path)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 1000)
    for read in (read_picture, lambda path: read_sequence(path.parent)):
        with pytest.raises(ImageError, match=r"large\.png: .*decompression bomb"):
            read(path)
