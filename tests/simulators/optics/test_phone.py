"""The simulated phone's pictures: the place as the lens shows it, files as a camera writes them."""

import io

import exifread
import numpy as np
import pytest
import rawpy
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from processing.environment.equirectangular import Panorama
from simulators.phone import CAMERA, FACINGS, HALF_TURN, FrameLabel, Phone, build_phone
from simulators.places import PLACES, look

LABEL = FrameLabel("PH-0001", 3.25, "0123456789abcdef" * 2)


@pytest.fixture(scope="module")
def phone():
    return Phone(build_phone(2, "small"), 2)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000), st.floats(1e-3, 1e3))
def test_a_place_is_looked_at_as_its_picture_is_read(seed, length):
    """Linear between pixels, of any length of direction; against the reader of panoramas, away from the poles."""
    rng = np.random.default_rng(seed)
    picture = rng.exponential(size=(16, 32, 3))
    directions = rng.normal(size=(50, 3))
    directions = directions[np.abs(directions[:, 2]) < 0.9 * np.linalg.norm(directions, axis=1)]
    index, weight = (panorama := Panorama(picture)).taps(directions / np.linalg.norm(directions, axis=1)[:, None])
    read = np.einsum("nt,ntc->nc", weight, panorama.radiance[index])
    np.testing.assert_allclose(look(picture, length * directions), read, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", PLACES)
def test_places_are_light_all_around_and_belong_to_their_seed(name):
    one, again, other = (PLACES[name](seed, 32) for seed in (1, 1, 2))
    assert one.shape == (32, 64, 3)
    assert (one > 0).all()
    np.testing.assert_array_equal(one, again)
    assert not np.allclose(one, other)


def test_front_and_back_look_in_opposite_directions_up_to_the_hand(phone):
    front, back = (phone.layout.rig_from_camera[facing] for facing in FACINGS)
    np.testing.assert_allclose(front @ [0, 0, 1], [1, 0, 0])
    np.testing.assert_allclose(front @ [0, -1, 0], [0, 0, 1])
    off = HALF_TURN.T @ front.T @ back
    assert 0 < np.degrees(np.arccos((np.trace(off) - 1) / 2)) < 4 * np.sqrt(3)


def test_the_middle_shows_what_lies_ahead_and_the_corners_nothing(phone):
    shown, lens = phone.radiance("room", "front"), phone.layout.lens
    column, row = np.rint(lens.centre_px).astype(int)
    ahead = look(phone.place("room"), np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(shown[row, column], ahead, rtol=0.5)
    assert shown[0, 0].max() < 1e-3 * shown.mean()


def test_files_say_who_took_them_when_and_how_long(phone):
    radiance = phone.radiance("room", "front")
    for content in (phone.jpeg(radiance, 1 / 32_000, (1,), LABEL), phone.dng(radiance, 1 / 32_000, (1,), LABEL)):
        tags = exifread.process_file(io.BytesIO(content), details=False)
        assert float(tags["EXIF ExposureTime"].values[0]) == 1 / 32_000
        assert str(tags["EXIF BodySerialNumber"]) == "PH-0001"
        assert str(tags["EXIF SubSecTimeOriginal"]) == "250000"
        assert int(tags["EXIF ISOSpeedRatings"].values[0]) == CAMERA.iso


def test_both_kinds_of_file_tell_the_same_light(phone):
    """In their own units, where neither clips nor drowns: within their noise."""
    radiance, time_s = phone.radiance("room", "front"), 0.03
    with rawpy.imread(io.BytesIO(phone.dng(radiance, time_s, (1,), LABEL))) as raw:
        green = raw.raw_image[0::2, 1::2] - 256.0
    electrons = green * CAMERA.full_e / (4095 - 256) / time_s * phone.unit_of_raw()[1]
    true = radiance[0::2, 1::2, 1]
    lit = (true > 0.1) & (true < 1)
    assert abs(np.median(electrons[lit] / true[lit]) - 1) < 0.01
    with Image.open(io.BytesIO(phone.jpeg(radiance, time_s, (1,), LABEL))) as picture:
        codes = np.asarray(picture)[..., 1]
    middle = np.abs(codes.astype(int) - 128) < 4
    told = phone.unit_of_jpeg()[1] / time_s * CAMERA.f_number**2
    assert abs(np.median(radiance[..., 1][middle]) / told - 1) < 0.1
