"""Fish-eye cameras from boards all around them: truth, noise, and OpenCV on the same corners."""

import cv2
import numpy as np
import pytest

from processing import geometry
from processing.cameras.board import Board, BoardView
from processing.cameras.calibration import CameraModel, calibrate_camera, read_cameras, write_cameras
from processing.cameras.lens import Fisheye
from processing.errors import CalibrationError

BOARD = Board(9, 7, 0.03, 0.022)
SIZE = (640, 660)


def lens_of(field_deg):
    """A lens whose image circle of this field fills the shorter side, off centre and bent like an equisolid one."""
    focal = min(SIZE) / np.radians(field_deg)
    matrix = np.array([[focal, 0, 335.0], [0, 1.0008 * focal, 316.0], [0, 0, 1]])
    return Fisheye(matrix, np.array([-0.035, 0.004, -0.001, 0.0001]))


def boards_around(lens, field_deg, rng, noise_px=0.0, count=24):
    """Boards at 0.4 m in directions all over the field, facing the camera up to a tilt of 35 deg."""
    views = []
    while len(views) < count:
        theta, around = np.radians(field_deg / 2) * np.sqrt(rng.uniform(0, 1)), rng.uniform(-np.pi, np.pi)
        toward = np.array([np.sin(theta) * np.cos(around), np.sin(theta) * np.sin(around), np.cos(theta)])
        tilt = geometry.rigid_from_vectors(np.radians(rng.uniform(-35, 35, 3)), np.zeros(3))
        # look_at's z points at the target; a board's z points at who reads it, its y up.
        facing = geometry.look_at(0.4 * toward, np.zeros(3), up=(0, -1, 0)) @ np.diag([-1.0, -1, 1, 1]) @ tilt
        uv_px = lens.project(geometry.transform_points(facing, BOARD.corners_m()))
        seen = (np.isfinite(uv_px) & (uv_px > 0) & (uv_px < np.array(SIZE[::-1]) - 1)).all(axis=1)
        if seen.sum() >= 20:
            found = uv_px[seen] + rng.normal(0, noise_px, (seen.sum(), 2))
            views.append(BoardView(BOARD.corners_m()[seen], found))
    return views


def angle_errors_deg(found, true, most_deg):
    theta, around = np.meshgrid(np.radians(np.linspace(0, most_deg, 20)), np.linspace(0, 2 * np.pi, 13))
    rays = np.stack([np.sin(theta) * np.cos(around), np.sin(theta) * np.sin(around), np.cos(theta)], axis=-1)
    met = found.rays(true.project(rays))
    return np.degrees(np.linalg.norm(np.cross(met, rays), axis=-1))


@pytest.mark.parametrize("field_deg", [30, 120, 185, 195, 220])
def test_exact_corners_give_the_lens(field_deg):
    """From a narrow field to one that sees well behind the image plane, with no guess."""
    true = lens_of(field_deg)
    found = calibrate_camera(boards_around(true, field_deg, np.random.default_rng(1)), SIZE, Fisheye)
    assert found.rms_px < 1e-3
    assert angle_errors_deg(found.lens, true, 0.48 * field_deg).max() < 1e-3 * field_deg / 180 + 1e-4


def test_noisy_corners_give_honest_deviations():
    """At 190 deg; errors of fx fy cx cy and k1 to k4 over what is claimed of them, over 6 sets."""
    true, errors = lens_of(190), []
    for seed in range(6):
        found = calibrate_camera(boards_around(true, 190, np.random.default_rng(seed), 0.1), SIZE, Fisheye)
        off = (found.lens.matrix - true.matrix)[[0, 1, 0, 1], [0, 1, 2, 2]]
        off = np.concatenate([off, found.lens.distortion - true.distortion])
        errors.append(off / found.deviation[:8])
        assert found.rms_px == pytest.approx(0.1 * np.sqrt(2), rel=0.1)
        assert angle_errors_deg(found.lens, true, 92).max() < 0.25  # three sigmas of the principal point
    # 48 errors, correlated within a set.
    assert 0.65 < np.sqrt(np.mean(np.square(errors))) < 1.35


def test_opencv_finds_the_same_lens_where_it_can():
    """OpenCV's fish-eye needs all corners before the camera; there both must agree within what noise allows."""
    true = lens_of(150)
    views = boards_around(true, 100, np.random.default_rng(3), 0.05)
    ours = calibrate_camera(views, SIZE, Fisheye)
    points = [view.points_m[None] for view in views]
    uv_px = [view.uv_px[None] for view in views]
    flags = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW | cv2.CALIB_USE_INTRINSIC_GUESS
    rms_px, matrix, distortion, *_ = cv2.fisheye.calibrate(
        points, uv_px, SIZE[::-1], true.matrix.copy(), np.zeros((4, 1)), flags=flags
    )
    theirs = Fisheye(matrix, distortion.ravel())
    assert ours.rms_px == pytest.approx(rms_px, rel=0.02)
    assert angle_errors_deg(ours.lens, theirs, 50).max() < 0.02


def test_wrong_corners_do_little_harm():
    rng = np.random.default_rng(5)
    true = lens_of(190)
    views = boards_around(true, 190, rng, 0.1)
    for view in views:
        wrong = rng.random(len(view.uv_px)) < 0.05
        view.uv_px[wrong] += rng.uniform(-40, 40, (wrong.sum(), 2))
    assert angle_errors_deg(calibrate_camera(views, SIZE, Fisheye).lens, true, 90).max() < 0.15


def test_a_camera_of_190_deg_behind_the_interface(tmp_path):
    true = lens_of(190)
    pose = geometry.look_at([0.1, 0.2, 0.3], [0, 0, 1.0])
    camera = CameraModel(true, pose, SIZE, 0.2, np.ones(14))
    rays = camera.pixel_rays()
    circle = np.isfinite(rays).all(axis=-1)
    rows, columns = np.nonzero(circle)
    np.testing.assert_allclose(
        camera.project(camera.centre_m + 3 * rays[circle]), np.stack([columns, rows], axis=1), atol=1e-6
    )
    write_cameras({"sky": camera}, tmp_path / "cameras.json")
    again = read_cameras(tmp_path / "cameras.json")["sky"]
    assert isinstance(again.lens, Fisheye)
    np.testing.assert_array_equal(again.pixel_rays(), rays)


def test_mirrored_boards_are_refused():
    views = boards_around(lens_of(150), 120, np.random.default_rng(6))
    mirrored = [BoardView(view.points_m * [-1, 1, 1], view.uv_px) for view in views]
    with pytest.raises(CalibrationError, match=r"behind|no fish-eye"):
        calibrate_camera(mirrored, SIZE, Fisheye)
