"""OpenEXR files."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from processing.errors import ImageError
from processing.formats.exr import ExrImage, read_exr, write_exr

images = hnp.arrays(
    np.float32, st.sampled_from([(3, 4), (3, 4, 3)]), elements=st.floats(width=32, allow_nan=True, allow_infinity=True)
)


@settings(max_examples=25, deadline=None)
@given(images, images, st.text("abc def,;=1.", max_size=20))
def test_what_is_written_is_read_bit_by_bit(tmp_path_factory, image, layer, note):
    path = tmp_path_factory.mktemp("exr") / "image.exr"
    write_exr(path, ExrImage(image, {"variance": layer}, {"note": note}))
    again = read_exr(path)
    np.testing.assert_array_equal(again.image, image)
    np.testing.assert_array_equal(again.layers["variance"], layer)
    assert again.image.dtype == np.float32
    assert again.metadata["note"] == note


def test_layers_of_another_size_are_refused(tmp_path):
    image, other = np.zeros((3, 4), np.float32), np.zeros((4, 4), np.float32)
    with pytest.raises(ImageError, match="layer"):
        write_exr(tmp_path / "a.exr", ExrImage(image, {"variance": other}))


def test_unreadable_and_unwritable_files_are_named(tmp_path):
    path = tmp_path / "image.exr"
    with pytest.raises(ImageError, match=r"image\.exr: no such file"):
        read_exr(path)
    write_exr(path, ExrImage(np.ones((50, 40, 3), np.float32) * np.arange(40, dtype=np.float32)[:, None]))
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(ImageError, match=r"image\.exr"):
        read_exr(path)
    path.write_bytes(b"hello")
    with pytest.raises(ImageError, match=r"image\.exr"):
        read_exr(path)
    with pytest.raises(ImageError, match="cannot be written"):
        write_exr(tmp_path / "absent" / "image.exr", ExrImage(np.zeros((2, 2), np.float32)))
