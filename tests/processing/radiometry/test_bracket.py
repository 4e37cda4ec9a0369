"""Files of one bracket to one file."""

import cv2
import numpy as np
import pytest
from PIL import Image

from processing.errors import ImageError
from processing.formats.exr import read_exr
from processing.formats.photo import read_photo
from processing.formats.raw import read_raw
from processing.radiometry.bracket import balanced, merge_files, write_merged
from processing.radiometry.hdr import PixelStatus
from processing.radiometry.response_file import read_response
from processing.radiometry.stack import MergeOptions
from tests.processing.radiometry.pictures import camera, scene
from tests.public_data import DATA
from tests.reference.dng import dng

ROOM = DATA / "hdr-room"
PROFILE = (1 / (4 * 3839), (1 / 3839) ** 2)
TIMES_S = (0.5, 0.05, 0.005)


def raw_files(folder, radiance=4000.0, times=TIMES_S, **tags):
    """Bracketed DNG files of a grey wall, in this order."""
    rng = np.random.default_rng(0)
    paths = []
    for i, time in enumerate(times):
        electrons = rng.poisson(radiance * time, (32, 48)) + rng.normal(0, 4, (32, 48))
        mosaic = np.clip(np.rint(electrons / 4 + 256), 0, 4095).astype(np.uint16)
        mosaic[10:12, 10:14] = 4095  # a lamp that no exposure resolves
        path = folder / f"{i}.dng"
        path.write_bytes(dng(mosaic, **{"exposure_s": time, "noise_profile": PROFILE, **tags}))
        paths.append(path)
    return paths


def picture_file(path, level=100, exposure=0.1, size=(20, 30), model="Test"):
    exif = Image.Exif()
    exif[0x0110] = model
    if exposure is not None:
        exif.get_ifd(0x8769)[0x829A] = exposure
    ramp = np.clip(np.linspace(0.2, 2, size[1]) * level, 0, 255)
    image = np.broadcast_to(ramp[None, :, None], (*size, 3)).astype(np.uint8)
    Image.fromarray(image).save(path, exif=exif)
    return path


def test_raw_files_give_radiance_in_electrons(tmp_path):
    merged = merge_files(raw_files(tmp_path))
    assert merged.exposure_s == pytest.approx(sorted(TIMES_S))
    assert [path.name for path in merged.files] == ["2.dng", "1.dng", "0.dng"]
    green = merged.radiance.value[..., 1]
    assert np.nanmean(green) == pytest.approx(4000, rel=0.01)
    # White balance of the file: red twice, blue 1.25 times what was measured.
    np.testing.assert_allclose(np.nanmean(merged.radiance.value, axis=(0, 1)) / 4000, [2, 1, 1.25], rtol=0.01)
    assert (merged.radiance.status[11, 12] == PixelStatus.SATURATED).any()
    assert not merged.assumed_sensor


def test_written_files_hold_the_same_numbers(tmp_path):
    merged = merge_files(raw_files(tmp_path))
    exr_path, picture_path = write_merged(merged, tmp_path / "out.exr")
    exr = read_exr(exr_path)
    np.testing.assert_array_equal(exr.image, merged.radiance.value)
    np.testing.assert_array_equal(exr.layers["variance"], merged.radiance.variance)
    np.testing.assert_array_equal(exr.layers["status"], merged.radiance.status)
    assert exr.metadata["exposureTimes"] == "0.005 0.05 0.5"
    picture = cv2.imread(str(picture_path))
    assert picture.shape == (32, 48, 3)
    assert picture[10, 11].tolist() == [255, 255, 255]


def test_a_camera_without_noise_profile_says_so(tmp_path):
    merged = merge_files(raw_files(tmp_path, noise_profile=None))
    assert merged.assumed_sensor
    path, _ = write_merged(merged, tmp_path / "out.exr")
    assert "assumed" in read_exr(path).metadata["radianceUnit"]


def another_dng(folder, *, rows=32, **tags):
    path = folder / "other.dng"
    path.write_bytes(dng(np.zeros((rows, 48), np.uint16), **{"exposure_s": 1.0, "noise_profile": PROFILE, **tags}))
    return path


def cut(path, length):
    path.write_bytes(path.read_bytes()[:length])
    return path


NO_BRACKETS = {
    "no files": lambda f: [],
    "named twice": lambda f: raw_files(f) + raw_files(f)[:1],
    "is not; merge one kind": lambda f: [*raw_files(f), picture_file(f / "a.png")],
    "different sizes": lambda f: [*raw_files(f), another_dng(f, rows=30)],
    "different cameras": lambda f: [*raw_files(f), another_dng(f, serial="T-2")],
    "different ISO": lambda f: [*raw_files(f), another_dng(f, iso=200)],
    "different sensor levels": lambda f: [*raw_files(f), another_dng(f, black=(128,))],
    "the same exposure time": lambda f: [*raw_files(f), another_dng(f, exposure_s=0.05)],
    "truncated: 500 bytes": lambda f: [*raw_files(f), cut(another_dng(f), 500)],
    "no exposure time": lambda f: [picture_file(f / "a.png"), picture_file(f / "b.png", exposure=None)],
    "one photograph has no bracket": lambda f: [picture_file(f / "a.png")],
    "not a readable picture": lambda f: [picture_file(f / "a.png"), cut(picture_file(f / "b.png", exposure=1.0), 50)],
}


