"""Each material on two shapes, lit from all sides, as files."""

import numpy as np
import pytest
from PIL import Image

from render.errors import MaterialError
from render.picture import exposure_for
from render.preview import Preview
from render.showcase import scenes, write_showcase
from tests.render import synthetic
from tests.render.reliefs import level


@pytest.fixture
def materials(srf, btf, sbrdf):
    relief = level(0.05)
    captured = synthetic.stone(32, 32, wrap=False)
    return {"repeating": srf, "captured": captured, "btf": btf, "sbrdf": sbrdf, "relief": relief}


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("repeating", {"srf_sphere", "srf_vase"}),
        ("captured", {"srf_sphere", "srf_vase"}),
        ("btf", {"btf_plane", "btf_torus"}),
        ("sbrdf", {"sbrdf_plane", "sbrdf_torus"}),
        ("relief", {"relief_torus", "relief_knot"}),
    ],
)
def test_every_scene_is_written_as_still_sheet_and_animation(gl, tmp_path, materials, name, expected):
    galleries = write_showcase(materials[name], tmp_path / "pictures", size=(48, 40), frames=6)
    assert {gallery.name for gallery in galleries} == expected
    for gallery in galleries:
        assert gallery.renderer == gl.name
        with Image.open(gallery.still) as still:
            assert still.size == (48, 40)
        with Image.open(gallery.animation) as animation:
            assert animation.n_frames == 6
        with Image.open(gallery.sheet) as sheet:
            assert sheet.size[0] >= 48 * 4
        assert gallery.animation.read_bytes()[8:12] == b"WEBP"


@pytest.mark.parametrize("name", ["repeating", "captured", "btf", "sbrdf"])
def test_scenes_are_well_lit_and_framed(gl, materials, name):
    """The object fills a good part of the window, most of it is lit, and little of it burns out."""
    preview = Preview((64, 64), renderer=gl)
    for show in scenes(materials[name], (64, 64)).values():
        pictures = preview.draw_all(show.frames(4))
        exposure = exposure_for(pictures)
        for picture in pictures:
            assert 0.15 < picture.coverage.mean() < 0.8
            display = picture.radiance[picture.coverage > 0.99].mean(axis=1) * exposure
            assert np.mean(display > 0.02) > 0.35
            assert np.mean(display > 1.0) < 0.1


def test_light_moves_between_the_frames(gl, materials):
    for name in ("captured", "btf"):
        for show in scenes(materials[name], (48, 48)).values():
            first, second = (gl.draw(scene).radiance for scene in show.frames(8)[:2])
            assert np.abs(first - second).max() > 0.01 * first.max()
            chosen = show.sheet_frames(8)
            assert chosen == sorted(set(chosen))
            assert len(chosen) >= 5


def test_other_materials_have_no_showcase(flat):
    with pytest.raises(MaterialError, match="FlatTexture"):
        scenes(flat, (10, 10))
