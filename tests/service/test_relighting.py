"""`rig export` and `rig rti`: what they write, what they tell, what they refuse."""

import re

import numpy as np
import pytest
from PIL import Image

from processing.errors import ImageError
from processing.formats.light_positions import read_lp, write_lp
from processing.formats.ptm import read_ptm
from processing.formats.relight import read_relight
from processing.formats.rti import read_rti
from processing.materials.ptm import fit_ptm, reproduction_db
from processing.products import Btf, LightStack, NormalMap, ReflectanceMaps
from processing.radiometry.display import linear_of_srgb, srgb8
from service.light_photographs import PhotographFiles, read_photographs
from service.relighting import export_product, relight_photographs
from tests.reference import shapes
from tests.reference.ptm import board, dome

LIGHTS = dome(24)
PICTURES = board(LIGHTS, (20, 26), seed=4)
SIZE = 48
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
    list(relight_photographs(PhotographFiles(tmp_path), tmp_path / "out"))
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
    lines = list(
        relight_photographs(PhotographFiles(photographs, photographs / "mask.tif"), tmp_path / "out", pixel_m=1e-4)
    )
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
    np.testing.assert_allclose(read_lp(tmp_path / "out" / "lights.lp")[1], LIGHTS, atol=1e-6)
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
    list(relight_photographs(PhotographFiles(tmp_path / "a.lp", linear=True), tmp_path / "out"))
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
        list(relight_photographs(PhotographFiles(folder, folder / "mask.tif"), tmp_path / "out"))
    assert [path.name for path in tmp_path.iterdir()] == ["copy"]


def test_results_do_not_go_among_the_photographs(photographs):
    for source in (photographs, photographs / "dome.lp"):
        with pytest.raises(ImageError, match="name another folder"):
            list(relight_photographs(PhotographFiles(source), photographs))
    assert not (photographs / "lights.lp").exists()


@pytest.mark.parametrize("lights", [LIGHTS[:1], np.array([[0.6, 0, 0.8], [0, 0, 1], [-0.6, 0, 0.8], [0.28, 0, 0.96]])])
def test_too_few_lights_are_told_and_still_make_a_picture(tmp_path, lights):
    """One light, and four in a plane."""
    for number in range(len(lights)):
        Image.fromarray(PICTURES[number]).save(tmp_path / f"{number}.png")
    write_lp(tmp_path / "a.lp", [f"{number}.png" for number in range(len(lights))], lights)
    lines = list(relight_photographs(PhotographFiles(tmp_path), tmp_path / "out"))
    assert lines[0].startswith(f"WARNING: the {len(lights)} lights determine")
    assert "no normals: four lights or more" in "\n".join(lines)


BALL_LIGHTS = dome(8, 0.5)
STRENGTHS = np.array([1.0, 0.7, 1.2, 0.9, 1.1, 0.8, 1.0, 1.3])


@pytest.fixture(scope="module")
def balls(tmp_path_factory):
    """A matt ball and a chrome ball side by side under eight lights of unequal strength, and masks of both."""
    folder = tmp_path_factory.mktemp("balls")
    _, normal = shapes.ball(SIZE)
    mirrored = 2 * normal[..., 2:] * normal - [0.0, 0.0, 1.0]
    for number, (light, strength) in enumerate(zip(BALL_LIGHTS, STRENGTHS, strict=True)):
        with np.errstate(invalid="ignore"):
            matt = 0.7 * strength * np.maximum(normal @ light, 0)
            spot = np.where(mirrored @ light > np.cos(0.15), 1.0, 0.03)
        picture = srgb8(np.nan_to_num(np.hstack([matt, spot])))
        Image.fromarray(picture).save(folder / f"photo {number + 3}.png")
    x, y = shapes.grid(SIZE)
    disc = np.hypot(x, y) < 0.9
    for name, parts in (("matt.png", (disc, 0 * disc)), ("chrome.png", (0 * disc, disc))):
        Image.fromarray(np.hstack(parts).astype(np.uint8) * 255).save(folder / name)
    return folder


def test_lights_and_their_strengths_come_from_the_photographs(balls, tmp_path):
    """What a person does who has only a chrome ball: the names count as numbers, so that 10 comes after 9."""
    files = PhotographFiles(balls, balls / "matt.png", balls / "chrome.png")
    lines = list(relight_photographs(files, tmp_path / "out", unequal_lights=True))
    assert lines[0].startswith("8 lights in the chrome sphere, ")
    told = float(re.search(r"strongest light is (\S+) times", lines[1])[1])
    assert told == pytest.approx(1.3 / 0.7, rel=0.05)
    stack, normals = LightStack.load(tmp_path / "out" / "light_stack"), NormalMap.load(tmp_path / "out" / "normals")
    # A pixel is 2.7 deg of reflection in the middle, more outward; the centroid of a spot errs by less.
    assert (stack.light_directions * BALL_LIGHTS).sum(axis=1).min() > np.cos(np.radians(2.7))
    truth = shapes.ball(SIZE)[1]
    where = normals.measured[:, :SIZE] & (truth[..., 2] > 0.5)
    cosine = (normals.normals[:, :SIZE] * truth).sum(axis=-1)[where]
    assert np.degrees(np.arccos(np.clip(np.median(cosine), -1, 1))) < 2
    # The same surface under the strongest and the weakest light is as bright as its normals say.
    values = [stack.reflectance_cos[n, :, :SIZE, 1][where] / (truth[where] @ BALL_LIGHTS[n]) for n in (7, 1)]
    assert np.median(values[0]) == pytest.approx(np.median(values[1]), rel=0.03)
    picture = read_ptm(tmp_path / "out" / "picture.ptm")
    seen = [picture.evaluate(BALL_LIGHTS[n])[SIZE // 2, SIZE // 2, 1] for n in (7, 1)]
    expected = [BALL_LIGHTS[n, 2] for n in (7, 1)]
    ratio = linear_of_srgb(np.array(seen))
    assert ratio[0] / ratio[1] == pytest.approx(expected[0] / expected[1], rel=0.1)


def test_a_chrome_ball_may_have_photographs_of_its_own(balls, tmp_path):
    ball = tmp_path / "ball"
    ball.mkdir()
    for path in balls.iterdir():
        if path.name != "matt.png":
            with Image.open(path) as picture:
                picture.crop((SIZE, 0, 2 * SIZE, SIZE)).save(ball / path.name)
    (tmp_path / "thing").mkdir()
    for number in range(8):
        Image.fromarray(PICTURES[number]).save(tmp_path / "thing" / f"{number}.png")
    together = read_photographs(PhotographFiles(balls, balls / "matt.png", balls / "chrome.png"))
    apart = read_photographs(PhotographFiles(tmp_path / "thing", chrome=ball / "chrome.png"))
    np.testing.assert_allclose(apart.lights, together.lights, atol=1e-9)
    (tmp_path / "thing" / "7.png").unlink()
    with pytest.raises(ImageError, match="8 photographs of the chrome sphere, but 7"):
        read_photographs(PhotographFiles(tmp_path / "thing", chrome=ball / "chrome.png"))
    with pytest.raises(ImageError, match=r"absent\.png: not there"):
        read_photographs(PhotographFiles(tmp_path / "thing", chrome=ball / "absent.png"))
    with pytest.raises(ImageError, match="not a folder"):
        read_photographs(PhotographFiles(ball / "photo 3.png", chrome=ball / "chrome.png"))
