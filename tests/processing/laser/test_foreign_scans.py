"""Published laser recordings that nobody here made; skipped where they are absent."""

import shutil

import cv2
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.io import loadmat, savemat

from processing.errors import CalibrationError, ImageError
from processing.formats.sequence import read_animation
from processing.laser.depth_picture import depth_picture, write_point_cloud
from processing.laser.hand_sweep import laser_sweep, read_intrinsics
from processing.laser.laser_chessboard import laser_chessboard
from processing.laser.stripe import LaserColour
from tests.benchmarks.lasers import real
from tests.public_data import DATA

CHESSBOARD, SWEEP = DATA / "laser-chessboard", DATA / "laser-sweep"
with_chessboard = pytest.mark.skipif(not CHESSBOARD.is_dir(), reason="shared data laser-chessboard is absent")
with_sweep = pytest.mark.skipif(not SWEEP.is_dir(), reason="shared data laser-sweep is absent")


@pytest.fixture(scope="module")
def published():
    """The public photographs as they are measured."""
    return laser_chessboard(CHESSBOARD)


@with_chessboard
def test_chessboard_laser_is_the_published_plane(published):
    """Rows to Steger's 0.11 px; the points scatter less than the published ones (0.50 mm), the planes agree."""
    result = published
    assert len(result.stripes) == 14
    assert result.row_rms_px < 0.11
    assert result.plane.rms_m < 0.25e-3
    assert result.published_angle_rad < np.radians(0.5)
    assert abs(result.published_distance_m) < 1e-3
    assert result.angle_deviation_rad < np.radians(0.1)


@with_chessboard
def test_ours_leaves_less_over_than_others_on_the_same_stripes():
    """In pixels about the stripe and millimetres about the plane, which also predicts images that did not make it."""
    result = real.run(quick=True)
    assert result.figures["real_stripe_residual_px"] < 0.11
    assert result.figures["real_plane_residual_mm"] < 0.15
    ours, *peers = [row for row in result.rows if "method" in row and "missing" not in row]
    assert len(peers) == len(real.PEERS)
    for peer in peers:
        assert peer["error"] > 1.3 * ours["error"], peer["method"]
        assert peer["plane_rms_mm"] > ours["plane_rms_mm"], peer["method"]
    predicted = next(row for row in result.rows if str(row.get("check")).startswith("plane of the other"))
    assert predicted["value"] < 0.2


def test_absent_data_are_told_by_the_benchmark(monkeypatch, tmp_path):
    monkeypatch.setattr(real, "DATA", tmp_path)
    result = real.run(quick=True)
    assert not result.figures
    assert all("not here" in row["missing"] for row in result.rows)


@with_chessboard
@pytest.mark.parametrize("damage", ["truncated", "text", "small", "missing", "calibration"])
def test_damaged_folder_is_named(tmp_path, damage):
    shutil.copy(CHESSBOARD / "Calib_Results.mat", tmp_path)
    original, image = CHESSBOARD / "image001.png", tmp_path / "image001.png"
    if damage == "truncated":
        image.write_bytes(original.read_bytes()[:50000])
    elif damage == "text":
        image.write_text("not a picture")
    elif damage == "small":
        Image.new("RGB", (64, 48)).save(image)
    elif damage == "calibration":
        (tmp_path / "Calib_Results.mat").chmod(0o644)
        (tmp_path / "Calib_Results.mat").write_bytes(b"MATLAB 5.0 but not really" * 10)
    with pytest.raises(ImageError, match=r"image001\.png|Calib_Results\.mat"):
        laser_chessboard(tmp_path)


