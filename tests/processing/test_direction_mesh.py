"""Weights between measured directions: exact in triangles, of the nearest point beyond, no step anywhere."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from processing.products import DirectionMesh


def random_directions(count: int, seed: int) -> np.ndarray:
    """Unit vectors (count, 3) above the horizon."""
    rows = np.random.default_rng(seed).normal(size=(count, 3))
    rows[:, 2] = np.abs(rows[:, 2]) + 0.05
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def on_grid(side: int) -> np.ndarray:
    """Directions on a square of the disc, whose border is straight."""
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-0.6, 0.6, side)] * 2))
    return np.column_stack([x, y, np.sqrt(1 - x * x - y * y)])


def blended(mesh: DirectionMesh, xy: np.ndarray) -> np.ndarray:
    """Where the weights say that points (n, 2) are."""
    indices, weights = mesh.weights(np.column_stack([xy, np.zeros(len(xy))]))
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-12)
    assert (weights >= 0).all()
    return np.einsum("nk,nki->ni", weights, mesh.directions[indices][:, :, :2])


def nearest_of_hull(xy: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (n, 2) themselves, or the nearest ones of the hull of `xy`: each edge asked."""
    hull = ConvexHull(xy)
    inside = (points @ hull.equations[:, :2].T + hull.equations[:, 2] <= 0).all(axis=1)
    start, end = xy[hull.simplices[:, 0]], xy[hull.simplices[:, 1]]
    way = end - start
    along = np.clip(np.einsum("nhi,hi->nh", points[:, None] - start, way) / (way * way).sum(axis=1), 0, 1)
    candidates = start + along[..., None] * way
    chosen = np.linalg.norm(candidates - points[:, None], axis=2).argmin(axis=1)
    return np.where(inside[:, None], points, candidates[np.arange(len(points)), chosen])


@settings(max_examples=30, deadline=None)
@given(st.integers(3, 60), st.integers(0, 10_000))
def test_weights_lead_to_the_point_or_the_nearest_of_the_hull(count, seed):
    directions = random_directions(count, seed)
    points = np.random.default_rng(seed + 1).uniform(-1, 1, (500, 2))
    found = blended(DirectionMesh.from_directions(directions), points)
    np.testing.assert_allclose(found, nearest_of_hull(directions[:, :2], points), atol=1e-7)


@settings(max_examples=20, deadline=None)
@given(st.integers(3, 60), st.integers(0, 10_000))
def test_weights_of_each_direction_change_as_little_as_the_point(count, seed):
    """Along lines through inside, border and outside; the steepest weight is one over a triangle's least height."""
    mesh = DirectionMesh.from_directions(random_directions(count, seed))
    start, end = np.random.default_rng(seed).uniform(-1, 1, (2, 20, 1, 2))
    along = np.linspace(0, 1, 2001)[:, None]
    points = start + along * (end - start)
    indices, weights = mesh.weights(np.column_stack([points.reshape(-1, 2), np.zeros(points.size // 2)]))
    of_each = np.zeros((len(indices), count))
    np.add.at(of_each, (np.arange(len(indices))[:, None], indices), weights)
    steps = np.abs(np.diff(of_each.reshape(20, 2001, count), axis=1)).max()
    steepest = np.linalg.norm(mesh.regions.slopes, axis=2)
    first = np.linalg.norm(mesh.regions.slopes.sum(axis=1), axis=1)
    length = np.linalg.norm(end - start, axis=2).max() / 2000
    assert steps <= 1.01 * length * max(steepest.max(), first.max()) + 1e-9


@settings(max_examples=20, deadline=None)
@given(st.integers(3, 60), st.integers(0, 10_000))
def test_measured_directions_answer_for_themselves(count, seed):
    directions = random_directions(count, seed)
    indices, weights = DirectionMesh.from_directions(directions).weights(directions)
    best = weights.argmax(axis=1)
    np.testing.assert_allclose(weights.max(axis=1), 1, atol=1e-6)
    np.testing.assert_array_equal(np.take_along_axis(indices, best[:, None], axis=1)[:, 0], np.arange(count))


def test_straight_borders_and_doubled_directions():
    directions = np.concatenate([on_grid(5), on_grid(5)[:7]])
    points = np.random.default_rng(1).uniform(-1, 1, (4000, 2))
    found = blended(DirectionMesh.from_directions(directions), points)
    np.testing.assert_allclose(found, np.clip(points, -0.6, 0.6), atol=1e-9)
