"""`rig displacement` on a described scan: what it writes, what it tells, what it refuses."""

import re
from contextlib import suppress

import numpy as np
import pytest
import trimesh
from PIL import Image

from processing.errors import ImageError
from rig.errors import ConfigError
from service.ranging import measure_displacement
from service.scan_file import open_scan
from tests.reference.board_photographs import COLUMNS, ROWS, SQUARE_M, write_photographs
from tests.reference.profile_rig import MATRIX, TURN, Ball, laser_plane, setup, take_all

TABLES = f"""
[camera]
matrix = {MATRIX.tolist()}
distortion = [-0.1, 0.03, 0, 0, 0]
[laser_plane]
normal = {(laser_plane().normal * 2).tolist()}
offset_mm = {laser_plane().offset_m * 2e3}
"""
TURNTABLE = """
[turntable]
axis_point_mm = [0, 0, 400]
axis_direction = [0, -3, 0]
step_deg = 6
"""
HEAD = 'images = "frames"\n'


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    """A described scan of a ball, twelve pictures."""
    folder = tmp_path_factory.mktemp("ball")
    (folder / "frames").mkdir()
    for number, frame in enumerate(take_all(setup(), Ball(), 12)):
        Image.fromarray(frame).save(folder / "frames" / f"{number}.png")
    (folder / "scan.toml").write_text(HEAD + TABLES + TURNTABLE)
    return folder


def test_file_is_the_setup(ball):
    """Millimetres, degrees and vectors of any length become metres, radians and unit vectors."""
    made, meant = open_scan(ball / "scan.toml").setup, setup()
    np.testing.assert_allclose(made.matrix, meant.matrix)
    np.testing.assert_allclose(made.plane.normal, meant.plane.normal)
    assert made.plane.offset_m == pytest.approx(meant.plane.offset_m)
    assert made.motion.step_rad == pytest.approx(TURN.step_rad)
    for frame in (0, 3.5):
        np.testing.assert_allclose(
            made.motion.camera_from_object(frame), meant.motion.camera_from_object(frame), atol=1e-12
        )


@pytest.mark.parametrize(("out", "cloud"), [("ball.ply", ".ply"), ("ball.glb", ".glb"), ("ball.png", ".ply")])
def test_clouds_are_read_by_others(ball, tmp_path, out, cloud):
    """trimesh opens the cloud again: the ball's points with its grey colours; a picture lies beside."""
    numbers = []
    lines = list(measure_displacement(ball / "scan.toml", tmp_path / out, lambda items: numbers.append(items) or items))
    assert numbers == [range(12)]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted({"ball.png", f"ball{cloud}"})
    loaded = trimesh.load(tmp_path / f"ball{cloud}")
    points = loaded.geometry[next(iter(loaded.geometry))] if isinstance(loaded, trimesh.Scene) else loaded
    assert np.median(np.abs(Ball().distance(np.asarray(points.vertices)))) < 0.12e-3
    assert np.median(np.ptp(np.asarray(points.colors)[:, :3].astype(int), axis=1)) <= 4
    with Image.open(tmp_path / "ball.png") as picture:
        assert picture.size == (12, 176)
    told = "\n".join(lines)
    assert f"point cloud of {len(points.vertices)} points" in told
    assert re.search(r"12 frames, \d+ points, .* 0 frames measure nothing", told)
    assert "moves as stated" in told


def test_a_wrong_sign_is_told(ball, tmp_path):
    text = (ball / "scan.toml").read_text().replace("step_deg = 6", "step_deg = -6")
    (ball / "wrong.toml").write_text(text)
    lines = list(measure_displacement(ball / "wrong.toml", tmp_path / "ball.ply"))
    assert any(line.startswith("WARNING") and "sign" in line for line in lines)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", r"\[images\] Field required"),
        ("images = ", "not TOML"),
        (HEAD + TABLES, "turntable"),
        (HEAD + TABLES + TURNTABLE + "[stage]\ndirection = [1, 0, 0]\nstep_mm = 1", "one only"),
        (HEAD + TURNTABLE, "camera"),
        (HEAD + 'stripes = "boards"' + TABLES + TURNTABLE, "stripes"),
        (HEAD + TABLES + TURNTABLE.replace("6", "0"), r"step_deg\] .*must not be 0"),
        (HEAD + TABLES + TURNTABLE.replace("-3", "0"), r"axis_direction\] .*a direction has a length"),
        (HEAD + TABLES + TURNTABLE.replace("0, -3, 0", "0, 0, 1"), "goes through the camera"),
        (HEAD + TABLES.replace("800.0, 0.0", "800.0, 0.5") + TURNTABLE, r"camera\] .*a camera matrix is"),
        (HEAD + TABLES.replace("-0.1, 0.03", "nan, 0.03") + TURNTABLE, r"distortion.0\] .*finite"),
        (HEAD + 'laser = "ultraviolet"' + TABLES + TURNTABLE, r"laser\] .*'red', 'green', 'blue' or 'grey'"),
        (HEAD + 'laser = "grey"\nstripes = "boards"' + TURNTABLE, "a laser of a colour"),
        (HEAD + "depth_mm = [500, 300]" + TABLES + TURNTABLE, "from near to far"),
        (HEAD + "colour = 3" + TABLES + TURNTABLE, r"colour\] Extra inputs"),
    ],
)
def test_wrong_descriptions_name_the_field(ball, tmp_path, text, said):
    (ball / "bad.toml").write_text(text)
    with pytest.raises(ConfigError, match=f"bad.toml: .*{said}"):
        list(measure_displacement(ball / "bad.toml", tmp_path / "out.ply"))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (('"frames"', '"nowhere"'), "nowhere: neither a folder"),
        (('"frames"', '"frames"\nbackground = "empty.png"'), "empty.png"),
        (('"frames"', '"frames"\nlaser = "blue"'), "no stripe"),
        (("107.5", "215.5"), "calibrated at another size"),
        (("87.5", "43.5"), "calibrated at another size"),
        (("[camera]", "[camera]\nsize_px = [432, 352]"), "calibrated at 432 x 352"),
        (('"frames"', '"frames"\ndepth_mm = [1, 2]'), "no measured point"),
    ],
)
def test_pictures_that_do_not_fit_are_refused(ball, tmp_path, changes, said):
    (ball / "bad.toml").write_text((ball / "scan.toml").read_text().replace(*changes))
    with pytest.raises(ImageError, match=said):
        list(measure_displacement(ball / "bad.toml", tmp_path / "out.glb"))
    assert not list(tmp_path.iterdir())