@with_chessboard
def test_a_camera_on_its_side_and_a_green_laser_see_the_same_plane(tmp_path, published):
    """The photographs turned by a quarter, red and green exchanged, and the calibration that goes with them."""
    found = published
    width = found.calibration.size_px[0]
    for path in CHESSBOARD.glob("image*.png"):
        with Image.open(path) as picture:
            rgb = np.asarray(picture.convert("RGB"))
        Image.fromarray(np.rot90(rgb)[..., [1, 0, 2]]).save(tmp_path / path.name, compress_level=1)
    old = loadmat(CHESSBOARD / "Calib_Results.mat")
    side = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # what was down is right
    (fx, _, cx), (_, fy, cy), _ = old["KK"]
    k1, k2, p1, p2, k3 = old["kc"].ravel()
    new = {"KK": np.array([[fy, 0, cy], [0, fx, width - 1 - cx], [0, 0, 1]]), "kc": np.array([k1, k2, -p2, p1, k3])}
    new |= {"nx": old["ny"], "ny": old["nx"], "active_images": old["active_images"]}
    for key, value in old.items():
        if key.startswith("omc_") and key[4:].isdecimal():
            turned, _ = cv2.Rodrigues(side @ cv2.Rodrigues(value)[0])
            new |= {key: turned, f"Tc_{key[4:]}": side @ old[f"Tc_{key[4:]}"], f"X_{key[4:]}": old[f"X_{key[4:]}"]}
    savemat(tmp_path / "Calib_Results.mat", new)
    turned = laser_chessboard(tmp_path, LaserColour.GREEN)
    assert turned.calibration.size_px == found.calibration.size_px[::-1]
    assert len(turned.points_m) == pytest.approx(len(found.points_m), rel=0.01)
    np.testing.assert_allclose(turned.plane.normal, side @ found.plane.normal, atol=1e-5)
    assert turned.plane.offset_m == pytest.approx(found.plane.offset_m, abs=1e-6)


@with_sweep
@pytest.mark.parametrize("intrinsics", [SWEEP / "intrinsics.xml", None], ids=["published", "of the rectangles"])
def test_hand_sweep_agrees_with_its_own_references(intrinsics):
    """Points timed on wall and table lie on the planes of the printed rectangles, within the camera's pixel (2 mm)."""
    result = laser_sweep(SWEEP / "input.gif", intrinsics)
    assert result.timed.sum() > 2000
    assert np.isfinite(result.depth_m).sum() > 1.3 * result.timed.sum()  # the sweep's two ends
    assert result.disagreement_m < 2e-3
    assert sum(plane is not None for plane in result.planes) >= 45
    assert result.wall_rms_m < 2e-3
    assert result.floor_rms_m < 2e-3
    mug = result.depth_m[120:160, 190:215]
    assert np.nanmedian(mug) < np.nanmedian(result.depth_m[80:105, 150:180])  # the mug stands before the wall


@with_sweep
def test_published_intrinsics_contradict_the_rectangles():
    """Wall and table, 82 deg apart by them, stand square by the rectangles' own camera, which nothing told to.

    That camera also halves what the stripe's points leave over on the table.
    """
    published = laser_sweep(SWEEP / "input.gif", SWEEP / "intrinsics.xml")
    own = laser_sweep(SWEEP / "input.gif", None)
    assert published.own is not None
    assert published.own.contradicts(published.fit)
    assert abs(published.fit.corner_rad - np.pi / 2) > 4 * published.fit.corner_deviation_rad
    assert abs(own.fit.corner_rad - np.pi / 2) < 3 * own.fit.corner_deviation_rad < np.radians(6)
    assert own.floor_rms_m < 0.5 * published.floor_rms_m
    assert own.wall_rms_m < published.wall_rms_m


@with_sweep
def test_truncated_animation_is_refused(tmp_path):
    broken = tmp_path / "broken.gif"
    broken.write_bytes((SWEEP / "input.gif").read_bytes()[:20000])
    with pytest.raises(ImageError, match="broken"):
        read_animation(broken)