@pytest.mark.parametrize("reason", NO_BRACKETS)
def test_what_is_no_bracket_is_refused_with_the_reason(tmp_path, reason):
    with pytest.raises(ImageError, match=reason):
        merge_files(NO_BRACKETS[reason](tmp_path))


def test_an_output_of_another_kind_is_refused(tmp_path):
    merged = merge_files(raw_files(tmp_path))
    with pytest.raises(ImageError, match="OpenEXR"):
        write_merged(merged, tmp_path / "out.jpg")
    with pytest.raises(ImageError, match="cannot be written"):
        write_merged(merged, tmp_path / "absent" / "out.exr")


@pytest.mark.skipif(not ROOM.is_dir(), reason=f"no photographs at {ROOM.parent.name}/{ROOM.name}")
def test_a_real_room_is_consistent_over_its_exposures():
    """Seven JPEG over thirteen stops: what two exposures say about one pixel agrees."""
    merged = merge_files(sorted(ROOM.glob("*.jpg")))
    assert merged.exposure_s == pytest.approx([2.0**-s for s in (12, 10, 7, 5, 3, 1, -1)])
    radiance = merged.radiance
    assert radiance.count(PixelStatus.SATURATED) < 1e-3 * radiance.value.size  # the shortest resolves all but glints
    spread = np.nanpercentile(radiance.value, [1, 99.9])
    assert spread[1] / spread[0] > 10_000  # more than four decades, where one JPEG holds two
    shades = cv2.imread(str(sorted(ROOM.glob("*.jpg"))[2]))[..., 1]  # green of 1/8 s
    mid = (shades > 60) & (shades < 200)
    exposed = np.log(radiance.value[..., 1][mid] * merged.photographs.measured[4])
    predicted = np.interp(exposed, merged.response.log_exposure[:, 1], np.arange(256))
    assert 1.4826 * np.median(np.abs(predicted - shades[mid])) < 1.5  # JPEG noise is one code


@pytest.mark.skipif(not ROOM.is_dir(), reason=f"no photographs at {ROOM.parent.name}/{ROOM.name}")
def test_parts_of_a_real_bracket_give_one_response_within_its_deviation():
    """Every second of seven exposures, and the four longest, against all; the flicker of 1/1000 s is found.

    Three exposures cannot find it: their response is off by much, and says so.
    """
    files = sorted(ROOM.glob("*.jpg"))  # the longest first
    whole = merge_files(files)
    log_error = np.log(np.divide(whole.photographs.measured, whole.photographs.stated))
    assert 0.1 < log_error[1] < 0.2
    assert np.abs(log_error[2:]).max() < 0.02
    for part in (files[::2], files[1::2], files[:4]):
        response = merge_files(part).response
        difference = (response.log_exposure - whole.response.log_exposure)[12:240]
        sigma = np.hypot(response.log_exposure_sigma, whole.response.log_exposure_sigma)[12:240]
        assert np.sqrt(np.mean((difference / np.maximum(sigma, 1e-4)) ** 2)) < 2


def test_exposure_times_that_the_frames_contradict_are_an_error_or_replaced(tmp_path):
    paths = raw_files(tmp_path, radiance=4000.0, times=(0.5, 0.25, 0.05))
    swapped = [tmp_path / "a.dng", tmp_path / "b.dng"]
    for path, source, stated_s in zip(swapped, paths, (0.25, 0.5), strict=False):
        path.write_bytes(dng(read_raw(source).mosaic, exposure_s=stated_s, noise_profile=PROFILE))
    with pytest.raises(ImageError, match=r"swapped exposure times: .*b.dng states 0.5 s and measures 0.2[45]"):
        merge_files([*swapped, paths[2]])
    merged = merge_files([*swapped, paths[2]], MergeOptions(measured_times=True))
    assert np.nanmean(merged.radiance.value[..., 1]) == pytest.approx(4000, rel=0.01)
    path, _ = write_merged(merged, tmp_path / "out.exr")
    assert read_exr(path).metadata["measuredTimes"].count("+-") == 3


def test_one_raw_file_alone_is_an_image(tmp_path):
    merged = merge_files(raw_files(tmp_path)[1:2])
    assert np.nanmean(merged.radiance.value[..., 1]) == pytest.approx(4000, rel=0.02)


