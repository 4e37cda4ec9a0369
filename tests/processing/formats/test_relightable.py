"""Relightable images through their files: what comes back, what is refused."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from processing.errors import ImageError
from processing.formats.coefficient_bytes import Steps, to_bytes, value_range
from processing.formats.light_positions import read_lp, write_lp
from processing.formats.ptm import read_ptm, write_ptm
from processing.formats.relight import read_relight, write_relight
from processing.formats.rti import read_rti, write_rti
from processing.materials.ptm import as_lrgb, fit_ptm, reproduction_db
from processing.products import RelightableImage, ResidualBasis
from tests.reference.ptm import board, dome

LIGHTS = dome(24)
PICTURES = board(LIGHTS, (24, 31), seed=2)
PTM = fit_ptm(PICTURES, LIGHTS).image
HSH = fit_ptm(PICTURES, LIGHTS, ResidualBasis.HEMISPHERICAL).image
FORMATS = {
    "ptm": (PTM, write_ptm, read_ptm, 0.02),
    "lrgb": (as_lrgb(PTM), write_ptm, read_ptm, 0.02),
    "rti": (HSH, write_rti, read_rti, 0.02),
    "web": (PTM, write_relight, read_relight, 0.3),  # JPEG
    "web-hsh": (HSH, write_relight, read_relight, 0.5),
}


@pytest.mark.parametrize("name", FORMATS)
def test_what_is_written_comes_back(tmp_path, name):
    image, write, read, lost_db = FORMATS[name]
    write(tmp_path / "a", image)
    back = read(tmp_path / "a")
    assert (back.basis, back.coefficients.shape) == (image.basis, image.coefficients.shape)
    assert (back.colour is None) == (image.colour is None)
    before, after = (reproduction_db(i, PICTURES, LIGHTS) for i in (image, back))
    assert after > before - lost_db


@settings(max_examples=15, deadline=None)
@given(st.floats(1e-6, 1e6), st.floats(-3, 3))
def test_ranges_of_any_size_hold(tmp_path_factory, factor, shift):
    """Of coefficients of any scale and offset the error stays under two steps; nothing is divided by zero."""
    rng = np.random.default_rng(7)
    coefficients = ((rng.normal(size=(6, 3, 5, 3)) + shift) * factor).astype(np.float32)
    coefficients[2] = shift * factor
    path = tmp_path_factory.mktemp("range") / "a.ptm"
    write_ptm(path, RelightableImage(coefficients, ResidualBasis.BIQUADRATIC))
    wide = np.maximum(coefficients.max(axis=(1, 2, 3)), 0) - np.minimum(coefficients.min(axis=(1, 2, 3)), 0)
    back = read_ptm(path).coefficients
    light = np.array([0.3, -0.4, np.sqrt(0.75)])
    values = np.abs(ResidualBasis.BIQUADRATIC.evaluate(light[None], light[None])[0])
    error = np.abs(RelightableImage(back - coefficients, ResidualBasis.BIQUADRATIC).evaluate(light))
    assert error.max() <= 2 * (wide / 254) @ values * 1.01


def test_errors_that_are_passed_on_cancel():
    """Under lights that all stand to one side, where the functions are much alike."""
    lights = dome(24, 0.8) + np.array([0.0, 0.5, 0.0])
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    image = fit_ptm(board(lights, (24, 31)), lights).image
    offset = image.coefficients.min(axis=(1, 2, 3)).astype(np.float64)
    steps = Steps(np.ptp(image.coefficients, axis=(1, 2, 3)) / 255, offset)

    def rms(codes):
        back = np.moveaxis(steps.values(np.moveaxis(codes, 0, -1)), -1, 0)
        error = RelightableImage(back - image.coefficients, image.basis)
        return np.sqrt(np.mean([error.evaluate(light) ** 2 for light in lights]))

    shape = (6, 1, 1, 1)
    alone = np.rint((image.coefficients - offset.reshape(shape)) / steps.step.reshape(shape))
    assert rms(to_bytes(image, steps)) < 0.5 * rms(alone)


def test_rare_outliers_do_not_coarsen_the_steps():
    values = np.random.default_rng(0).normal(size=100_000).astype(np.float32)
    values[0] = 1000
    low, high = value_range(values)
    assert -6 < low < high < 10


def test_old_ptm_and_other_lines_are_read(tmp_path):
    """Version 1.1 has nine bytes a pixel; width and height may share a line, a blank may end it."""
    data = bytes(range(9 * 6))
    scales = b"1 1 1 1 1 2 \n0 0 0 0 0 10 \n"
    (tmp_path / "a.ptm").write_bytes(b"PTM_1.1\nPTM_FORMAT_LRGB\n3 2\n" + scales + data)
    image = read_ptm(tmp_path / "a.ptm")
    assert image.coefficients.shape == (6, 2, 3, 1)
    assert image.coefficients[0, 1, 0, 0] * 255 == pytest.approx(2 * (5 - 10))  # the constant, bottom left first
    np.testing.assert_allclose(image.colour[1, 0] * 255, [6, 7, 8], rtol=1e-6)


def test_four_terms_are_nine_of_which_five_are_none(tmp_path):
    numbers = np.arange(8, dtype="<f4").tobytes()
    (tmp_path / "a.rti").write_bytes(b"#HSH1.2\n#by hand\n3\n2 1 3\n4 2 1\n" + numbers + bytes(24))
    image = read_rti(tmp_path / "a.rti")
    assert image.coefficients.shape == (9, 1, 2, 3)
    assert sorted(image.coefficients[:, 0, 0, 0]) == [0, 0, 0, 0, 0, 4, 5, 6, 7]


@pytest.mark.parametrize(
    ("read", "content", "said"),
    [
        (read_ptm, b"P6\n1 1\n", "not a polynomial texture map"),
        (read_ptm, b"PTM_1.2\nPTM_FORMAT_RGB\n1\n1\n1 1 1 1 1 1\n", "not a polynomial texture map"),
        (read_ptm, b"PTM_1.2\nPTM_FORMAT_JPEG_LRGB\n1\n1\n1 1 1 1 1 1\n0 0 0 0 0 0\n", "without compression"),
        (read_ptm, b"PTM_1.2\nPTM_FORMAT_RGB\n1\n1\n1 1 1 1 1 x\n0 0 0 0 0 0\n", "a number is needed"),
        (read_ptm, b"PTM_1.2\nPTM_FORMAT_RGB\n2\n1\n1 1 1 1 1 1\n0 0 0 0 0 0\n" + bytes(35), "need 36 bytes"),
        (read_rti, b"#HSH1.2\n2\n1 1 3\n9 2 1\n", "not hemispherical harmonics"),
        (read_rti, b"#HSH1.2\n3\n1 1 3\n16 2 1\n", "16 terms"),
        (read_rti, b"#HSH1.2\n3\n1 1 3\n9 2 1\n" + bytes(98), "need 27 bytes, but 26"),
    ],
)
def test_damaged_files_are_refused(tmp_path, read, content, said):
    (tmp_path / "a").write_bytes(content)
    with pytest.raises(ImageError, match=f"a: .*{said}"):
        read(tmp_path / "a")


@pytest.mark.parametrize("read", [read_ptm, read_rti, read_relight])
def test_missing_files_are_refused(tmp_path, read):
    with pytest.raises(ImageError, match="absent"):
        read(tmp_path / "absent")


def test_web_folder_of_luminance_and_colour_is_read(tmp_path):
    """As Relight writes it: the colour's plane, then three coefficients in each picture."""
    codes = np.arange(2 * 9, dtype=np.uint8).reshape(1, 2, 9) * 10
    for number in range(3):
        picture = Image.fromarray(np.repeat(np.repeat(codes[..., 3 * number : 3 * number + 3], 8, 0), 8, 1))
        picture.save(tmp_path / f"plane_{number}.jpg", quality=100, subsampling="4:4:4")
    material = {"scale": [1, 1, 1, 2, 2, 2, 4, 4, 4], "bias": [0, 0, 0, 0.5, 0, 0, 0, 0, 0]}
    info = {"type": "ptm", "colorspace": "lrgb", "nplanes": 9, "materials": [material]}
    (tmp_path / "info.json").write_text(json.dumps(info))
    image = read_relight(tmp_path)
    np.testing.assert_allclose(image.colour[4, 3], codes[0, 0, :3] / 255, atol=0.02)
    expected = (codes[0, 1, 3:] / 255 - [0.5, 0, 0, 0, 0, 0]) * [2, 2, 2, 4, 4, 4]
    np.testing.assert_allclose(image.coefficients[:, 4, 12, 0], expected, atol=0.05)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"type": "rbf"}, "rbf"),
        ({"colorspace": "mycc"}, "mycc"),
        ({"nplanes": 12}, "12 planes"),
        ({"materials": []}, "no planes with scale"),
        (None, "not the description"),
        ([], "not the description"),
    ],
)
def test_other_web_folders_are_refused(tmp_path, change, said):
    write_relight(tmp_path, PTM)
    info = json.loads((tmp_path / "info.json").read_text())
    text = "{" if change is None else json.dumps(info | change if change else change)
    (tmp_path / "info.json").write_text(text)
    with pytest.raises(ImageError, match=f"info.json: .*{said}"):
        read_relight(tmp_path)