def test_files_that_are_no_sweep_are_refused(tmp_path):
    text = tmp_path / "notes.gif"
    text.write_text("no picture")
    with pytest.raises(ImageError, match="notes"):
        read_animation(text)
    still = tmp_path / "still.gif"
    Image.new("RGB", (32, 24)).save(still)
    with pytest.raises(ImageError, match="ten or more"):
        laser_sweep(still, tmp_path / "intrinsics.xml")
    with pytest.raises(ImageError):
        read_animation(tmp_path / "absent.gif")


def test_scene_without_rectangles_is_refused(tmp_path):
    frames = [Image.fromarray(np.full((60, 80, 3), 90 + k, np.uint8)) for k in range(12)]
    frames[0].save(tmp_path / "grey.gif", save_all=True, append_images=frames[1:])
    (tmp_path / "k.xml").write_text(
        "<o><K><data>1000 0 640 0 1000 480 0 0 1</data></K><dist><data>0 0 0 0 0</data></dist></o>"
    )
    with pytest.raises(ImageError, match="rectangles"):
        laser_sweep(tmp_path / "grey.gif", tmp_path / "k.xml")


@pytest.mark.parametrize("content", ["", "<a/>", "<o><K><data>1 2</data></K></o>", "not xml"])
def test_intrinsics_that_are_none_are_refused(tmp_path, content):
    path = tmp_path / "k.xml"
    path.write_text(content)
    with pytest.raises(CalibrationError):
        read_intrinsics(path, 320)


@pytest.mark.parametrize(("stated", "scale"), [("", 0.25), ("<image_width>640</image_width>", 0.5)])
def test_intrinsics_are_reduced_to_the_width_of_the_pictures(tmp_path, stated, scale):
    """The centre of the whole picture stays there: pixel centres are at integers."""
    path, width = tmp_path / "k.xml", 320 / scale
    path.write_text(
        f"<o>{stated}<K><data>1000 0 {(width - 1) / 2} 0 1000 99.5 0 0 1</data></K>"
        "<dist><data>0 0 0 0 0</data></dist></o>"
    )
    matrix, _ = read_intrinsics(path, 320)
    assert matrix[0, 0] == pytest.approx(1000 * scale)
    assert matrix[0, 2] == pytest.approx(159.5)


def test_depth_picture_orders_depths():
    picture = depth_picture(np.array([[0.5, 0.7], [0.9, np.nan]]))
    assert picture.dtype == np.uint8
    assert tuple(picture[1, 1]) == (0, 0, 0)
    brightness = picture.astype(int).sum(axis=2)
    assert brightness[0, 0] > brightness[0, 1] > brightness[1, 0] > 0
    assert not depth_picture(np.full((3, 4), np.nan)).any()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-6, 6), st.floats(-5, 5))
def test_depth_picture_knows_no_unit_and_no_zero(seed, decades, start):
    rng = np.random.default_rng(seed)
    depth = np.where(rng.random((6, 7)) < 0.2, np.nan, rng.uniform(1, 2, (6, 7)))
    other = depth_picture((depth + start) * 10**decades).astype(int)
    assert np.abs(other - depth_picture(depth)).max() <= 8  # a step of the colour table
    assert not other[np.isnan(depth)].any()


def test_point_cloud_is_read_by_others(tmp_path):
    """trimesh reads back the finite points with their colours."""
    points = np.array([[[0.1, 0.2, 0.3], [np.nan] * 3], [[0.4, 0.5, 0.6], [0.7, 0.8, 0.9]]])
    colour = np.arange(12, dtype=np.uint8).reshape(2, 2, 3)
    assert write_point_cloud(tmp_path / "p.ply", points, colour) == 3
    cloud = trimesh.load(tmp_path / "p.ply")
    np.testing.assert_allclose(cloud.vertices, points.reshape(-1, 3)[[0, 2, 3]], atol=1e-6)
    np.testing.assert_array_equal(cloud.colors[:, :3], colour.reshape(-1, 3)[[0, 2, 3]])
    with pytest.raises(ImageError, match="no measured point"):
        write_point_cloud(tmp_path / "q.ply", np.full((2, 3), np.nan), colour)
