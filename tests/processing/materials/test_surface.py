"""Surfaces from normals: exact where nothing contradicts, whole meshes, edges that stay edges."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.materials import grid_springs
from processing.materials.surface import integrate, triangulate
from processing.products import NormalMap, NormalStatus, plane_points
from tests.reference import shapes

PIXEL_M = 0.001


def map_of(normal, sigma=0.0, seed=0) -> NormalMap:
    noisy = normal + sigma * np.random.default_rng(seed).standard_normal(normal.shape) / np.sqrt(2)
    noisy = noisy / np.linalg.norm(noisy, axis=-1, keepdims=True)
    known = np.isfinite(normal[..., 2])
    status = np.where(known, NormalStatus.MEASURED, NormalStatus.NO_SAMPLES).astype(np.uint8)
    variance = np.where(known, max(sigma, 1e-3) ** 2, np.nan).astype(np.float32)
    return NormalMap(noisy.astype(np.float32), (0.5 * noisy).astype(np.float32), variance, status, PIXEL_M)


def left_over_px(depth_m, truth_px, where):
    error = depth_m[where] / PIXEL_M - truth_px[where]
    return error - np.median(error)


def test_a_ball_comes_out_round():
    """The chord of a circle is square to the mean of its ends' normals: nothing is lost in the steps."""
    height, normal = shapes.ball(60)
    depth = integrate(map_of(normal))
    assert np.abs(left_over_px(depth, height * 30, np.isfinite(height))).max() < 0.05
    assert abs(np.nanmean(depth)) < 1e-9
    np.testing.assert_array_equal(np.isnan(depth), np.isnan(height))


def test_noise_stays_small():
    """Of 3 deg per normal a hundredth of the picture's width remains at most: neighbours' errors cancel."""
    height, normal = shapes.hills(60, seed=2)
    error = left_over_px(integrate(map_of(normal, sigma=0.05)), height * 30, np.isfinite(height))
    assert np.sqrt(np.mean(error**2)) < 0.6


def test_every_piece_stands_about_zero():
    height, normal = shapes.hills(40, seed=3)
    normal[:, 18:21] = np.nan
    depth = integrate(map_of(normal))
    for piece in (np.s_[:, :18], np.s_[:, 21:]):
        assert abs(depth[piece].mean()) < 1e-9
        assert np.abs(left_over_px(depth[piece], height[piece] * 20, np.isfinite(depth[piece]))).max() < 0.1


def test_an_edge_bends_the_surface_less_than_least_squares(monkeypatch):
    """A small ball before a large one: the limb gives way, and three pixels of four keep their place."""
    (height, normal), (front, front_normal) = shapes.ball(64), shapes.ball(64, radius=0.4)
    front, front_normal = np.roll(front, (-6, 9), (0, 1)), np.roll(front_normal, (-6, 9), (0, 1))
    hides = np.isfinite(front)
    truth = np.where(hides, front + 1, height) * 32
    normal = np.where(hides[..., None], front_normal, normal)
    robust = integrate(map_of(normal))
    monkeypatch.setattr("processing.materials.integration._ROUNDS", 1)
    plain = integrate(map_of(normal))
    for part in (hides, np.isfinite(height) & ~hides):
        ours, theirs = (np.percentile(np.abs(left_over_px(depth, truth, part)), 75) for depth in (robust, plain))
        assert ours < theirs / 5


def test_normals_that_err_together_do_not_tear_the_surface():
    """A patch of normals leans to one side by 0.1, within their deviation: all share it, and none gives way wholly."""
    x, y = shapes.grid(96)
    lean = 0.1 * np.exp(-(x**2 + y**2) / (2 * 0.35**2))
    leaning = shapes.hills(96, seed=4, height=0.1)[1]
    leaning[..., 1] += lean
    normals = map_of(leaning)
    normals.variance[:] = 0.05**2
    slope = normals.normals[..., 1] / normals.normals[..., 2]
    missed = np.diff(integrate(normals) / PIXEL_M, axis=0) - (slope[1:] + slope[:-1]) / 2
    assert np.abs(missed).max() < 0.06


def test_no_normals_give_no_depth():
    nothing = map_of(np.full((5, 6, 3), np.nan))
    assert np.isnan(integrate(nothing)).all()


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 9), st.integers(2, 9), st.integers(0, 10_000))
def test_springs_are_the_least_squares_that_they_stand_for(rows, columns, seed):
    rng = np.random.default_rng(seed)
    right, down = rng.uniform(0, 1, (rows, columns - 1)) ** 4, rng.uniform(0, 1, (rows - 1, columns)) ** 4
    truth = rng.normal(size=(rows, columns))
    load = grid_springs.apply(right, down, truth)
    found = grid_springs.solve((right, down), load, np.zeros((rows, columns)), 1e-10)
    np.testing.assert_allclose(found - found.mean(), truth - truth.mean(), atol=1e-4)


def test_a_mesh_faces_the_camera_and_carries_the_picture():
    height, _ = shapes.ball(20)
    depth = height * 10 * PIXEL_M
    positions, triangles, uv = triangulate(depth, PIXEL_M)
    corner = positions[triangles]
    facing = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2]
    assert (facing > 0).all()
    assert triangles.max() == len(positions) - 1
    column, row = (uv * 20 - 0.5).round().astype(int).T
    expected = plane_points(depth.shape, PIXEL_M)[row, column]
    np.testing.assert_allclose(positions[:, :2], expected[:, :2], atol=1e-12)
    np.testing.assert_allclose(positions[:, 2], depth[row, column])


def test_a_mesh_has_holes_where_the_surface_has_none():
    depth = np.zeros((6, 6))
    depth[2, 2] = np.nan
    depth[:, 4:] = 20 * PIXEL_M
    _, triangles, uv = triangulate(depth, PIXEL_M)
    # 25 squares, of which 5 span the step; a missing pixel takes four squares, each of which keeps one triangle
    assert len(triangles) == 2 * 20 - 4
    assert len(uv) == 35


def test_no_surface_is_no_mesh():
    with pytest.raises(ImageError, match="no surface"):
        triangulate(np.full((4, 4), np.nan), PIXEL_M)
