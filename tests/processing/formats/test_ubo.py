"""BTFs as pictures of a folder or zip: round trips, gaps, parts, refusals."""

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from processing.errors import ImageError
from processing.formats.ubo import Encoding, UboOptions, import_ubo
from processing.products import Btf, StoredBtf
from simulators.far_field import btf_below
from tests.reference.ubo import angles, codes, pictures, vectors, write_folder, write_zip

LIGHTS = vectors([(0, 0), (15, 60), (45, 200), (75, 340)])
VIEWS = vectors([(0, 0), (30, 90), (60, 270)])
TEXELS = 12
HALF = 2.0**-11  # rounding of float16


@pytest.fixture(scope="module")
def simulated():
    """Brick at the simulators' own depth, no value beyond a perfect diffuser's."""
    reflectance = np.minimum(btf_below("brick", 2, (LIGHTS, VIEWS), TEXELS, 1, 1.0e-3), 1 / np.pi)
    return Btf(reflectance.astype(np.float32), LIGHTS, VIEWS)


@pytest.fixture
def files(simulated):
    return dict(pictures(simulated))


def rounded(btf, *, srgb=True):
    """What is left of the reflectance after 8 bits: the middle between what codes beside it stand for, and a half."""
    cosine = btf.light_directions[:, 2][:, None, None, None, None]
    value = codes(np.pi * cosine * btf.reflectance.astype(np.float64), srgb=srgb) / 255
    if srgb:
        value = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return value / (np.pi * cosine)


@pytest.mark.parametrize("srgb", [True, False])
@pytest.mark.parametrize("write", [write_zip, write_folder])
def test_a_btf_comes_back_from_its_pictures(tmp_path, simulated, write, srgb):
    source = write(tmp_path / "UBO_TEST.zip", pictures(simulated, srgb=srgb))
    encoding = Encoding.SRGB if srgb else Encoding.LINEAR
    stored = import_ubo(source, tmp_path / "btf", UboOptions(encoding))
    assert isinstance(stored, StoredBtf)
    after = Btf.load(tmp_path / "btf")
    np.testing.assert_allclose(after.light_directions, LIGHTS, atol=1e-12)
    np.testing.assert_allclose(after.view_directions, VIEWS, atol=1e-12)
    np.testing.assert_allclose(after.reflectance, rounded(simulated, srgb=srgb), rtol=HALF, atol=1e-6)
    parameters = after.provenance.parameters
    assert parameters["pictures"] == 12
    assert parameters["encoding"] == str(encoding)
    assert 0 <= parameters["brightest"] <= 1


def test_jpeg_costs_little(tmp_path, simulated):
    """Of a flat picture, where compression has nothing to lose."""
    flat = replace(simulated, reflectance=np.full_like(simulated.reflectance, 0.1))
    stored = import_ubo(write_zip(tmp_path / "a.zip", pictures(flat, ending="jpg")), tmp_path / "btf")
    assert np.abs(stored.rows(slice(None)) - 0.1).max() < 0.1 * 0.05


@pytest.mark.parametrize(
    "style",
    [
        "tl{tl:03d}_pl{pl:03d}_tv{tv:03d}_pv{pv:03d}",
        "WoolPKNT256_{i:05d}_tl{tl:03d}_pl{pl:03d}_tv{tv:03d}_pv{pv:03d}",
        "{i} TL{tl} PL{pl} TV{tv} PV{pv}",
    ],
)
def test_names_are_read_from_their_end(tmp_path, simulated, style):
    source = write_zip(tmp_path / "a.zip", pictures(simulated, style=style))
    assert import_ubo(source, tmp_path / "btf").shape == simulated.shape


def test_order_and_neighbours_do_not_matter(tmp_path, files):
    one = import_ubo(write_zip(tmp_path / "a.zip", files.items()), tmp_path / "a")
    other = dict(reversed(files.items())) | {
        "readme.txt": b"read me",
        "__MACOSX/._00000 tl000 pl000 tv000 pv000.png": b"",
    }
    other["UBO_TEST/overview.jpg"] = b"not a picture"
    two = import_ubo(write_zip(tmp_path / "b.zip", other.items()), tmp_path / "b")
    np.testing.assert_array_equal(one.rows(slice(None)), two.rows(slice(None)))


def test_pairs_without_a_picture_are_missing(tmp_path, files):
    gone = sorted(files)[4]
    kept = {name: content for name, content in files.items() if name != gone}
    stored = import_ubo(write_zip(tmp_path / "a.zip", kept.items()), tmp_path / "btf")
    missing = np.isnan(stored.rows(slice(None))).all(axis=(2, 3, 4))
    assert missing.sum() == 1
    assert np.isnan(stored.rows(slice(None))).sum() == TEXELS**2 * 3


def test_lights_that_are_not_above_are_missing(tmp_path, files):
    """And no division by a cosine of nothing."""
    low = {name.replace("tl075", "tl090"): content for name, content in files.items()}
    stored = import_ubo(write_zip(tmp_path / "a.zip", low.items()), tmp_path / "btf").rows(slice(None))
    assert np.isnan(stored[3]).all()
    assert np.isfinite(stored[:3]).all()


def test_white_scales(tmp_path, files):
    source = write_zip(tmp_path / "a.zip", files.items())
    plain = import_ubo(source, tmp_path / "a").rows(slice(None))
    half = import_ubo(source, tmp_path / "b", UboOptions(white=0.5)).rows(slice(None))
    np.testing.assert_allclose(half, 2 * plain, rtol=2 * HALF, atol=1e-6)
    with pytest.raises(ImageError, match="white"):
        UboOptions(white=0.0)


