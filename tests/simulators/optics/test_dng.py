import io
from dataclasses import replace

import exifread
import numpy as np
import pytest
import rawpy
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from simulators.dng import RawFile, encode_dng

RAW = RawFile(
    serial="VC-0003", model="Virtual Arc Camera", black_dn=256, white_dn=4095, noise_profile=(6.5e-5, 6.8e-8),
    color_matrix=np.array([[1.9, -0.9, -0.3], [-0.97, 1.88, 0.04], [0.04, -0.15, 0.76]]), neutral=(0.6, 1.0, 0.72),
    exposure_s=0.0333, iso=100, f_number=8.0, focal_length_mm=12.0, time_s=75.25, unique_id="0123456789abcdef" * 2,
)  # fmt: skip


@settings(max_examples=20, deadline=None)
@given(st.data(), st.integers(24, 48), st.integers(24, 48))
def test_rawpy_returns_every_bit(data, rows, columns):
    mosaic = data.draw(arrays(np.uint16, (rows, columns), elements=st.integers(0, 65535), fill=st.just(7)))
    with rawpy.imread(io.BytesIO(encode_dng(mosaic, RAW))) as raw:
        np.testing.assert_array_equal(raw.raw_image, mosaic)


def test_rawpy_knows_the_sensor():
    with rawpy.imread(io.BytesIO(encode_dng(np.full((32, 48), 1000, np.uint16), RAW))) as raw:
        assert raw.black_level_per_channel == [256] * 4
        assert raw.white_level == 4095
        np.testing.assert_array_equal(raw.raw_pattern, [[0, 1], [3, 2]])
        assert raw.color_desc == b"RGBG"
        np.testing.assert_allclose(raw.camera_whitebalance[:3], [1 / 0.6, 1.0, 1 / 0.72], rtol=1e-3)


def test_a_grey_picture_develops_to_grey():
    rows, columns = np.mgrid[0:64, 0:64]
    response = np.choose(rows % 2 + columns % 2, RAW.neutral)
    mosaic = (256 + 1500 * response).round().astype(np.uint16)
    with rawpy.imread(io.BytesIO(encode_dng(mosaic, RAW))) as raw:
        picture = raw.postprocess(use_camera_wb=True, no_auto_bright=True)[8:-8, 8:-8].astype(int)
    assert np.ptp(picture.mean(axis=(0, 1))) < 3


def _tags(raw: RawFile) -> dict[str, str]:
    found = exifread.process_file(io.BytesIO(encode_dng(np.zeros((16, 16), np.uint16), raw)), details=False)
    return {name: str(tag) for name, tag in found.items()}


def test_exposure_tags_are_read_by_an_independent_reader():
    tags = _tags(RAW)
    assert tags["EXIF ExposureTime"] == "333/10000"
    assert tags["EXIF ISOSpeedRatings"] == "100"
    assert tags["EXIF FNumber"] == "8"
    assert tags["EXIF DateTimeOriginal"] == "2026:01:01 08:01:15"
    assert tags["EXIF SubSecTimeOriginal"] == "250000"
    assert tags["EXIF ImageUniqueID"] == RAW.unique_id
    assert tags["Image Tag 0xC62F"] == "VC-0003"
    assert tags["Image Tag 0xC761"] == "[(6.5e-05,), (6.8e-08,)]"


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 100_000))
def test_exposure_times_of_whole_ticks_are_exact(ticks):
    numerator, _, denominator = _tags(replace(RAW, exposure_s=ticks * 1e-4))["EXIF ExposureTime"].partition("/")
    assert int(numerator) * 10_000 == ticks * int(denominator or 1)


@pytest.mark.parametrize("kept", [10, 200, 500])
def test_a_truncated_file_is_not_a_picture(kept):
    data = encode_dng(np.zeros((64, 64), np.uint16), RAW)
    with pytest.raises(rawpy.LibRawError):
        rawpy.imread(io.BytesIO(data[:kept])).unpack()
