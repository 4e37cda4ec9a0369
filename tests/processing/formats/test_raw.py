"""Camera RAW files."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.formats import tiff
from processing.formats.raw import map_raw, read_raw
from tests.reference.dng import dng

MOSAIC = np.random.default_rng(0).integers(200, 4096, (48, 64)).astype(np.uint16)
PROFILE = (1 / (4 * 3839), (1 / 3839) ** 2)  # gain 4 e-/dn, read noise 4 e-


def test_a_dng_gives_its_samples_and_its_sensor():
    raw = read_raw(dng(MOSAIC, exposure_s=0.1234, noise_profile=PROFILE, serial="VC-0003", unique_id="ab" * 16))
    np.testing.assert_array_equal(raw.mosaic, MOSAIC)
    assert raw.mosaic.dtype == np.uint16
    assert raw.cfa.tolist() == [[0, 1], [1, 2]]
    assert raw.exposure_s == pytest.approx(0.1234)
    assert (raw.sensor.black_dn, raw.sensor.white_dn) == (256, 4095)
    assert raw.sensor.gain_e_per_dn == pytest.approx(4)
    assert raw.sensor.read_noise_e == pytest.approx(4)
    assert not raw.sensor.assumed
    assert (raw.serial, raw.unique_id, raw.iso, raw.f_number) == ("VC-0003", "ab" * 16, 100, 4)
    np.testing.assert_allclose(raw.white_balance, [2, 1, 1.25])


def test_a_path_reads_like_its_bytes(tmp_path):
    path = tmp_path / "frame.dng"
    path.write_bytes(dng(MOSAIC))
    np.testing.assert_array_equal(read_raw(path).mosaic, read_raw(path.read_bytes()).mosaic)


def test_without_a_noise_profile_the_sensor_is_assumed():
    sensor = read_raw(dng(MOSAIC)).sensor
    assert sensor.assumed
    assert (sensor.gain_e_per_dn, sensor.read_noise_e) == (1, 2)


def test_black_levels_of_the_channels_become_one():
    raw = read_raw(dng(MOSAIC, black=(256, 250, 256, 258)))
    assert raw.sensor.black_dn == 258
    shift = np.tile([[2, 8], [2, 0]], (24, 32))
    np.testing.assert_array_equal(raw.mosaic, MOSAIC + shift)


def as_written(path, content):
    path.write_bytes(content)
    return path


def equal(one, other):
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in one.__dataclass_fields__)


def test_a_mapped_file_is_the_same_frame_with_its_samples_on_disk(tmp_path):
    content = dng(MOSAIC, exposure_s=0.1234, noise_profile=PROFILE, serial="VC-0003", unique_id="ab" * 16)
    mapped = map_raw(as_written(tmp_path / "frame.dng", content))
    assert isinstance(mapped.mosaic, np.memmap)
    assert not mapped.mosaic.flags.writeable
    assert equal(mapped, read_raw(content))


@pytest.mark.parametrize("change", ["levels differ", "few rows", "more behind", "other byte order"])
def test_what_is_no_plain_block_of_samples_is_decoded_whole(tmp_path, change):
    mosaic = MOSAIC[:32] if change == "few rows" else MOSAIC
    content = dng(mosaic, black=(256, 250, 256, 258) if change == "levels differ" else (256,), noise_profile=PROFILE)
    content += b"more" if change == "more behind" else b""
    path = as_written(tmp_path / "frame.dng", content)
    if change == "other byte order":
        tags = tiff.sample_block(content.replace(b"II*\0", b"MM\0*", 1))
        assert tags is None
        return
    mapped = map_raw(path)
    assert not isinstance(mapped.mosaic, np.memmap)
    assert equal(mapped, read_raw(path))


@settings(max_examples=20, deadline=None)
@given(st.floats(0, 0.999))
def test_a_truncated_file_is_an_error(part):
    content = dng(MOSAIC, noise_profile=PROFILE)
    with pytest.raises(ImageError, match="truncated"):
        read_raw(content[: int(part * len(content))])


@pytest.mark.parametrize("part", [0, 0.001, 0.1, 0.6, 0.999])
def test_a_truncated_file_is_not_mapped(tmp_path, part):
    content = dng(MOSAIC, noise_profile=PROFILE)
    with pytest.raises(ImageError, match=r"short.dng: .*truncated"):
        map_raw(as_written(tmp_path / "short.dng", content[: int(part * len(content))]))


def test_errors_name_the_file(tmp_path):
    missing, text = tmp_path / "gone.dng", tmp_path / "notes.dng"
    text.write_text("not an image" * 100)
    for path in (missing, text):
        for read in (read_raw, map_raw):
            with pytest.raises(ImageError, match=path.name):
                read(path)
