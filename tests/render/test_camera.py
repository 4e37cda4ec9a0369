"""Cameras are OpenCV's; OpenGL's window is reached in one place."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from render.camera import Camera, clip_from_world, depth_range, look_at, rows_from_gl
from render.errors import SceneError

SIZES = st.tuples(st.integers(1, 2000), st.integers(1, 2000))


def image_px(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Image points (n, 2) by OpenCV's pinhole."""
    homogeneous = camera.in_camera(points) @ camera.matrix.T
    return homogeneous[:, :2] / homogeneous[:, 2:]


@settings(max_examples=50, deadline=None)
@given(size=SIZES, seed=st.integers(0, 1000), skew=st.floats(-20, 20))
def test_opengl_window_is_half_a_pixel_and_a_flip_from_the_image(size, seed, skew):
    """x_window = u + 1/2, y_window = height - (v + 1/2), for any intrinsic matrix."""
    rng = np.random.default_rng(seed)
    camera = look_at(rng.normal(size=3) * 5, rng.normal(size=3) * 0.1, size, field_of_view_rad=0.6)
    matrix = camera.matrix + np.array([[3.0, skew, 5.0], [0.0, -2.0, -7.0], [0.0, 0.0, 0.0]])
    camera = Camera(matrix, camera.camera_from_world, size)
    points = rng.normal(size=(8, 3)) * 0.3
    clip = np.column_stack([points, np.ones(8)]) @ clip_from_world(camera, 0.5, 50.0).T
    window = (clip[:, :2] / clip[:, 3:] + 1) / 2 * size
    expected = np.column_stack([image_px(camera, points)[:, 0] + 0.5, size[1] - image_px(camera, points)[:, 1] - 0.5])
    # A pixel is a 1e-3 rd of the window: rounding of float64 over some 1000 px.
    np.testing.assert_allclose(window, expected, atol=1e-8)


def test_near_plane_is_minus_one_and_far_plane_plus_one():
    camera = look_at((0.0, -4.0, 1.0), (0.0, 0.0, 0.0), (64, 48), field_of_view_rad=0.7)
    world_from_camera = np.linalg.inv(camera.camera_from_world)
    for depth, ndc in ((2.0, -1.0), (9.0, 1.0)):
        point = world_from_camera @ [0.3, 0.2, depth, 1.0]
        clip = clip_from_world(camera, 2.0, 9.0) @ point
        assert clip[2] / clip[3] == pytest.approx(ndc, abs=1e-12)
        assert clip[3] == pytest.approx(depth)


def test_look_at_puts_the_target_in_the_middle_and_up_upward():
    camera = look_at((3.0, -2.0, 1.0), (0.2, 0.1, 0.4), (101, 51), field_of_view_rad=0.5)
    target, above = image_px(camera, np.array([[0.2, 0.1, 0.4], [0.2, 0.1, 0.5]]))
    np.testing.assert_allclose(target, [50.0, 25.0], atol=1e-9)
    assert above[1] < target[1]
    np.testing.assert_allclose(above[0], target[0], atol=1e-9)
    np.testing.assert_allclose(camera.eye, [3.0, -2.0, 1.0], atol=1e-12)


def test_field_of_view_spans_the_shorter_side():
    camera = look_at((0.0, -2.0, 0.0), (0.0, 0.0, 0.0), (300, 200), field_of_view_rad=1.0)
    top = image_px(camera, np.array([[0.0, 0.0, 2.0 * np.tan(0.5)]]))[0]
    # The upper edge of row 0 lies half a pixel above its centre.
    np.testing.assert_allclose(top[1], -0.5, atol=1e-9)


@given(factor=st.integers(1, 5), width=st.integers(1, 40), height=st.integers(1, 40))
@settings(max_examples=30, deadline=None)
def test_scaled_camera_has_its_pixels_inside_the_old_ones(factor, width, height):
    """The mean of a pixel's subpixel centres is the pixel's centre."""
    camera = look_at((1.0, -3.0, 1.0), (0.0, 0.0, 0.0), (width, height), field_of_view_rad=0.6)
    points = np.random.default_rng(0).normal(size=(5, 3)) * 0.2
    fine = image_px(camera.scaled(factor), points)
    np.testing.assert_allclose((fine + 0.5) / factor - 0.5, image_px(camera, points), atol=1e-9)


def test_resized_camera_keeps_the_field_of_view_of_the_shorter_side():
    camera = look_at((1.0, -3.0, 1.0), (0.0, 0.0, 0.0), (200, 100), field_of_view_rad=0.6)
    same = look_at((1.0, -3.0, 1.0), (0.0, 0.0, 0.0), (50, 70), field_of_view_rad=0.6)
    np.testing.assert_allclose(camera.resized((50, 70)).matrix, same.matrix, atol=1e-9)
    assert camera.resized((50, 70)).size == (50, 70)


def test_camera_without_a_direction_is_refused():
    with pytest.raises(SceneError, match="no direction is right"):
        look_at((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), (10, 10), field_of_view_rad=0.5)
    with pytest.raises(SceneError, match="no direction is right"):
        look_at((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), (10, 10), field_of_view_rad=0.5)


def test_mesh_behind_the_camera_is_refused():
    camera = look_at((0.0, -4.0, 0.0), (0.0, -8.0, 0.0), (64, 48), field_of_view_rad=0.7)
    with pytest.raises(SceneError, match="behind the eye"):
        depth_range(camera, np.zeros((1, 3)))


def test_rows_from_gl_puts_the_last_row_on_top():
    np.testing.assert_array_equal(rows_from_gl(np.arange(6).reshape(3, 2))[0], [4, 5])
