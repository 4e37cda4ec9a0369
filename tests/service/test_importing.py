"""`rig import`: what it tells, and what is no BTF; reading itself is tested with the format."""

import zipfile

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from processing.products import StoredBtf
from service.cli import app
from service.viewing import draw_product, lights_of
from tests.service.studs import write_studs

RINGS = ((0, 1), (50, 3))


@pytest.fixture(scope="module")
def studs(tmp_path_factory):
    return write_studs(tmp_path_factory.mktemp("published") / "studs", 12, RINGS)


def rig_import(*arguments):
    return CliRunner().invoke(app, ["import", *map(str, arguments)])


def zipped(folder, file):
    with zipfile.ZipFile(file, "w") as archive:
        for path in sorted(folder.iterdir()):
            archive.write(path, f"STUDS/{path.name}")
    return file


def test_a_folder_and_its_zip_are_the_same_product(studs, tmp_path):
    results = [
        rig_import(studs, "--out", tmp_path / "one"),
        rig_import(zipped(studs, tmp_path / "s.zip"), "-o", tmp_path / "two"),
    ]
    for result in results:
        assert result.exit_code == 0, result.output
        assert "16 pictures: 4 lights x 4 views of 12 x 12 texels" in result.output
    one, two = (StoredBtf.open(tmp_path / name) for name in ("one", "two"))
    np.testing.assert_array_equal(one.rows(slice(None)), two.rows(slice(None)))
    assert "as measured" in draw_product(tmp_path / "one", tmp_path / "btf.png", "", lights_of(0, 45, None), 48)


def test_options_say_how_pictures_become_texels(studs, tmp_path):
    more = ("--linear", "--white", "0.5", "--region", "0,2,12,8", "--size", "6,4")
    assert rig_import(studs, "--out", tmp_path / "part", *more).exit_code == 0
    assert rig_import(studs, "--out", tmp_path / "whole", "--linear").exit_code == 0
    part, whole = (StoredBtf.open(tmp_path / name).image(0, 0) for name in ("part", "whole"))
    assert part.shape == (4, 6, 3)
    means = whole[2:10].reshape(4, 2, 6, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(part, 2 * means, rtol=2e-3)


def test_pairs_that_lack_are_told(studs, tmp_path):
    (tmp_path / "some").mkdir()
    for path in sorted(studs.iterdir())[:-3]:
        (tmp_path / "some" / path.name).symlink_to(path)
    assert "3 pairs of a light and a view have no picture" in rig_import(tmp_path / "some", "-o", tmp_path / "o").output


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        ("nothing", "neither a folder nor a zip"),
        ("no images", "no picture has a name that ends like"),
        ("a zip without images", "no picture has a name that ends like"),
        ("a cut zip", "neither a folder nor a zip|not a whole zip"),
        ("a cut picture in a zip", "not a whole picture"),
        ("a size", "all pictures of a BTF are of one size"),
        ("a region", "region '1,2,3': whole numbers are needed, LEFT,TOP,WIDTH,HEIGHT"),
        ("a white", "value of white is 0"),
    ],
)
def test_what_is_no_btf_is_one_line_and_leaves_nothing(studs, tmp_path, damage, told):
    source, more = tmp_path / "source", []
    if damage in ("no images", "a zip without images"):
        source.mkdir()
        (source / "readme.txt").write_text("a picture is not here")
    elif damage != "nothing":
        source.mkdir()
        for path in studs.iterdir():
            (source / path.name).write_bytes(path.read_bytes())
    last = max(source.iterdir()) if source.is_dir() else None
    if damage == "a size":
        Image.new("RGB", (9, 9)).save(last)
    elif damage == "a cut picture in a zip":
        last.write_bytes(last.read_bytes()[:200])
    if "zip" in damage:
        source = zipped(source, tmp_path / "source.zip")
    if damage == "a cut zip":
        source.write_bytes(source.read_bytes()[:-400])
    more = {"a region": ["--region", "1,2,3"], "a white": ["--white", "0"]}.get(damage, [])
    before = sorted(tmp_path.iterdir())
    result = rig_import(source, "--out", tmp_path / "out", *more)
    assert result.exit_code == 2, result.output
    (line,) = result.stderr.splitlines()
    assert line.startswith("unusable-image: ")
    assert any(part in line for part in told.split("|")), line
    assert sorted(tmp_path.iterdir()) == before


def test_a_folder_in_use_is_left_alone(studs, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    for out in ("mine", "mine/thesis.txt"):
        result = rig_import(studs, "--out", tmp_path / out)
        assert result.exit_code == 5
        assert "exists and is not empty; nothing was overwritten" in result.stderr
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["thesis.txt"]
    assert rig_import(studs, "--out", tmp_path / "nowhere" / "out").exit_code == 5
