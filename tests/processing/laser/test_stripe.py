"""Stripes in single images, planes through points."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.laser.plane_fit import Plane, fit_plane, plane_angle
from processing.laser.ridge import stripe_ridge
from processing.laser.stripe import redness, stripe_line


def painted(angle_rad, offset_px, noise=0.0, seed=0):
    """An image of a Gaussian stripe, sigma 2 px, height 100, and its signed distance image."""
    rows, columns = np.indices((80, 100))
    distance = (columns - 50) * np.cos(angle_rad) + (rows - 40) * np.sin(angle_rad) - offset_px
    return 100 * np.exp(-0.5 * (distance / 2) ** 2) + np.random.default_rng(seed).normal(0, noise, rows.shape)


@given(angle=st.floats(-0.7, 0.7), offset=st.floats(-8, 8))
@settings(max_examples=25, deadline=None)
def test_ridge_is_the_middle_of_the_stripe(angle, offset):
    """Without noise to a fiftieth of a pixel, whatever the direction."""
    ridge = stripe_ridge(painted(angle, offset), 2.0, 5.0)
    inner = (np.abs(ridge.uv_px - [50, 40]) < [38, 30]).all(axis=1)
    u, v = (ridge.uv_px[inner] - [50, 40]).T
    assert inner.sum() > 25
    assert np.abs(u * np.cos(angle) + v * np.sin(angle) - offset).max() < 0.02


def test_line_through_noisy_ridge():
    line = stripe_line(stripe_ridge(painted(0.3, 4.2, noise=5.0), 2.0, 15.0).uv_px)
    assert abs(abs(line.normal @ [np.cos(0.3), np.sin(0.3)]) - 1) < 1e-4
    assert line.rms_px < 0.3


def test_ridge_stays_inside_its_mask():
    mask = np.zeros((80, 100), bool)
    mask[20:60, 30:45] = True
    ridge = stripe_ridge(painted(0.0, -10.0) + painted(0.0, 25.0), 2.0, 5.0, mask)
    assert len(ridge.uv_px) == 40
    assert np.all(np.abs(ridge.uv_px[:, 0] - 40) < 0.02)
    assert len(stripe_ridge(painted(0.0, 0.0), 2.0, 5.0, np.zeros((80, 100), bool)).uv_px) == 0


def test_empty_image_has_no_stripe():
    assert len(stripe_ridge(np.zeros((40, 40)), 2.0, 1.0).uv_px) == 0


def test_a_third_of_wrong_points_does_not_turn_the_line():
    rng = np.random.default_rng(1)
    v = np.arange(90.0)
    points = np.stack([20 + 0.4 * v + rng.normal(0, 0.1, 90), v], axis=1)
    points[::3, 0] = rng.uniform(0, 100, 30)
    line = stripe_line(points)
    slope = -line.normal[1] / line.normal[0]
    assert slope == pytest.approx(0.4, abs=0.003)


@pytest.mark.parametrize("points", [np.zeros((2, 2)), np.ones((10, 2))])
def test_points_that_make_no_line_are_refused(points):
    with pytest.raises(ImageError):
        stripe_line(points)


def test_grey_has_no_redness():
    grey = np.full((3, 4, 3), 90, np.uint8)
    assert np.all(redness(grey) == 0)
    with pytest.raises(ImageError, match="colour"):
        redness(grey[..., 0])


@given(seed=st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_plane_survives_wrong_points(seed):
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    basis = np.linalg.svd(normal[None])[2][1:]
    points = rng.uniform(-0.1, 0.1, (200, 2)) @ basis + 0.4 * normal + rng.normal(0, 1e-4, (200, 1)) * normal
    points[::10] += rng.normal(0, 0.02, (20, 3))
    plane = fit_plane(points).towards(normal)
    assert plane_angle(plane, Plane(normal, 0.4, 0.0, 0)) < 1.5e-3
    assert plane.offset_m == pytest.approx(0.4, abs=1e-4)


def test_plane_needs_three_points_off_a_line():
    with pytest.raises(ImageError):
        fit_plane(np.zeros((2, 3)))
    with pytest.raises(ImageError, match="line"):
        fit_plane(np.linspace(0, 1, 20)[:, None] * np.ones(3))


def test_rays_along_a_plane_do_not_cut_it():
    plane = Plane(np.array([0.0, 0.0, 1.0]), 0.5, 0.0, 3)
    cut = plane.cut(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]))
    np.testing.assert_allclose(cut[0], [0, 0, 0.5])
    assert np.isnan(cut[1:]).all()
