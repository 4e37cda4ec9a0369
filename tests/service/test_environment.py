"""`rig environment`: photographs told apart, panoramas taken over, what is said of them and what is refused."""

import json
import re
from fractions import Fraction

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from processing.cameras.lens import Fisheye
from processing.environment.brackets import Bracket, merge_bracket
from processing.environment.equirectangular import Panorama, cubemap_of
from processing.errors import ImageError
from processing.formats.exr import ExrImage, read_exr, write_exr
from processing.formats.radiance_hdr import write_hdr
from processing.products import Environment
from service import viewing
from service.cli import app
from service.environment import PlaceOptions, make_environment
from service.environment_files import brackets_of, halved_lens, read_lens
from tests.benchmarks.yardsticks import phone_shots

_EXIF, _TIME, _F_NUMBER, _ISO, _TAKEN = 0x8769, 0x829A, 0x829D, 0x8827, 0x9003


def shot(path, exposure_s=None, second=None, number=0):
    """A tiny photograph with what EXIF says of it."""
    tags = Image.Exif()
    told = {_F_NUMBER: 1.8, _ISO: 100} | ({} if exposure_s is None else {_TIME: float(Fraction(exposure_s))})
    told |= {} if second is None else {_TAKEN: f"2024:05:01 12:00:{second:02d}"}
    tags.get_ifd(_EXIF).update(told)
    Image.new("RGB", (8, 8), (number, number, number)).save(path, exif=tags)
    return path


@pytest.fixture(scope="module")
def shots(tmp_path_factory):
    """A folder as the phone has it: both brackets, the front's names first."""
    folder = tmp_path_factory.mktemp("place")
    made = phone_shots.photograph(phone_shots.room(3, 128), folder, seed=3, radius_px=80.0)
    for i, path in enumerate((*made.front, *made.back)):
        path.rename(folder / f"IMG_{8 + i}.jpg")  # 8, 9, 10: in the order of numbers
    mask = folder / "mask"
    mask.mkdir()
    Image.fromarray((255 * made.mask).astype(np.uint8)).save(mask / "mask.png")
    return folder, made


def test_photographs_of_one_folder_become_a_product_with_pictures(shots, tmp_path):
    folder, made = shots
    out, panorama = tmp_path / "room", tmp_path / "room.exr"
    arguments = ["environment", str(folder), "-o", str(out), "--size", "16", "--panorama", str(panorama),
                 "--mask", str(folder / "mask" / "mask.png"), "--azimuth-deg", "90"]  # fmt: skip
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    count = len(made.front)
    assert f"front: IMG_8.jpg ... IMG_{7 + count}.jpg ({count})" in result.output
    assert "off half a turn" in result.output
    with Image.open(out / "found.png") as found, Image.open(out / "environment.png") as all_around:
        assert min(found.size) > 200
        assert all_around.width == 2 * all_around.height
    found = Environment.load(out)
    # The photographed room, a quarter turn on: front looked along +X there, along +Y here.
    turned = Panorama(made.panorama.picture, np.pi / 2)
    normals = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    true = cubemap_of(turned, 16).irradiance(normals)
    ours = found.irradiance(normals) * made.unit
    assert np.sqrt(np.mean((ours - true) ** 2)) < 0.03 * true.mean()
    written = Panorama(read_exr(panorama).image)
    light = (written.radiance * written.solid_angles[:, None]).sum(axis=0)
    np.testing.assert_allclose(light, found.integral, rtol=1e-4)


@pytest.mark.parametrize(
    ("options", "words"),
    [(PlaceOptions(turn="1,2"), "three angles"), (PlaceOptions(hide=("1,2,3",)), "four numbers")],
)
def test_options_that_say_nothing_are_refused_before_anything_is_computed(shots, tmp_path, options, words):
    with pytest.raises(ImageError, match=words):
        list(make_environment([shots[0]], tmp_path / "out", options))
    assert list(tmp_path.iterdir()) == []


def test_the_turn_between_brackets_shows_in_exposures_or_in_a_pause(tmp_path):
    same = [shot(tmp_path / f"{i}.jpg", f"1/{10 ** (i % 3 + 1)}", number=i) for i in range(6)]
    front, back = brackets_of(same)
    assert [path.name for path in front.files + back.files] == [f"{i}.jpg" for i in range(6)]
    assert len(front.files) == 3
    seconds = (0, 1, 2, 30, 31, 32, 33)
    others = [shot(tmp_path / f"p{9 - i}.jpg", f"1/{3**i}", seconds[i]) for i in range(7)]
    front, back = brackets_of(others)
    assert [path.name for path in front.files] == ["p9.jpg", "p8.jpg", "p7.jpg"]
    assert len(back.files) == 4


