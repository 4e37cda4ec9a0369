"""Two sessions' products joined to one material, and what is said where they do not belong together."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from processing.errors import ImageError
from processing.products import Btf, Mdf, Mesostructure
from rig.sessions import Session, parse_plan
from service.cli import app
from service.joining import join_sessions
from tests.benchmarks.yardsticks.material_samples import rings
from tests.rig.sessions.fake_rig import config

DIRECTIONS = rings(((0, 1), (40, 6), (60, 6)))
SAMPLE = {"sample": "weave", "turntable_deg": [0, 90], "cameras": ["cam0", "cam1"], "texels": 8, "depth_mm": 1.0}
PLANS = {
    "btf": {"kind": "btf", "light_azimuth_deg": [45], "lamps": ["lamp0"], "exposures_s": [0.02]},
    "mdf": {
        "kind": "mdf", "laser_azimuth_deg": [45], "laser_elevations_deg": [50], "exposure_s": 0.03,
        "frame_rate_hz": 7.5,
    },
}  # fmt: skip


def session(folder: Path, kind: str, **changes) -> Path:
    """A session of this kind, without its frames."""
    with Session.create(folder, parse_plan(PLANS[kind] | SAMPLE | changes), config()) as made:
        return made.folder


def add_btf(folder: Path, texels: int = 8) -> None:
    """What it looks like, as if it had been processed."""
    values = np.ones((len(DIRECTIONS), len(DIRECTIONS), texels, texels, 3), np.float32)
    Btf(values, DIRECTIONS, DIRECTIONS).save(folder / "products" / "btf")


def add_mdf(folder: Path, directions: np.ndarray = DIRECTIONS, missing: int = 0) -> None:
    """How deep it is: level 1.5 mm under the opening, some rows of texels not measured."""
    displacement_m = np.float32(0.0015) / directions[:, 2:, None] * np.ones((1, 8, 8))
    displacement_m[:, :missing] = np.nan
    Mdf(displacement_m, displacement_m, directions, 0.060, plane_m=0.001).save(folder / "products" / "mdf")


@pytest.fixture
def pair(tmp_path):
    """A btf and an mdf session of one weave, processed."""
    folders = session(tmp_path / "looks", "btf"), session(tmp_path / "depths", "mdf")
    add_btf(folders[0])
    add_mdf(folders[1], missing=2)
    return folders


def test_joined_it_is_a_product_that_names_both_sessions(pair, tmp_path):
    looks, depths = pair
    result = CliRunner().invoke(app, ["join", str(looks), str(depths), "--out", str(tmp_path / "weave")])
    assert result.exit_code == 0, result.output
    assert "13 views of 8 x 8 texels, at most 1.5 mm deep" in result.output
    assert "25.0% of the depths were not measured" in result.output
    assert "lasers from more sides" in result.output
    assert "8 eigenmaps leave 0.0% of what the BTF shows" in result.output
    made = Mesostructure.load(tmp_path / "weave")
    np.testing.assert_allclose(made.depths * made.step * 60, 1.5, rtol=1e-5)
    assert made.plane == pytest.approx(1 / 60)
    ids = [json.loads((folder / "session.json").read_text())["id"] for folder in pair]
    assert list(made.provenance.frames) == ids


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sample": "brick"}, "different samples: weave and brick"),
        ({"texels": 16}, "different texels: 8 and 16"),
        ({"depth_mm": 0.5}, "different depth_mm of the texels: 1.0 and 0.5"),
    ],
)
def test_plans_that_differ_are_told(pair, tmp_path, changes, words):
    other = session(tmp_path / "other", "mdf", **changes)
    add_mdf(other)
    with pytest.raises(ImageError, match=f"looks and .*other have {words}"):
        list(join_sessions(pair[0], other, tmp_path / "weave"))
    assert not (tmp_path / "weave").exists()


@pytest.mark.parametrize(
    ("views", "words"),
    [(DIRECTIONS * [1, 1, 0.3], "12 of the BTF's 13 views"), (DIRECTIONS[:7], "6 of the BTF's 13 views")],
)
def test_views_that_differ_are_told(pair, tmp_path, views, words):
    add_mdf(pair[1], views / np.linalg.norm(views, axis=1, keepdims=True))
    with pytest.raises(ImageError, match=f"cannot be joined: {words}"):
        list(join_sessions(*pair, tmp_path / "weave"))


def test_sessions_of_other_kinds_and_unprocessed_ones_are_told(pair, tmp_path):
    for wrong in (pair[::-1], (pair[0], pair[0])):
        with pytest.raises(ImageError, match="first a btf session, then an mdf session"):
            list(join_sessions(*wrong, tmp_path / "weave"))
    raw = session(tmp_path / "raw", "mdf")
    with pytest.raises(ImageError, match=r"raw: has no mdf yet; `rig process .*raw` makes it"):
        list(join_sessions(pair[0], raw, tmp_path / "weave"))
    with pytest.raises(FileNotFoundError):
        list(join_sessions(*pair, tmp_path / "nowhere" / "weave"))