def test_photographs_of_a_board_stand_for_camera_and_plane(ball, tmp_path):
    """The printed lines say both; a scan may name the folder instead, and refuses pictures of another size."""
    boards = tmp_path / "boards"
    boards.mkdir()
    write_photographs(boards)
    (boards / "board.toml").write_text(f"columns = {COLUMNS}\nrows = {ROWS}\nsquare_mm = {SQUARE_M * 1e3}\n")
    with pytest.raises(ImageError, match="among the source's pictures"):
        list(measure_displacement(boards, boards / "depth.png"))
    lines = list(measure_displacement(boards, tmp_path / "line.ply"))
    assert "size_px = [400, 300]" in lines[0]
    assert lines[1].startswith("6 stripes on 6 boards")
    assert lines[2].startswith("laser plane: normal")
    assert {path.name for path in tmp_path.iterdir()} == {"boards", "line.ply", "line.png"}
    (ball / "boards.toml").write_text(f'{HEAD}stripes = "{boards}"{TURNTABLE}')
    with pytest.raises(ImageError, match="216 x 176 pixels, but the camera was calibrated at 400 x 300"):
        list(measure_displacement(ball / "boards.toml", tmp_path / "out.ply"))
    (boards / "board.toml").write_text('columns = 8\nrows = 5\nsquare_mm = 20\nlaser = "grey"')
    with pytest.raises(ConfigError, match=r"\[laser\].*'red', 'green' or 'blue'"):
        list(measure_displacement(boards, tmp_path / "line.ply"))


def test_a_stated_size_allows_any_centre(ball):
    """Pictures may be a part of the sensor, as long as somebody says so."""
    text = (ball / "scan.toml").read_text().replace("107.5", "20.5")
    (ball / "part.toml").write_text(text.replace("[camera]", "[camera]\nsize_px = [216, 176]"))
    assert open_scan(ball / "part.toml").setup.matrix[0, 2] == 20.5


def test_results_are_not_laid_among_the_pictures(ball):
    before = sorted((ball / "frames").iterdir())
    with pytest.raises(ImageError, match="among the source's pictures"):
        list(measure_displacement(ball, ball / "frames" / "depth.png"))
    assert sorted((ball / "frames").iterdir()) == before


def test_a_missing_folder_is_told_before_anything_is_measured(ball, tmp_path):
    lines = measure_displacement(ball, tmp_path / "absent" / "ball.ply")
    with pytest.raises(FileNotFoundError, match="its folder does not exist"):
        next(lines)


def test_a_wrong_colour_is_told(ball, tmp_path):
    """In the difference of two colours without laser the noise is what makes stripes, several on a line."""
    (tmp_path / "frames").mkdir()
    for number in range(5):
        with Image.open(ball / "frames" / f"{number}.png") as picture:
            seen = np.asarray(picture).astype(np.float64)
        seen[..., 1] += 40 * np.exp(-0.5 * ((np.arange(seen.shape[1]) % 54 - 27) / 2.0) ** 2)
        Image.fromarray(np.clip(seen, 0, 255).astype(np.uint8)).save(tmp_path / "frames" / f"{number}.png")
    (tmp_path / "scan.toml").write_text((ball / "scan.toml").read_text().replace(HEAD, HEAD + 'laser = "green"\n'))
    lines = []
    with suppress(ImageError):  # it may be that not one line is left
        lines += measure_displacement(tmp_path, tmp_path / "ball.ply")
    assert lines[1].startswith("WARNING: more scan lines show two stripes than one")


def test_a_folder_is_what_lies_in_it(ball, tmp_path):
    lines = list(measure_displacement(ball, tmp_path / "ball.png"))
    assert lines[0].startswith("12 frames")
    with pytest.raises(ImageError, match=r"neither board\.toml or Calib_Results\.mat, .* nor scan\.toml"):
        list(measure_displacement(tmp_path, tmp_path / "a.png"))


def test_absent_and_unknown_files_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        list(measure_displacement(tmp_path / "absent.toml", tmp_path / "a.png"))
    with pytest.raises(ImageError, match=r"the \.toml of a scan"):
        list(measure_displacement(tmp_path / "absent.mp4", tmp_path / "a.png"))
    with pytest.raises(ImageError, match=r"a point cloud one of \.ply, \.glb"):
        list(measure_displacement(tmp_path / "absent.toml", tmp_path / "a.stl"))
