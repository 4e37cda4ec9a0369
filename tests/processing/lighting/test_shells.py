"""Sample points on spheres: each is its own cell, weights are shares that change continuously."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.lighting.shells import ShellPlan

CENTRE = np.array([0.5, -1.0, 2.0])
DIRECTION = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda d: np.linalg.norm(d) > 0.1)


def shells(resolution=4, spacing="growing"):
    return ShellPlan(resolution, spacing).around(CENTRE, 2.0)


def dense(made, points):
    numbers, weights = made.cells(points)
    found = np.zeros((len(points), len(made)))
    np.add.at(found, (np.arange(len(points))[:, None], numbers), weights)
    return found


@pytest.mark.parametrize("spacing", ["growing", "uniform"])
def test_the_papers_points_are_196608(spacing):
    made = shells(32, spacing)
    assert len(made) == 196_608
    assert made.radii[[0, -1]] == pytest.approx([0.4, 20.0])


@pytest.mark.parametrize("resolution", [2, 3, 5])
def test_every_sample_point_is_its_own_cell(resolution):
    made = shells(resolution)
    assert np.allclose(dense(made, made.points(0, len(made))), np.eye(len(made)), atol=1e-5)


def test_points_of_a_sphere_are_even_within_a_third():
    """Equal angles across a face: cells' areas differ by 1.4 from middle to corner, distances by its root."""
    made = shells(8)
    points = made.points(0, 6 * 64)
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    nearest = apart.min(axis=1)
    assert nearest.max() < 4 / 3 * nearest.min()


@settings(deadline=None)
@given(DIRECTION, st.floats(0, 9.99))
def test_weights_are_shares(direction, radii):
    made = shells()
    _, weights = made.cells(CENTRE + np.array([direction]) / np.linalg.norm(direction) * 2 * radii)
    assert weights.sum() == pytest.approx(1, abs=1e-5)
    assert (weights >= -1e-6).all()


@settings(deadline=None)
@given(st.integers(0, 5), st.tuples(*[st.floats(-0.75, 0.75)] * 2), st.floats(0.2, 10))
def test_radius_and_angles_across_a_face_are_interpolated_linearly(face, angles, radii):
    """Both are coordinates in which cells are a grid: shares times the samples' coordinates are the point's."""
    made, axis = shells(), face // 2
    place = np.empty(3)
    place[axis], place[[(axis + 1) % 3, (axis + 2) % 3]] = 1 - 2 * (face % 2), np.tan(np.pi / 4 * np.array(angles))
    place *= 2 * radii / np.linalg.norm(place)
    (weights,) = dense(made, CENTRE + place[None])
    samples = made.points(0, len(made)) - CENTRE
    assert weights @ np.linalg.norm(samples, axis=1) == pytest.approx(2 * radii, rel=1e-5)
    for k, angle in enumerate(angles, 1):
        across = np.arctan(samples[:, (axis + k) % 3] / np.abs(samples[:, axis])) * 4 / np.pi
        assert weights @ across == pytest.approx(angle, abs=1e-5)


@settings(deadline=None)
@given(DIRECTION, st.floats(0.1, 9.5), DIRECTION)
def test_weights_change_continuously_also_over_edges_and_corners(direction, radii, aside):
    made = shells()
    place = np.array(direction) / np.linalg.norm(direction) * 2 * radii
    step = 1e-5 * np.array(aside) * np.linalg.norm(place)
    one, two = dense(made, CENTRE + np.stack([place, place + step]))
    assert np.abs(one - two).max() < 1e-3


@pytest.mark.parametrize("corner", [(1, 1, 1), (-1, 1, 1), (1, -1, -1)])
@pytest.mark.parametrize("edge", [(0, 0, 0), (1e-9, 0, 0), (0, 1e-9, 0), (0, 0, 1e-9)])
def test_the_three_points_around_a_corner_count_alike(corner, edge):
    made = shells()
    (found,) = dense(made, CENTRE + made.radii[1] * (np.array([corner]) + edge) / np.sqrt(3))
    assert np.allclose(np.sort(found)[-3:], 1 / 3, atol=1e-3)


def test_outside_nothing_counts_and_inside_the_first_sphere():
    made = shells()
    up = np.array([0.1, 0.2, 1.0]) / np.linalg.norm([0.1, 0.2, 1.0])
    assert not made.cells((CENTRE + 20.001 * up)[None])[1].any()
    assert not made.cells(np.full((1, 3), np.nan))[1].any()
    assert np.allclose(dense(made, (CENTRE + 0.1 * up)[None]), dense(made, (CENTRE + 0.4 * up)[None]), atol=1e-5)
    assert made.cells(CENTRE[None])[1].sum() == pytest.approx(1)


def test_points_left_out_do_not_count_unless_all_are():
    made = shells()
    rng = np.random.default_rng(3)
    points, out = CENTRE + 3 * rng.normal(size=(500, 3)), rng.uniform(size=len(made)) < 0.7
    numbers, weights = made.cells(points, out)
    partly = (dense(made, points) * ~out).sum(axis=1) > 1e-3
    assert weights[out[numbers] & partly[:, None]].max() == 0
    assert np.allclose(weights.sum(axis=1), 1, atol=1e-5)


@pytest.mark.parametrize("given", [{"resolution": 1}, {"nearest": 0.0}, {"nearest": 3.0, "farthest": 2.0}])
def test_impossible_spheres_are_refused(given):
    with pytest.raises(ValueError, match="shells"):
        ShellPlan(**given)