def test_a_picture_that_moved_is_an_error_or_taken_as_it_is(tmp_path):
    scene = np.kron(np.random.default_rng(0).uniform(1000, 9000, (20, 24)), np.ones((12, 12)))
    paths = []
    for name, time_s, shift in (("a", 0.5, 0), ("b", 0.05, 5)):
        electrons = np.random.default_rng(1).poisson(np.roll(scene, shift, axis=1) * time_s)
        path = tmp_path / f"{name}.dng"
        path.write_bytes(dng((electrons / 4 + 256).astype(np.uint16), exposure_s=time_s, noise_profile=PROFILE))
        paths.append(path)
    with pytest.raises(ImageError, match=r"b.dng and .*a.dng: the picture moved by [45]\.\d px between them"):
        merge_files(paths)
    found = merge_files(paths, MergeOptions(moved=True)).found
    assert found.alignment.worst.length_px == pytest.approx(5, abs=0.5)
    assert found.alignment.moved_share > 0.1


def photographs(folder, times, **settings):
    """JPEG files of one scene by the simulated camera."""
    files = []
    shooter = camera(**settings)
    for i, time in enumerate(times):
        path = folder / f"{shooter.iso}-{i}.jpg"
        path.write_bytes(shooter.photograph(scene(), time, ("photo", i)))
        files.append(path)
    return files


def test_radiance_of_photographs_compares_across_brackets_of_a_camera(tmp_path):
    """Other ISO, aperture and times with the saved response: the same radiance; one bracket may mix them."""
    first = merge_files(photographs(tmp_path, 4.0 ** np.arange(-2, 3)))
    write_merged(first, tmp_path / "first.exr")
    assert "f/1 and ISO 100" in read_exr(tmp_path / "first.exr").metadata["radianceUnit"]
    response = read_response(tmp_path / "first.json")
    other = photographs(tmp_path, [0.1, 0.4], iso=400, f_number=2.8)
    for files in (other, other[:1], [*other, *first.files[1:3]]):
        again = merge_files(files, response=response)
        both = (first.radiance.status == PixelStatus.OK) & (again.radiance.status == PixelStatus.OK)
        assert np.median(again.radiance.value[both] / first.radiance.value[both]) == pytest.approx(1, abs=0.01)
    with pytest.raises(ImageError, match="response of Virtual P1"):
        merge_files([picture_file(tmp_path / "a.png", model="Another")], response=response)
    with pytest.raises(ImageError, match="needs no response"):
        merge_files(raw_files(tmp_path), response=response)


def test_pictures_are_turned_upright_and_deep_ones_refused(tmp_path):
    turned = Image.Exif()
    turned[0x0112] = 6  # a quarter turn
    Image.fromarray(np.zeros((4, 7, 3), np.uint8)).save(tmp_path / "turned.jpg", exif=turned)
    assert read_photo(tmp_path / "turned.jpg").srgb8.shape == (7, 4, 3)
    Image.fromarray(np.zeros((4, 7), np.uint8)).save(tmp_path / "grey.jpg")
    assert read_photo(tmp_path / "grey.jpg").srgb8.shape == (4, 7, 3)
    for deep in (np.zeros((4, 7), np.uint16), np.zeros((4, 7, 3), np.uint16)):
        cv2.imwrite(str(tmp_path / "deep.png"), deep)
        with pytest.raises(ImageError, match="more than 8 bits"):
            read_photo(tmp_path / "deep.png")


def test_a_grey_patch_balances_raw_and_is_recorded(tmp_path):
    """The wall of these files is grey; the white balance that they carry is not."""
    merged = balanced(merge_files(raw_files(tmp_path)), (16, 16, 24, 12))
    mean = np.nanmean(merged.radiance.value[16:28, 16:40], axis=(0, 1))
    np.testing.assert_allclose(mean, mean[1], rtol=1e-3)
    write_merged(merged, tmp_path / "out.exr")
    metadata = read_exr(tmp_path / "out.exr").metadata
    assert metadata["greyPatch"] == "16,16,24,12"
    assert metadata["greyMultipliers"].count("+-") == 3


def test_photographs_that_moved_are_an_error_or_taken_as_they_are(tmp_path):
    radiance, files = scene(0, (200, 300)), []
    for i, time in enumerate((0.25, 1.0, 4.0)):
        path = tmp_path / f"{i}.jpg"
        path.write_bytes(camera().photograph(np.roll(radiance, 2 * (i == 2), axis=1), time, ("moved", i)))
        files.append(path)
    with pytest.raises(ImageError, match=r"1.jpg and .*2.jpg: the picture moved by [12]\.\d px"):
        merge_files(files)
    assert merge_files(files, MergeOptions(moved=True)).radiance.count(PixelStatus.OK) > 0
    write_merged(merge_files(files[:2]), tmp_path / "still.exr")
