"""Pictures of materials under an environment, as `rig preview --environment` draws them."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from render.errors import SceneError
from service.cli import app
from service.routes.sessions import _products
from service.viewing import ENVIRONMENT_LIGHTS, draw_product, lights_of
from tests.render import synthetic


@pytest.fixture
def sky(tmp_path):
    cv2.imwrite(str(tmp_path / "sky.hdr"), synthetic.daylight(16).radiance[:, :, ::-1])
    return tmp_path / "sky.hdr"


@pytest.fixture
def product(tmp_path):
    synthetic.stone(16, 16).save(tmp_path / "srf")
    return tmp_path / "srf"


def test_environment_is_turned_by_the_azimuth(sky):
    one, turned = (lights_of(azimuth_deg, 45.0, sky) for azimuth_deg in (0.0, 90.0))
    assert 1 < len(one) <= ENVIRONMENT_LIGHTS
    for a, b in zip(one, turned, strict=True):
        np.testing.assert_allclose([-a.direction[1], a.direction[0], a.direction[2]], b.direction, atol=1e-9)
    assert len(lights_of(0.0, 45.0, None)) == 1


def test_preview_under_an_environment(product, sky, tmp_path):
    """It fills the shadow that one light leaves."""
    out = tmp_path / "statue.png"
    arguments = ["preview", str(product), "--out", str(out), "--shape", "sphere", "--size", "48"]
    dark = []
    for more in ([], ["--environment", str(sky)]):
        result = CliRunner().invoke(app, [*arguments, *more])
        assert result.exit_code == 0, result.output
        with Image.open(out) as image:
            dark.append(np.mean(np.asarray(image)[8:40, 8:40].max(axis=2) < 30))
    assert dark[1] < 0.5 * dark[0]


def test_folder_of_pictures_has_a_light_of_its_own(product, sky, tmp_path):
    with pytest.raises(SceneError, match="not a folder"):
        draw_product(product, tmp_path / "all", "", lights_of(0.0, 0.0, sky), 48)
    assert not (tmp_path / "all").exists()


def test_sbrdf_plus_is_drawn_on_any_shape(tmp_path):
    synthetic.weave((8, 8)).save(tmp_path / "sbrdf_plus")
    pictures = []
    for shape in ("", "statue"):
        arguments = ["preview", str(tmp_path / "sbrdf_plus"), "--out", str(tmp_path / "one.png"), "--size", "48"]
        result = CliRunner().invoke(app, [*arguments, *(["--shape", shape] if shape else [])])
        assert result.exit_code == 0, result.output
        with Image.open(tmp_path / "one.png") as image:
            pictures.append(np.asarray(image, np.float64))
    assert all(picture.std() > 10 for picture in pictures)  # something is there and it is not flat
    assert np.abs(pictures[0] - pictures[1]).mean() > 10


def test_levels_of_an_sbrdf_plus_are_no_products_of_their_own(tmp_path):
    folder = tmp_path / "products"
    weave = synthetic.weave((8, 8))
    replace(weave, coarser=(synthetic.weave((4, 4)),)).save(folder / "sbrdf_plus")
    assert _products(folder) == ["sbrdf_plus"]
