"""Transforms, projection, rays, texels."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from processing import geometry

quick = settings(max_examples=40, deadline=None)
vectors = hnp.arrays(np.float64, 3, elements=st.floats(-3, 3))
transforms = st.builds(geometry.rigid_from_vectors, hnp.arrays(np.float64, 3, elements=st.floats(-1.7, 1.7)), vectors)
points = hnp.arrays(np.float64, (5, 3), elements=st.floats(-2, 2))
MATRIX = np.array([[900.0, 0, 320], [0, 905, 240], [0, 0, 1]])
DISTORTION = np.array([-0.12, 0.05, 0.001, -0.0007, 0.01])


@quick
@given(transforms, points)
def test_a_transform_and_its_inverse_cancel(transform, p):
    back = geometry.transform_points(geometry.invert(transform), geometry.transform_points(transform, p))
    np.testing.assert_allclose(back, p, atol=1e-12)
    np.testing.assert_allclose(geometry.invert(transform) @ transform, np.eye(4), atol=1e-12)


@quick
@given(transforms, transforms, points)
def test_neighbours_cancel(a_from_b, b_from_c, p):
    at_once = geometry.transform_points(a_from_b @ b_from_c, p)
    one_by_one = geometry.transform_points(a_from_b, geometry.transform_points(b_from_c, p))
    np.testing.assert_allclose(at_once, one_by_one, atol=1e-12)


@quick
@given(vectors, vectors)
def test_a_rotation_vector_turns_as_scipy_says(turn, shift):
    transform = geometry.rigid_from_vectors(turn, shift)
    np.testing.assert_allclose(transform[:3, :3], Rotation.from_rotvec(turn).as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(transform[:, 3], [*shift, 1])


@quick
@given(st.floats(-7, 7), st.floats(-7, 7))
def test_turntable_angles_add(one, other):
    both = geometry.rotation_z(one) @ geometry.rotation_z(other)
    np.testing.assert_allclose(both, geometry.rotation_z(one + other), atol=1e-12)


def test_a_quarter_turn_takes_x_to_y():
    np.testing.assert_allclose(
        geometry.rotate(geometry.rotation_z(np.pi / 2), np.array([1.0, 0, 0])), [0, 1, 0], atol=1e-15
    )


def camera_at(elevation_rad, distance_m=1.0):
    position = distance_m * np.array([np.cos(elevation_rad), 0, np.sin(elevation_rad)])
    return geometry.look_at(position, np.zeros(3))


@quick
@given(st.floats(0, np.pi / 2), st.floats(0.2, 5))
def test_a_camera_sees_its_target_in_the_middle_and_up_is_up(elevation_rad, distance_m):
    pose = camera_at(elevation_rad, distance_m)
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.det(pose[:3, :3]) > 0.99
    uv = geometry.project(np.array([[0.0, 0, 0], [0, 0.1, 0], [-0.05, 0, 0.05]]), MATRIX, np.zeros(5), pose)
    np.testing.assert_allclose(uv[0], MATRIX[:2, 2], atol=1e-6)
    assert uv[1, 0] > uv[0, 0]  # +Y is to the right of a camera at azimuth 0
    assert uv[2, 1] < uv[0, 1]  # what lies higher or farther back is higher in the image


@pytest.mark.parametrize("depth_m", [1e-183, 5e-324, 1e-60])
def test_a_point_all_but_in_the_camera_s_plane_has_no_image(depth_m):
    assert np.isnan(geometry.project(np.array([[1.0, 1.0, depth_m]]), MATRIX, DISTORTION, np.eye(4))).all()


@quick
@given(transforms, points)
def test_projection_is_opencv_s(rig_from_camera, p):
    camera_from_rig = geometry.invert(rig_from_camera)
    local = geometry.transform_points(camera_from_rig, p)
    uv = geometry.project(p, MATRIX, DISTORTION, rig_from_camera)
    front = local[:, 2] > 0
    assert np.isnan(uv[~front]).all()
    if (local[front, 2] > 0.2).any():
        turn, shift = Rotation.from_matrix(camera_from_rig[:3, :3]).as_rotvec(), camera_from_rig[:3, 3]
        wanted = cv2.projectPoints(p, turn, shift, MATRIX, DISTORTION)[0][:, 0]
        near = local[:, 2] > 0.2
        np.testing.assert_allclose(uv[near], wanted[near], rtol=1e-6, atol=1e-6)


@quick
@given(st.floats(0.05, 1.5), hnp.arrays(np.float64, (4, 2), elements=st.floats(0, 480)))
def test_a_ray_comes_back_to_its_pixel(elevation_rad, uv):
    pose = camera_at(elevation_rad)
    rays = geometry.pixel_rays(uv, MATRIX, DISTORTION, pose)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1)
    np.testing.assert_allclose(geometry.project(pose[:3, 3] + 0.7 * rays, MATRIX, DISTORTION, pose), uv, atol=1e-6)


@quick
@given(vectors, transforms)
def test_intersections_lie_on_the_plane_and_on_the_ray(origin, turn):
    directions = np.concatenate([turn[:3, :3], -turn[:3, :3]])
    normal, offset = np.array([0.6, 0, 0.8]), 0.3
    met = geometry.intersect_plane(origin, directions, normal, offset)
    known = np.isfinite(met).all(-1)
    reach = 1 + np.abs(met[known]).max(initial=0)
    np.testing.assert_allclose(met[known] @ normal, offset, atol=1e-12 * reach)
    ahead = np.einsum("ij,ij->i", met[known] - origin, directions[known])
    assert (ahead >= 0).all()
    np.testing.assert_allclose(origin + ahead[:, None] * directions[known], met[known], atol=1e-9 * reach)


def test_a_ray_along_the_plane_meets_nothing():
    met = geometry.intersect_plane([0, 0, 1], np.array([[1.0, 0, 0], [0, 0, 1], [0, 0, -1]]), [0, 0, 1], 0)
    np.testing.assert_array_equal(np.isnan(met).all(-1), [True, True, False])


@quick
@given(st.integers(1, 70), st.floats(1e-3, 1))
def test_texels_fill_the_square_image_like(n, side_m):
    grid, corners = geometry.texel_grid(n, side_m), geometry.texel_corners(n, side_m)
    np.testing.assert_allclose(grid, (corners[:-1, :-1] + corners[1:, 1:]) / 2, atol=1e-15)
    np.testing.assert_allclose(corners[0, 0], [-side_m / 2, side_m / 2, 0])
    np.testing.assert_allclose(corners[-1, -1], [side_m / 2, -side_m / 2, 0])
    assert grid.shape == (n, n, 3)
    assert grid[0, -1, 0] >= 0
    assert grid[0, -1, 1] >= 0
