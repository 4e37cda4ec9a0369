"""`rig analyse`: what it writes and says of a small BTF, and what cannot be analysed."""

import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from processing.formats.ubo import Encoding, UboOptions, import_ubo
from processing.products import Btf, SbrdfPlus
from service.cli import app
from service.pipeline.sbrdf import make_sbrdf_plus
from tests.service.studs import write_studs

RINGS = ((0, 1), (30, 3), (60, 5))
TEXELS = 16


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    """A folder with a BTF of 9 x 9 directions, analysed."""
    folder = tmp_path_factory.mktemp("workshop")
    write_studs(folder / "studs", TEXELS, RINGS)
    import_ubo(folder / "studs", folder / "btf", UboOptions(Encoding.LINEAR))
    return folder


@pytest.fixture(scope="module")
def said(workshop):
    result = rig_analyse(workshop / "btf", workshop / "out")
    assert result.exit_code == 0, result.output
    return result.stdout


def rig_analyse(product, out):
    return CliRunner().invoke(app, ["analyse", str(product), "--out", str(out)])


def percent(name, text):
    return float(re.search(rf"{re.escape(name)} ([\d.]+)%", text)[1])


def test_errors_fall_from_step_to_step(said):
    assert percent("SBRDF", said) > percent("STVS", said) > percent("SBRDF+", said)
    assert "9 lights x 9 views of 16 x 16 texels, 0.0622 MB at 8 bits" in said
    shadowed, voted, left = (float(share) for share in re.findall(r"([\d.]+)% (?:of|after)", said)[:3])
    assert 1 < shadowed < 60  # studs as high as a third of their distance shade under lights at 60 deg
    assert left <= voted


def test_folder_holds_the_product_its_levels_and_pictures(workshop, said):
    out = workshop / "out"
    assert sorted(path.name for path in out.iterdir()) == sorted(
        ["sbrdf_plus", "steps.png", "reconstruction.png", "errors.png"]
    )
    product = SbrdfPlus.load(out / "sbrdf_plus")
    assert [level.lobes.shape for level in product.coarser] == [(8, 8), (4, 4), (2, 2), (1, 1)]
    assert f"{product.size_bytes / 1e6:.3g} MB" in said
    for picture in out.glob("*.png"):
        with Image.open(picture) as image:
            assert np.asarray(image.convert("L")).std() > 5


def test_a_folder_in_use_is_left_alone(workshop, said):
    before = sorted(path.stat().st_mtime_ns for path in (workshop / "out").iterdir())
    result = rig_analyse(workshop / "btf", workshop / "out")
    assert result.exit_code == 5
    assert "exists and is not empty; nothing was overwritten" in result.stderr
    assert sorted(path.stat().st_mtime_ns for path in (workshop / "out").iterdir()) == before


def chosen(btf, *, views=slice(None), lights=slice(None), reflectance=None):
    values = btf.reflectance if reflectance is None else reflectance
    return replace(
        btf,
        reflectance=values[lights][:, views],
        light_directions=btf.light_directions[lights],
        view_directions=btf.view_directions[views],
    )


CANNOT = {
    "two views": (lambda btf: chosen(btf, views=slice(2)), "the 2 views do not span an area"),
    "one light": (lambda btf: chosen(btf, lights=slice(1)), "the 1 lights do not span an area"),
    "no top": (lambda btf: chosen(btf, views=slice(1, None)), "the highest view is 30 deg from the normal"),
    "nothing": (
        lambda btf: chosen(btf, reflectance=np.full_like(btf.reflectance, np.nan)),
        "the view from the top has no measured value",
    ),
}


@pytest.mark.parametrize("name", CANNOT)
def test_what_cannot_carry_it_is_one_line_and_leaves_nothing(workshop, tmp_path, name):
    spoil, told = CANNOT[name]
    spoil(Btf.load(workshop / "btf")).save(tmp_path / "btf")
    result = rig_analyse(tmp_path / "btf", tmp_path / "out")
    assert result.exit_code == 2
    (line,) = result.stderr.splitlines()
    assert line.startswith(f"unusable-image: {tmp_path / 'btf'}: cannot be analysed: {told}")
    assert [path.name for path in tmp_path.iterdir()] == ["btf"]


def test_processing_tells_it_in_a_note_and_goes_on(workshop, tmp_path):
    class Notes:
        def __init__(self):
            self.told = []

        def note(self, text):
            self.told.append(text)

    notes, btf = Notes(), Btf.load(workshop / "btf")
    chosen(btf, views=slice(1, None)).save(tmp_path / "btf")
    assert not make_sbrdf_plus(tmp_path / "btf", tmp_path / "sbrdf_plus", btf.provenance, notes)
    assert notes.told == ["no SBRDF+: the highest view is 30 deg from the normal, more than 25"]
    assert not make_sbrdf_plus(workshop / "btf", tmp_path / "sbrdf_plus", btf.provenance, notes)
    assert notes.told[1].startswith("no SBRDF+: 9 lights x 9 views are too few")
    assert not (tmp_path / "sbrdf_plus").exists()


def test_what_is_no_btf_is_told(workshop, said, tmp_path):
    for product, told in ((workshop / "studs", "not a product"), (workshop / "out" / "sbrdf_plus", "is no BTF")):
        result = rig_analyse(product, tmp_path / "out")
        assert result.exit_code == 2
        (line,) = result.stderr.splitlines()
        assert told in line
    assert list(tmp_path.iterdir()) == []


def test_missing_samples_take_no_part(workshop, tmp_path):
    """A tenth of them, and a texel that nobody measured."""
    btf = Btf.load(workshop / "btf")
    values = btf.reflectance.copy()
    values[np.random.default_rng(3).random(values.shape[:4]) < 0.1] = np.nan
    values[:, :, 3, 4] = np.nan
    chosen(btf, reflectance=values).save(tmp_path / "btf")
    result = rig_analyse(tmp_path / "btf", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert re.search(r"10\.\d% of the samples were not measured", result.stdout)
    assert percent("SBRDF", result.stdout) > percent("SBRDF+", result.stdout)