def test_a_region_is_cut_out_then_averaged(tmp_path, files):
    source = write_zip(tmp_path / "a.zip", files.items())
    whole = import_ubo(source, tmp_path / "a").rows(slice(None))
    part = import_ubo(source, tmp_path / "b", UboOptions(region=(2, 4, 6, 8), size=(3, 4))).rows(slice(None))
    blocks = whole[:, :, 2:8, 4:12].reshape(4, 3, 3, 2, 4, 2, 3).mean(axis=(3, 5))
    np.testing.assert_allclose(part, blocks, rtol=4 * HALF, atol=1e-6)


def test_the_report_counts_pictures(tmp_path, files):
    told = []
    import_ubo(write_zip(tmp_path / "a.zip", files.items()), tmp_path / "btf", report=lambda *now: told.append(now))
    assert told[-1] == (12, 12)
    assert [read for read, _ in told] == sorted(read for read, _ in told)


def grey16():
    picture = io.BytesIO()
    Image.fromarray(np.zeros((TEXELS, TEXELS), np.uint16)).save(picture, "png")
    return picture.getvalue()


def smaller():
    picture = io.BytesIO()
    Image.fromarray(np.zeros((TEXELS, 5, 3), np.uint8)).save(picture, "png")
    return picture.getvalue()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda name, content: {name: content[: len(content) // 2]}, "not a whole picture"),
        (lambda name, content: {name: b""}, "not a whole picture"),
        (lambda name, content: {name: grey16()}, "more than 8 bits"),
        (lambda name, content: {name: smaller()}, "12 x 5 pixels, those before it 12 x 12"),
        (lambda name, content: {f"again/{name}": content}, "same directions"),
    ],
)
@pytest.mark.parametrize("place", [0, 7])
def test_what_cannot_be_used_is_named_and_leaves_nothing(tmp_path, files, place, change, message):
    name = sorted(files)[place]
    source = write_zip(tmp_path / "a.zip", (files | change(name, files[name])).items())
    with pytest.raises(ImageError, match="those before it" if place == 0 and "12 x 5" in message else message) as told:
        import_ubo(source, tmp_path / "made" / "btf")
    assert "a.zip" in str(told.value)
    assert not (tmp_path / "made" / "btf").exists()
    assert not list((tmp_path / "made").glob("*") if (tmp_path / "made").exists() else [])


def test_all_azimuths_are_one_at_the_top(tmp_path, files):
    name = next(name for name in files if "tl000 pl000 tv000" in name)
    twice = files | {name.replace("pl000", "pl180"): files[name]}
    with pytest.raises(ImageError, match="same directions"):
        import_ubo(write_zip(tmp_path / "a.zip", twice.items()), tmp_path / "btf")


@pytest.mark.parametrize(
    ("rows", "message"), [((0, 0, 13, 4), "beyond"), ((-1, 0, 4, 4), "beyond"), ((0, 9, 4, 4), "beyond")]
)
def test_a_region_outside_is_refused(tmp_path, files, rows, message):
    source = write_zip(tmp_path / "a.zip", files.items())
    with pytest.raises(ImageError, match=message):
        import_ubo(source, tmp_path / "btf", UboOptions(region=rows))
    with pytest.raises(ImageError, match="averaged down"):
        import_ubo(source, tmp_path / "btf", UboOptions(size=(13, 12)))


def test_what_is_no_btf_is_refused(tmp_path, files):
    empty = tmp_path / "empty"
    empty.mkdir()
    text, other, cut = tmp_path / "a.txt", tmp_path / "other.zip", tmp_path / "cut.zip"
    text.write_text("not a zip")
    write_zip(other, [("picture.jpg", b"")])
    whole = write_zip(tmp_path / "whole.zip", files.items()).read_bytes()
    cut.write_bytes(whole[: len(whole) // 2])
    for source, message in [
        (empty, "no picture has a name that ends like"),
        (other, "no picture has a name that ends like"),
        (text, "neither a folder nor a zip"),
        (cut, "neither a folder nor a zip"),
        (tmp_path / "nowhere", "neither a folder nor a zip"),
    ]:
        with pytest.raises(ImageError, match=message):
            import_ubo(source, tmp_path / "btf")
    assert not (tmp_path / "btf").exists()


def test_a_folder_in_use_is_left_alone(tmp_path, files):
    source = write_zip(tmp_path / "a.zip", files.items())
    (tmp_path / "empty").mkdir()
    import_ubo(source, tmp_path / "empty")
    with pytest.raises(ImageError, match="new or empty"):
        import_ubo(source, tmp_path / "empty")
    assert Btf.load(tmp_path / "empty").shape == (4, 3, TEXELS, TEXELS, 3)


def test_more_directions_than_a_chunk(tmp_path):
    """10 x 9 directions are four blocks of at most 8 x 8; the names are of whole degrees."""
    rng = np.random.default_rng(0)
    lights = vectors([(5 * n, 30 * n) for n in range(10)])
    views = vectors([(6 * n, 350 - 30 * n) for n in range(9)])
    btf = Btf(rng.uniform(0, 0.3, (10, 9, 3, 5, 3)).astype(np.float32), lights, views)
    after = import_ubo(write_zip(tmp_path / "a.zip", pictures(btf)), tmp_path / "btf")
    assert angles(after.light_directions) == angles(lights)
    np.testing.assert_allclose(after.rows(slice(None)), rounded(btf), rtol=HALF, atol=1e-6)
