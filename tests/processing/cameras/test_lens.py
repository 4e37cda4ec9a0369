"""Lenses: the formulas against OpenCV, their inverses, their derivatives, and where they end."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from processing.cameras.lens import LENSES, Fisheye, Pinhole

MATRIX = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])
WIDE = Fisheye(np.array([[170.0, 0, 320], [0, 171, 322], [0, 0, 1]]), np.array([-0.03, 0.006, -0.002, 0.0002]))
ZERO = np.zeros(3)


def bent(name):
    barrel = {"pinhole": [-0.25, 0.08, 1e-3, -2e-3, 0.01], "fisheye": [-0.02, 0.005, -1e-3, 2e-4]}
    return LENSES[name](MATRIX, np.array(barrel[name]))


def directions(count, most_rad, rng):
    """Points (count, 3) at up to an angle from the axis, at random distances."""
    theta, around = rng.uniform(0, most_rad, count), rng.uniform(-np.pi, np.pi, count)
    unit = np.stack([np.sin(theta) * np.cos(around), np.sin(theta) * np.sin(around), np.cos(theta)], axis=1)
    return unit * rng.uniform(0.1, 10, (count, 1))


def unit(points):
    return points / np.linalg.norm(points, axis=-1, keepdims=True)


def test_opencv_projects_to_the_same_points():
    points = directions(200, np.radians(45), np.random.default_rng(0))
    theirs = cv2.projectPoints(points, ZERO, ZERO, MATRIX, bent("pinhole").distortion)[0][:, 0]
    np.testing.assert_allclose(bent("pinhole").project(points), theirs, atol=1e-8)
    points = directions(200, np.radians(85), np.random.default_rng(1))
    theirs = cv2.fisheye.projectPoints(points[:, None], ZERO, ZERO, MATRIX, bent("fisheye").distortion)[0][:, 0]
    np.testing.assert_allclose(bent("fisheye").project(points), theirs, atol=1e-8)


def test_opencv_finds_the_same_rays_of_a_fisheye():
    uv_px = bent("fisheye").project(directions(200, np.radians(80), np.random.default_rng(2)))
    plane = cv2.fisheye.undistortPoints(uv_px[:, None], MATRIX, bent("fisheye").distortion)[:, 0]
    rays = bent("fisheye").rays(uv_px)
    np.testing.assert_allclose(rays[:, :2] / rays[:, 2:], plane, atol=1e-5)


@pytest.mark.parametrize(("lens", "most_deg"), [(bent("pinhole"), 40), (bent("fisheye"), 80), (WIDE, 95), (WIDE, 100)])
def test_rays_go_where_the_points_are(lens, most_deg):
    """Also beside and behind the camera, for a lens that sees 190 deg and more."""
    points = directions(500, np.radians(most_deg), np.random.default_rng(3)).reshape(50, 10, 3)
    uv_px = lens.project(points)
    assert uv_px.shape == (50, 10, 2)
    np.testing.assert_allclose(lens.rays(uv_px), unit(points), atol=2e-8)


@pytest.mark.parametrize("lens", [bent("pinhole"), bent("fisheye"), WIDE])
def test_derivatives_are_those_of_the_formula(lens):
    points = directions(60, np.radians(40 if lens.name == "pinhole" else 94), np.random.default_rng(4))
    points[0] = 0, 0, 2  # on the axis
    uv_px, by_lens, by_point = lens.linearised(points)
    np.testing.assert_allclose(uv_px, lens.project(points), atol=1e-9)
    step = 1e-6
    for i, by in enumerate(step * np.eye(lens.parameters)):
        slope = (lens.moved(by).linearised(points)[0] - lens.moved(-by).linearised(points)[0]) / (2 * step)
        np.testing.assert_allclose(by_lens[..., i], slope, atol=1e-5)
    for i, by in enumerate(step * np.eye(3)):
        slope = (lens.linearised(points + by)[0] - lens.linearised(points - by)[0]) / (2 * step)
        np.testing.assert_allclose(by_point[..., i], slope, rtol=1e-6, atol=2e-4)


def test_a_fisheye_without_distortion_is_equidistant():
    lens = Fisheye(MATRIX, np.zeros(4))
    theta = np.radians([0, 30, 90, 95, 179])
    points = np.stack([np.sin(theta), np.zeros(5), np.cos(theta)], axis=1)
    np.testing.assert_allclose(lens.project(points)[:, 0], 320 + 500 * theta, atol=1e-9)


def test_points_that_no_lens_sees():
    behind = np.array([[0.0, 0, -1], [0.1, 0, -1]])
    assert np.isnan(bent("pinhole").project(behind)).all()
    assert np.isnan(WIDE.project(behind[:1])).all()  # straight behind: the side is unknown
    for lens in (bent("pinhole"), WIDE):
        assert np.isnan(lens.project([[np.nan, 0, 1]])).all()
    assert np.isnan(WIDE.rays(np.array([[5000.0, 0]]))).all()  # out of the image circle
    folded = Pinhole(MATRIX, np.array([-0.3, 0, 0, 0, 0]))  # images nothing beyond 0.7 focal lengths
    assert np.isnan(folded.rays(np.array([[320 + 0.75 * 500, 240], [2500.0, 240], [np.nan, 240]]))).all()
    assert np.isfinite(folded.rays(np.array([320 + 0.68 * 500, 240]))).all()
    for lens in (bent("pinhole"), WIDE):
        assert np.isnan(lens.project(np.zeros(3))).all()  # in its own centre
        assert lens.rays(np.empty((0, 2))).shape == (0, 3)
    assert np.isnan(WIDE.linearised(behind[:1])[0]).all()


@given(st.floats(-0.9, -0.05), st.floats(0, 89))
def test_a_fold_has_no_image(k1, angle_deg):
    """Where barrel distortion would bring far points back into the picture, there is no picture of them."""
    for lens in (Pinhole(MATRIX, np.array([k1, 0, 0, 0, 0])), Fisheye(MATRIX, np.array([k1, 0, 0, 0]))):
        theta = np.radians(angle_deg) + np.array([0, 1e-4])
        uv_px = lens.project(np.stack([np.sin(theta), np.zeros(2), np.cos(theta)], axis=1))[:, 0]
        assert np.isnan(uv_px[1]) or uv_px[1] > uv_px[0]


def test_a_lens_may_see_all_but_what_is_behind_it():
    stretched = Fisheye(MATRIX, np.array([0.05, 0, 0, 0]))
    assert stretched.reach_rad == pytest.approx(np.pi)
    assert Fisheye(MATRIX, np.array([-0.3, 0, 0, 0])).reach_rad == pytest.approx(np.sqrt(1 / 0.9))
