"""Scene files: what they may say, and the one error that each mistake gets."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from processing.formats.exr import ExrImage, write_exr
from processing.formats.radiance_hdr import write_hdr
from processing.progress import Silence
from render.shapes import box
from rig.errors import ConfigError
from service.cli import app
from service.relit_scene import Place, open_scene
from service.relit_studio import Studio, precomputed
from tests.benchmarks.yardsticks import furniture
from tests.service.relit_scenes import COARSE, write_scene

ROOM = Path(__file__).parents[2] / "docs" / "scenes" / "room.toml"

MISTAKES = {
    "a mesh that is not there": ('mesh = "box"', 'mesh = "bocks"', ["[[body]] 'box'", "'bocks'", "box, sphere"]),
    "a mesh that is none": ('mesh = "box"', 'mesh = "coarse.toml"', ["[[body]] 'box'", "coarse.toml"]),
    "a material without a table": ('"lacquer"', '"laquer"', ["'brick'", "'laquer'", "[materials.laquer]"]),
    "a material of no kind": ('kind = "lambert"', 'kind = "matt"', ["materials.red", "lambert, blinn_phong"]),
    "a share over 1": ("[0.7, 0.1, 0.05]", "[7, 0.1, 0.05]", ["materials.red.lambert.albedo", "equal to 1"]),
    "two of one name": ('name = "brick"', 'name = "box"', ["two [[body]]", "'box'"]),
    "an environment that is not there": ('"day.hdr"', '"dy.hdr"', ["environment 'dy.hdr'", "rig environment"]),
    "an environment that is none": ('"day.hdr"', '"coarse.toml"', ["environment 'coarse.toml'"]),
    "environments of one name": ('["night.hdr"]', '["./day.hdr"]', ["'day'", "rename"]),
    "directions in between": ("directions = 1024", "directions = 3000", ["directions", "power of two"]),
    "a scale of nothing": ("scale = 0.1", "scale = 0", ["body.2.scale", "over 0"]),
    "edges of nothing": ("edge_mm = 50", "edge_mm = 0.001", ["'brick'", "vertices"]),
    "a field that is not known": ("turn_deg = 20", "turn = 20", ["body.1.turn"]),
    "no number": ("elevation_deg = 30", "elevation_deg = nan", ["camera.elevation_deg", "number"]),
    "no TOML": ("[camera]", "[camera", ["not TOML"]),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_told_with_its_file_and_table(tmp_path, mistake):
    before, after, named = MISTAKES[mistake]
    assert before in COARSE
    path = write_scene(tmp_path, COARSE.replace(before, after, 1))
    with pytest.raises(ConfigError) as told:
        open_scene(path)
    assert str(path) in str(told.value)
    for name in named:
        assert name in str(told.value)


def test_an_environment_of_no_numbers_or_of_a_product_folder_without_one(tmp_path):
    write_exr(tmp_path / "dark.exr", ExrImage(np.full((8, 16, 3), np.nan, np.float32)))
    with pytest.raises(ConfigError, match=r"environment 'dark\.exr'"):
        open_scene(write_scene(tmp_path, COARSE.replace("day.hdr", "dark.exr")))
    (tmp_path / "day").mkdir()
    with pytest.raises(ConfigError, match="environment 'day'"):
        open_scene(write_scene(tmp_path, COARSE.replace("day.hdr", "day")))


def test_one_number_serves_for_three_and_millimetres_become_metres(tmp_path):
    scene = open_scene(write_scene(tmp_path))
    floor, tall, brick = scene.bodies
    assert np.ptp(floor.mesh.positions, axis=0) == pytest.approx([1.0, 1.0, 0.0])
    assert np.ptp(tall.mesh.positions, axis=0) == pytest.approx([0.2, 0.15, 0.3])
    assert brick.place.place_m == pytest.approx((-0.2, -0.15, 0.051))
    assert not scene.doubts
    turn = tall.place.pose[:3, :3]
    assert turn @ [1, 0, 0] == pytest.approx([np.cos(np.deg2rad(20)), np.sin(np.deg2rad(20)), 0])
    corners = np.linalg.norm(
        np.roll(brick.mesh.positions[brick.mesh.triangles], 1, axis=1) - brick.mesh.positions[brick.mesh.triangles],
        axis=2,
    )
    assert corners.max() <= 0.05


def test_turns_are_about_x_then_y_then_z_of_the_room():
    pose = Place.of((10, 20, 30), (90, 0, 90)).pose
    assert pose @ [0, 1, 0, 1] == pytest.approx([0.01, 0.02, 1.03, 1])  # y upward, as of glTF: upright
    assert pose @ [0, 0, 1, 1] == pytest.approx([1.01, 0.02, 0.03, 1])


def test_bodies_are_seen_whole_without_a_word_about_the_camera(tmp_path):
    text = COARSE.replace("azimuth_deg = -50\nelevation_deg = 30\n", "")
    scene = open_scene(write_scene(tmp_path, text))
    camera = scene.orbit.camera((300, 200))
    points = np.concatenate([b.mesh.positions @ b.place.pose[:3, :3].T + b.place.pose[:3, 3] for b in scene.bodies[1:]])
    image = camera.projected(points)
    column, row = image[:, 0] / image[:, 2], image[:, 1] / image[:, 2]
    assert 0 < column.min() < column.max() < 299
    assert 0 < row.min() < row.max() < 199
    assert max(np.ptp(column) / 300, np.ptp(row) / 200) > 0.4


def test_the_furniture_of_the_example_is_that_of_the_benchmark():
    scene = open_scene(ROOM)
    assert not scene.doubts
    for name, made in (("chair", furniture._chair(9.0)), ("table", furniture._table(9.0))):
        body = next(body for body in scene.bodies if body.name == name)
        assert len(body.mesh.positions) > len(made[0])  # made finer
        assert np.ptp(body.mesh.positions, axis=0) == pytest.approx(np.ptp(made[0], axis=0), abs=1e-6)


def test_an_open_mesh_is_used_and_told(tmp_path):
    mesh = box()
    lines = [
        *(f"v {x} {y} {z}" for x, y, z in mesh.positions),
        *(f"f {a} {b} {c}" for a, b, c in mesh.triangles[2:] + 1),
    ]
    (tmp_path / "open.obj").write_text("\n".join(lines))
    scene = open_scene(write_scene(tmp_path, COARSE.replace('mesh = "box"', 'mesh = "open.obj"', 1)))
    assert "box: the mesh is open" in scene.doubts[0]


def test_the_picture_has_the_brightness_that_the_light_tells(tmp_path):
    """A white floor under an even sky: 0.65 of the display's range, whatever the sky's radiance; half with a stop."""
    sky = 'environment = "sky.hdr"\n[precomputation]\ndirections = 1024\nresolution = 4\n'
    floor = '[[body]]\nname = "floor"\nmesh = "plane"\n'
    for radiance, stops, shown in ((0.01, 0.0, 0.65), (100.0, 0.0, 0.65), (1.0, -1.0, 0.325)):
        path = write_scene(tmp_path, f"{sky}[camera]\nelevation_deg = 80\nstops = {stops}\n{floor}")
        picture = np.zeros((8, 16, 3), np.float32)
        picture[:4] = radiance
        write_hdr(tmp_path / "sky.hdr", picture)
        scene = open_scene(path)
        with Studio(scene, precomputed(scene, tmp_path / "kept", Silence()), (32, 32)) as studio:
            code = studio.draw().codes[16, 16].mean() / 255
        assert ((code + 0.055) / 1.055) ** 2.4 == pytest.approx(shown, rel=0.02)


def test_the_environment_stands_behind_the_bodies_and_turns_with_the_light(tmp_path):
    """Light from +X is seen from -X, and from +X once it is turned by half a turn; without being asked for, never."""
    shine = np.full((8, 16, 3), 0.01, np.float32)
    shine[:, 4:12] = 1.0
    codes = {}
    for shown in ("true", "false"):
        text = COARSE.replace("azimuth_deg = -50\nelevation_deg = 30", f"azimuth_deg = 180\nbackground = {shown}")
        path = write_scene(tmp_path, text)
        write_hdr(tmp_path / "day.hdr", shine)
        scene = open_scene(path)
        with Studio(scene, precomputed(scene, tmp_path / "kept", Silence()), (48, 32)) as studio:
            codes[shown] = [studio.draw().codes[0, 24].mean()]
            studio.turn_light(np.pi)
            codes[shown].append(studio.draw().codes[0, 24].mean())
    assert codes["true"][0] > 150 > 60 > codes["true"][1]
    assert codes["false"][0] == codes["false"][1]


def relight(*arguments):
    return CliRunner().invoke(app, ["relight", *map(str, arguments)])


def test_the_command_draws_what_moves_and_keeps_what_it_computed(tmp_path):
    path, kept = write_scene(tmp_path), tmp_path / "kept"
    common = ("--precomputed", kept, "--size", "48,32")
    told = relight(path, "-o", tmp_path / "moved.webp", *common, "--frames", 3, "--move", "brick,100,-200")
    assert told.exit_code == 0, told.output
    assert "3 bodies" in told.output
    assert "lit anew" in told.output
    written = {file.name: file.stat().st_mtime_ns for file in kept.iterdir()}
    assert len(written) == 5  # what three see, what two hide
    assert relight(path, "-o", tmp_path / "still.png", *common, "--light-azimuth-deg", 90).exit_code == 0
    assert {file.name: file.stat().st_mtime_ns for file in kept.iterdir()} == written


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("-o", "x.exr"), ".png or .jpg"),
        (("-o", "x.png", "--size", "0,5"), "WIDTH,HEIGHT"),
        (("-o", "x.png", "--move", "sofa,0,0"), "floor, box, brick"),
        (("-o", "x.png", "--move", "brick,0"), "BODY,X,Y"),
    ],
)
def test_an_option_that_makes_no_sense_is_told(tmp_path, monkeypatch, arguments, named):
    path = write_scene(tmp_path)
    monkeypatch.chdir(tmp_path)
    told = relight(path, *arguments)
    assert told.exit_code == 2
    assert named in told.output
    assert not list(tmp_path.glob("x.*"))