def test_photographs_that_cannot_be_told_apart_are_refused_with_the_way_out(tmp_path):
    ambiguous = [shot(tmp_path / f"a{i}.jpg", f"1/{3**i}") for i in range(6)]
    with pytest.raises(ImageError, match="two folders"):
        brackets_of(ambiguous)
    folders = tmp_path / "front", tmp_path / "back"
    for folder in folders:
        folder.mkdir()
    with pytest.raises(ImageError, match="front: no photographs"):
        brackets_of(list(folders))
    for i, path in enumerate(ambiguous):
        path.rename(folders[i // 3] / path.name)
    front, back = brackets_of(list(folders))
    assert (len(front.files), len(back.files)) == (3, 3)
    with pytest.raises(ImageError, match="mixture"):
        brackets_of([folders[0], front.files[0]])
    with pytest.raises(ImageError, match="no such file or folder"):
        brackets_of([tmp_path / "nowhere"])
    with pytest.raises(ImageError, match=r"silent\.jpg: no exposure time"):
        brackets_of([shot(tmp_path / "silent.jpg"), *front.files])


@pytest.mark.parametrize("suffix", [".exr", ".hdr"])
def test_a_panorama_is_taken_over_with_its_light_and_a_sun_is_told(tmp_path, suffix):
    picture = np.full((32, 64, 3), 0.5, np.float32)
    picture[6, 20] = 1e5
    source, out = tmp_path / f"sky{suffix}", tmp_path / "sky"
    write_exr(source, ExrImage(picture)) if suffix == ".exr" else write_hdr(source, picture)
    told = list(make_environment([source], out, PlaceOptions(size=16)))
    assert any(re.search(r"one texel holds \d+% of the light, as a sun", line) for line in told)
    panorama = Panorama(picture)
    light = (panorama.radiance * panorama.solid_angles[:, None]).sum(axis=0)
    np.testing.assert_allclose(Environment.load(out).integral, light, rtol=0.01)  # of .hdr 1 part in 256


def test_values_that_are_no_numbers_are_told_and_too_many_refused(tmp_path):
    picture = np.ones((16, 32, 3), np.float32)
    picture[3, 4] = np.nan, np.nan, np.nan
    write_exr(tmp_path / "a.exr", ExrImage(picture))
    told = list(make_environment([tmp_path / "a.exr"], tmp_path / "a", PlaceOptions(size=8)))
    assert "3 values were no numbers" in told[0]
    np.testing.assert_allclose(Environment.load(tmp_path / "a").radiance, 1, rtol=0.005)  # as even as resampling is
    picture[:4] = np.nan
    write_exr(tmp_path / "b.exr", ExrImage(picture))
    write_exr(tmp_path / "black.exr", ExrImage(np.zeros((16, 32, 3), np.float32)))
    for name, words in (("b", "are no numbers"), ("black", "black all around"), ("none", "no such file")):
        with pytest.raises(ImageError, match=words):
            list(make_environment([tmp_path / f"{name}.exr"], tmp_path / name, PlaceOptions(size=8)))
        assert not (tmp_path / name).exists()
    with pytest.raises(ImageError, match="leave the other names out"):
        list(make_environment([tmp_path / "a.exr", tmp_path], tmp_path / "c", PlaceOptions()))
    with pytest.raises(ImageError, match="written as"):
        list(make_environment([tmp_path / "a.exr"], tmp_path / "c", PlaceOptions(), tmp_path / "c.png"))


def test_a_product_is_drawn_and_lights_as_the_picture_it_was_made_of(tmp_path):
    picture = np.full((32, 64, 3), 0.1, np.float32)
    picture[10:14, 12:18] = 40.0, 30.0, 20.0
    write_exr(tmp_path / "lamp.exr", ExrImage(picture))
    list(make_environment([tmp_path / "lamp.exr"], tmp_path / "lamp", PlaceOptions(size=32)))
    viewing.draw_product(tmp_path / "lamp", tmp_path / "lamp.png", "", (), 64)
    with Image.open(tmp_path / "lamp.png") as drawn:
        codes = np.asarray(drawn.resize((64, 32))).sum(axis=-1, dtype=float)
    assert np.abs(np.unravel_index(codes.argmax(), codes.shape) - np.array([11.5, 14.5])).max() < 4
    ours, theirs = (viewing.lights_of(30.0, 0.0, tmp_path / name) for name in ("lamp", "lamp.exr"))
    for quantity in (lambda one: one.irradiance, lambda one: one.direction * np.sum(one.irradiance)):
        sums = [sum(quantity(one) for one in lights) for lights in (ours, theirs)]
        assert np.abs(sums[0] - sums[1]).max() < 0.02 * np.abs(sums[1]).max()


def test_a_calibrated_lens_serves_in_place_of_the_circle(shots, tmp_path):
    """As OpenCV gives it, at the photographs' full size: the sphere is lit as by the truth."""
    folder, made = shots
    lens = tmp_path / "lens.json"
    lens.write_text(json.dumps({"matrix": made.lens.matrix.tolist(), "distortion": [0, 0, 0, 0]}))
    options = PlaceOptions(size=8, mask=folder / "mask" / "mask.png", lens=lens)
    told = list(make_environment([folder], tmp_path / "room", options))
    assert any("off half a turn" in line for line in told)
    normals = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    true, ours = made.truth(8).irradiance(normals), Environment.load(tmp_path / "room").irradiance(normals) * made.unit
    assert np.sqrt(np.mean((ours - true) ** 2)) < 0.03 * true.mean()


@pytest.mark.parametrize("content", ["", "{}", '{"matrix": [[1,0,0],[0,1,0],[0,0,1]], "distortion": [0,0]}',
                                     '{"matrix": [[-9,0,4],[0,9,4],[0,0,1]], "distortion": [0,0,0,0]}',
                                     '{"matrix": [[NaN,0,4],[0,9,4],[0,0,1]], "distortion": [0,0,0,0]}'])  # fmt: skip
def test_what_is_no_lens_is_refused_in_one_line(tmp_path, content):
    (tmp_path / "lens.json").write_text(content)
    with pytest.raises(ImageError, match=r"lens.json: no fish-eye lens"):
        read_lens(tmp_path / "lens.json")
    with pytest.raises(ImageError, match="cannot be read"):
        read_lens(tmp_path / "none.json")


def test_a_halved_lens_images_at_half_the_pixels():
    lens = Fisheye(np.array([[40.0, 0, 50.3], [0, 40, 47.1], [0, 0, 1]]), np.array([0.01, 0, 0, 0]))
    points = np.random.default_rng(0).normal((0, 0, 1), size=(20, 3))
    np.testing.assert_allclose((lens.project(points) + 0.5) / 2 - 0.5, halved_lens(lens).project(points), atol=1e-9)


def spoilt(folder, shots, change):
    """The front's files with some of them changed: `change(number, picture)`; EXIF data stays."""
    names = []
    for number, path in enumerate(shots):
        with Image.open(path) as image:
            exif, picture = image.getexif(), image.copy()
        names.append(folder / f"{number}.jpg")
        change(number, picture).save(names[-1], quality=95, exif=exif)
    return Bracket(tuple(names))


def test_brackets_from_different_places_are_refused(shots, tmp_path):
    """A camera that moved between two exposures, and an exposure of another scene: one clear error each."""
    folder, made = shots
    files = sorted(folder.glob("IMG_*.jpg"), key=lambda path: int(path.stem[4:]))[: len(made.front)]

    def moved(number, picture):
        return picture.transform(picture.size, Image.Transform.AFFINE, (1, 0, 9, 0, 1, 5)) if number == 1 else picture

    def other(number, picture):
        return picture.transpose(Image.Transpose.ROTATE_180) if number == 1 else picture

    (tmp_path / "moved").mkdir()
    (tmp_path / "other").mkdir()
    with pytest.raises(ImageError, match=r"moved"):
        merge_bracket(spoilt(tmp_path / "moved", files, moved))
    with pytest.raises(ImageError, match=r"another scene"):
        merge_bracket(spoilt(tmp_path / "other", files, other))


@pytest.mark.parametrize("field_deg", [150.0, 260.0])
def test_a_wrong_field_of_view_is_told(shots, tmp_path, field_deg):
    """Nothing is written: what both photographs see does not fit."""
    folder, _ = shots
    options = PlaceOptions(size=8, field_deg=field_deg, mask=folder / "mask" / "mask.png")
    with pytest.raises(ImageError, match="wrong field of view"):
        list(make_environment([folder], tmp_path / "room", options))
    assert not (tmp_path / "room").exists()
