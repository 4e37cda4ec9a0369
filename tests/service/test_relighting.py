"""`rig export` and `rig rti`: what they write, what they tell, what they refuse."""

import re

import numpy as np
import pytest
from PIL import Image

from processing.errors import ImageError
from processing.formats.light_positions import write_lp
from processing.formats.ptm import read_ptm
from processing.formats.relight import read_relight
from processing.formats.rti import read_rti
from processing.materials.ptm import fit_ptm, reproduction_db
from processing.products import Btf, LightStack, NormalMap, ReflectanceMaps
from processing.radiometry.display import linear_of_srgb, srgb8
from service.relighting import export_product, relight_photographs
from tests.reference.ptm import board, dome

LIGHTS = dome(24)
PICTURES = board(LIGHTS, (20, 26), seed=4)
LINEAR = (linear_of_srgb(PICTURES / np.float32(255)) / np.pi).astype(np.float32)


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stack") / "light_stack"
    seen = LINEAR.copy()
    seen[:, :2] = np.nan
    LightStack(seen, np.ones_like(seen), LIGHTS, np.full(24, np.inf), 1e-4).save(folder)
    return folder


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """A folder as a person has it: photographs, an .lp with paths of another machine, a mask."""
    folder = tmp_path_factory.mktemp("photographs")
    names = [f"IMG_{n:02d}.png" for n in range(24)]
    for name, picture in zip(names, PICTURES, strict=True):
        Image.fromarray(picture).save(folder / name)
    write_lp(folder / "dome.lp", [f"D:\\coins\\{name}" for name in names], 350 * LIGHTS)
    mask = np.zeros((20, 26), np.uint8)
    mask[4:16, 5:20] = 255
    Image.fromarray(mask).save(folder / "mask.tif")
    return folder


@pytest.mark.parametrize(
    ("name", "options", "read"),
    [
        ("a.ptm", {}, read_ptm),
        ("a.ptm", {"luminance": True}, read_ptm),
        ("a.rti", {}, read_rti),
        ("web", {}, read_relight),
        ("web", {"harmonics": True}, read_relight),
    ],
)
def test_a_stack_is_exported(stack, tmp_path, name, options, read):
    lines = list(export_product(stack, tmp_path / name, **options))
    assert [path.name for path in tmp_path.iterdir()] == [name]
    image = read(tmp_path / name)
    assert (image.colour is not None) == options.get("luminance", False)
    assert np.abs(image.evaluate(LIGHTS[0])[:2]).max() < 0.1  # not measured: black, but for what JPEG blurs
    assert "10.0% of the pixels were not measured" in lines[0]
    told_db = float(lines[1].split(" by ")[1].split()[0])
    # Of the same brightness but for the exposure, which leaves 0.5 % of the values above white.
    assert told_db == pytest.approx(reproduction_db(fit_ptm(PICTURES, LIGHTS).image, PICTURES, LIGHTS), abs=6)
    assert lines[2].startswith(f"{tmp_path / name}: 26 x 20 pixels")


def test_pictures_and_their_lights_are_exported(stack, tmp_path):
    """For other programs: what they read is what would have been fitted."""
    list(export_product(stack, tmp_path / "a.lp"))
    assert len(list(tmp_path.iterdir())) == 25
    list(relight_photographs(tmp_path, tmp_path / "out"))
    list(export_product(stack, tmp_path / "b.ptm"))
    again, direct = (
        read_ptm(path).evaluate(LIGHTS[5])[3:] for path in (tmp_path / "out/picture.ptm", tmp_path / "b.ptm")
    )
    assert np.sqrt(np.mean((again - direct) ** 2)) < 0.01


def test_a_btf_is_exported_as_seen_from_above(tmp_path):
    reflectance = np.zeros((24, 2, 4, 5, 3), np.float32)
    reflectance[:, 1] = 0.2
    views = np.array([[0.6, 0.0, 0.8], [0.0, 0.0, 1.0]])
    Btf(reflectance, LIGHTS, views).save(tmp_path / "btf")
    list(export_product(tmp_path / "btf", tmp_path / "a.ptm"))
    seen = read_ptm(tmp_path / "a.ptm").evaluate(np.array([0.0, 0.0, 1.0]))
    assert seen.min() > 0.9  # a matt board is white where the light is above


def test_a_sphere_is_exported(tmp_path):
    maps = np.full((24, 16, 16, 3), 0.1, np.float32)
    lights = LIGHTS * [1, -1, -1]
    ReflectanceMaps(maps, maps, lights, np.full(24, np.inf), np.inf).save(tmp_path / "maps")
    lines = list(export_product(tmp_path / "maps", tmp_path / "a.rti"))
    assert lines[-1].endswith("16 x 16 pixels over hemispherical")
    assert read_rti(tmp_path / "a.rti").evaluate(LIGHTS[3])[8, 8] == pytest.approx(1, abs=0.02)


def test_lights_of_one_arc_are_told(tmp_path):
    angles = np.deg2rad(np.linspace(-60, 60, 12))
    arc = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=-1)
    linear = np.ones((12, 3, 4, 3), np.float32) * arc[:, 2, None, None, None].astype(np.float32)
    LightStack(linear, np.ones_like(linear), arc, np.full(12, np.inf), 1e-4).save(tmp_path / "stack")
    lines = list(export_product(tmp_path / "stack", tmp_path / "a.ptm"))
    assert lines[0].startswith("WARNING: the 12 lights determine 3 of 6 coefficients")


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("a.jpg", {}, "no ending means a folder"),
        ("a.ptm", {"harmonics": True}, "leave --harmonics out"),
        ("a.lp", {"luminance": True}, "leave --luminance out"),
        ("a.rti", {"luminance": True}, "leave --luminance out"),
        ("web", {"luminance": True}, "leave --luminance out"),
    ],
)
def test_what_no_format_holds_is_refused(stack, tmp_path, name, options, said):
    with pytest.raises(ImageError, match=said):
        list(export_product(stack, tmp_path / name, **options))
    assert not list(tmp_path.iterdir())


