"""The field of a body: every ray that could meet it, at every point; nothing else."""

import numpy as np
import pytest

from processing.lighting.directions import sample_directions
from processing.lighting.field import trace_field
from processing.lighting.rays import Occluder
from processing.lighting.shells import ShellPlan
from processing.lighting.toggles import visible_leaves
from processing.lighting.tracing import _changes
from processing.lighting.triangle_body import triangle_body
from tests.processing.lighting.bodies import box, sphere, square

SAMPLED = sample_directions(9)


def field_of(body, resolution=4, **plan):
    return trace_field(body, SAMPLED, ShellPlan(resolution, **plan).around(body.centre, body.radius))


def traced(body, points):
    count = len(SAMPLED.directions)
    origins = np.repeat(points.astype(np.float32), count, axis=0)
    blocked = Occluder(body.vertices, body.triangles).blocks(origins, np.tile(SAMPLED.rays, (len(points), 1)))
    return ~blocked.reshape(-1, count)


@pytest.fixture(scope="module")
def stool():
    """A seat on one leg, off the origin."""
    parts = [box((0.9, 0.9, 1), (2.1, 2.1, 1.1)), box((1.4, 1.4, 0), (1.6, 1.6, 1))]
    triangles = np.concatenate([t + 8 * i for i, (_, t) in enumerate(parts)])
    return triangle_body(np.concatenate([v for v, _ in parts]), triangles)


@pytest.fixture(scope="module", params=["growing", "uniform"])
def made(request, stool):
    return field_of(stool, spacing=request.param)


def test_it_is_every_ray_at_every_point(made, stool):
    field, rays = made
    points = field.shells.points(0, len(field.shells))
    expected = traced(stool, points)
    for i in range(len(points)):
        assert np.array_equal(visible_leaves(field.toggles[field.first[i] : field.first[i + 1]], 9), expected[i])
    assert rays < 0.6 * expected.size


def test_changes_alternate_and_ascend(made):
    field, _ = made
    ascending = np.diff(field.toggles.astype(int)) > 0
    ends = field.first[1:-1]
    ascending[ends[(ends > 0) & (ends < len(field.toggles))] - 1] = True
    assert ascending.all()


@pytest.mark.parametrize("blocked", [np.ones(5, bool), np.array([1, 0, 1, 0, 1], bool), np.zeros(5, bool)])
def test_leaves_traced_alone_are_changes_forth_and_back(blocked):
    leaves = np.array([0, 2, 4, 6, 15], np.int32)
    counts, toggles = _changes(np.array([0, 5]), leaves, blocked, 16)
    visible = np.ones(16, bool)
    visible[leaves[blocked]] = False
    assert np.array_equal(visible_leaves(toggles, 4), visible)
    assert counts == [len(toggles)]


def test_cuts_are_the_same_function(made):
    field, _ = made
    numbers = np.arange(0, len(field.shells), 37, dtype=np.int32)
    cuts = field.cuts(numbers)
    for k, i in enumerate(numbers):
        assert np.array_equal(cuts.leaves(k) > 0, visible_leaves(field.toggles[field.first[i] : field.first[i + 1]], 9))
    assert field.mean_cut == pytest.approx(field.cuts(np.arange(len(field.shells))).mean_size)


def test_at_sample_points_the_interpolated_field_is_what_was_traced(made, stool):
    field, _ = made
    numbers = np.flatnonzero(~field.sealed)[::29]
    points = np.concatenate([field.shells.points(i, i + 1) for i in numbers])
    assert np.allclose(field.visibility(points), traced(stool, points), atol=1e-4)


def test_a_ball_blocks_the_solid_angle_of_its_cone():
    """Some 25 leaves of 0.025 lie on the cone's edge, each half in by chance, at four points: 0.03, four times."""
    body = triangle_body(*sphere(24))
    field, _ = field_of(body)
    distances = field.shells.radii[field.shells.radii > 1.5]
    for distance in distances:
        (seen,) = field.visibility(np.array([[0, 0, distance]])) @ SAMPLED.solid_angle[:, None]
        assert 4 * np.pi - seen == pytest.approx(2 * np.pi * (1 - np.sqrt(1 - 1 / distance**2)), abs=0.12)


def test_points_inside_a_closed_body_are_sealed_and_left_out():
    body = triangle_body(*box())
    field, _ = field_of(body)
    points = field.shells.points(0, len(field.shells))
    inside = (np.abs(points) < 0.499).all(axis=1)
    assert inside.any()
    assert np.array_equal(field.sealed, inside)
    outside = np.array([[0.51, 0.1, 0.1]])
    numbers, weights = field.cells(outside)
    assert not weights[field.sealed[numbers]].any()


def test_an_open_body_is_thin_and_blocks_from_both_sides():
    field, _ = field_of(triangle_body(*square()))
    assert not field.sealed.any()
    for side in (1, -1):
        (seen,) = field.visibility(np.array([[0, 0, 0.5 * side]]))
        assert seen[SAMPLED.directions[:, 2] * side > 0.2].min() > 0.999
        assert seen[SAMPLED.directions[:, 2] * side < -0.99].max() < 0.001


def test_beyond_the_last_sphere_all_is_visible(made, stool):
    field, _ = made
    assert (field.visibility(stool.centre + np.array([[0, 0, 10.1 * stool.radius]])) == 1).all()