def test_a_missing_plane_is_named(tmp_path):
    write_relight(tmp_path, PTM)
    (tmp_path / "plane_3.jpg").write_bytes(b"")
    with pytest.raises(ImageError, match=r"plane_3\.jpg"):
        read_relight(tmp_path)


def test_planes_of_another_size_are_refused(tmp_path):
    write_relight(tmp_path, PTM)
    Image.new("RGB", (8, 9)).save(tmp_path / "plane_2.jpg")
    with pytest.raises(ImageError, match="not of one size"):
        read_relight(tmp_path)


def test_writers_refuse_other_bases(tmp_path):
    for write, image in ((write_ptm, HSH), (write_rti, PTM), (write_relight, as_lrgb(PTM)), (write_rti, as_lrgb(HSH))):
        with pytest.raises(ImageError):
            write(tmp_path / "a", image)
    assert not list(tmp_path.iterdir())


def test_light_positions_come_back(tmp_path):
    names = [f"folder of it/photo {n}.jpg" for n in range(len(LIGHTS))]
    write_lp(tmp_path / "a.lp", names, LIGHTS)
    read, lights = read_lp(tmp_path / "a.lp")
    assert read == names
    np.testing.assert_allclose(lights, LIGHTS, atol=2e-7)


def test_light_positions_as_others_write_them(tmp_path):
    """Without a count, with blank lines and positions in millimetres."""
    (tmp_path / "a.lp").write_text("\ufeffa.jpg 0 0 300\n\nb c.jpg\t30 0 40\r\n")
    names, lights = read_lp(tmp_path / "a.lp")
    assert names == ["a.jpg", "b c.jpg"]
    np.testing.assert_allclose(lights, [[0, 0, 1], [0.6, 0, 0.8]])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "says 0 lights, but has 0"),
        ("3\na.jpg 0 0 1\n", "says 3 lights, but has 1"),
        ("many\na.jpg 0 0 1\n", "but has 1"),
        ("1\na.jpg 0 0\n", "line 2: 'a.jpg 0 0' is not"),
        ("1\na.jpg 0 0 0\n", "line 2"),
        ("1\na.jpg 0 0 nan\n", "line 2"),
        ("1\na.jpg 1 0 -1\n", "behind the picture"),
    ],
)
def test_wrong_light_positions_name_the_line(tmp_path, text, said):
    (tmp_path / "a.lp").write_text(text)
    with pytest.raises(ImageError, match=f"a.lp: .*{said}"):
        read_lp(tmp_path / "a.lp")


def test_an_absent_list_is_refused(tmp_path):
    with pytest.raises(ImageError, match="absent"):
        read_lp(tmp_path / "absent.lp")