def test_other_products_are_refused(tmp_path):
    shape = (2, 3)
    NormalMap(
        np.zeros((*shape, 3), np.float32), np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32),
        np.zeros(shape, np.uint8), 1e-4,
    ).save(tmp_path / "normals")  # fmt: skip
    with pytest.raises(ImageError, match="normals holds no pictures"):
        list(export_product(tmp_path / "normals", tmp_path / "a.ptm"))
    with pytest.raises(FileNotFoundError, match="its folder does not exist"):
        list(export_product(tmp_path / "normals", tmp_path / "absent" / "a.ptm"))


def test_photographs_become_files_and_a_stack(photographs, tmp_path):
    lines = list(relight_photographs(photographs, tmp_path / "out", photographs / "mask.tif", pixel_m=1e-4))
    assert "differs from the 24 pictures by" in "\n".join(lines)
    inside = np.zeros((20, 26), bool)
    inside[4:16, 5:20] = True
    masked = PICTURES * inside[:, :, None]
    fitted = reproduction_db(fit_ptm(masked, LIGHTS).image, masked, LIGHTS)
    written = reproduction_db(read_ptm(tmp_path / "out" / "picture.ptm"), masked, LIGHTS)
    assert written == pytest.approx(fitted, abs=0.05)
    assert read_relight(tmp_path / "out" / "web").coefficients.shape == (6, 20, 26, 3)
    stack = LightStack.load(tmp_path / "out" / "light_stack")
    np.testing.assert_allclose(stack.light_directions, LIGHTS, atol=1e-6)
    known = np.broadcast_to(inside[:, :, None], PICTURES.shape) & (PICTURES < 254)
    assert np.isnan(stack.reflectance_cos[~known]).all()
    np.testing.assert_allclose(stack.reflectance_cos[known], LINEAR[known], rtol=1e-5)
    assert (stack.variance[known] > 0).all()
    # One code more is within two deviations.
    step = np.abs(linear_of_srgb((PICTURES + np.float32(1)) / np.float32(255)) / np.pi - LINEAR)
    assert (step[known] < 2 * np.sqrt(stack.variance[known])).all()
    normals = NormalMap.load(tmp_path / "out" / "normals")
    assert re.search(rf"normals of {normals.measured.mean():.1%} of the pixels, to \d\.\d\d deg", "\n".join(lines))
    assert normals.measured[inside].mean() > 0.9
    assert not normals.measured[~inside].any()
    with Image.open(tmp_path / "out" / "normals.png") as picture:
        seen = np.asarray(picture).astype(float) / 127.5 - 1
    np.testing.assert_allclose(seen[normals.measured], normals.normals[normals.measured], atol=0.005)
    list(export_product(tmp_path / "out" / "light_stack", tmp_path / "again.rti"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["again.rti", "out"]


def test_linear_counts_of_sixteen_bits_are_the_same_light(photographs, tmp_path):
    linear = np.round(65535 * np.pi * LINEAR).astype(np.uint16)
    for number, picture in enumerate(linear):
        # Pillow writes no colours of 16 bits; grey ones it does.
        Image.fromarray(picture[..., 1]).save(tmp_path / f"IMG_{number:02d}.png")
    write_lp(tmp_path / "a.lp", [f"IMG_{n:02d}.png" for n in range(24)], LIGHTS)
    list(relight_photographs(tmp_path / "a.lp", tmp_path / "out", linear=True))
    stack = LightStack.load(tmp_path / "out" / "light_stack")
    seen = stack.reflectance_cos[..., 1]
    known = np.isfinite(seen)
    np.testing.assert_allclose(seen[known], LINEAR[..., 1][known], atol=1e-5)
    picture = read_ptm(tmp_path / "out" / "picture.ptm")
    assert reproduction_db(picture, np.repeat(srgb8(np.pi * LINEAR[..., 1:2]), 3, axis=-1), LIGHTS) > 20


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda folder: (folder / "IMG_03.png").unlink(), r"IMG_03\.png is not there"),
        (lambda folder: (folder / "dome.lp").unlink(), "none is there"),
        (lambda folder: write_lp(folder / "b.lp", ["IMG_01.png"], LIGHTS[:1]), "2 of them are in it"),
        (lambda folder: Image.new("RGB", (9, 9)).save(folder / "IMG_05.png"), "9 x 9 pixels of 8 bits, but 26 x 20"),
        (lambda folder: Image.new("L", (9, 9)).save(folder / "mask.tif"), "9 x 9 pixels; the photographs have others"),
        (lambda folder: Image.new("L", (26, 20)).save(folder / "mask.tif"), "black all over"),
    ],
)
def test_photographs_that_do_not_fit_are_refused(photographs, tmp_path, spoil, said):
    folder = tmp_path / "copy"
    folder.mkdir()
    for path in photographs.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    spoil(folder)
    with pytest.raises(ImageError, match=said):
        list(relight_photographs(folder, tmp_path / "out", folder / "mask.tif"))
    assert [path.name for path in tmp_path.iterdir()] == ["copy"]
