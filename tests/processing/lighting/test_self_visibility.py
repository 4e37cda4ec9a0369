"""Self-visibility: what rays see, times the cosine."""

import numpy as np
import pytest

from processing.lighting.directions import sample_directions
from processing.lighting.rays import Occluder
from processing.lighting.self_visibility import self_visibility
from processing.lighting.triangle_body import triangle_body
from tests.processing.lighting.bodies import box, sphere, square

SAMPLED = sample_directions(9)


def traced(body):
    """Visibility times cosine (vertex, leaf), ray by ray: the slow twin."""
    count = len(SAMPLED.directions)
    origins = np.repeat(body.origins.astype(np.float32), count, axis=0)
    blocked = Occluder(body.vertices, body.triangles).blocks(origins, np.tile(SAMPLED.rays, (len(body.vertices), 1)))
    cosine = np.maximum(body.normals @ SAMPLED.directions.T, 0)
    return np.where(blocked.reshape(-1, count), 0, cosine)


def hollow():
    """A box in a corner of three walls: some of its vertices see little."""
    bodies = [box(), box((0.5, -1, -1), (0.6, 1, 1)), square(4.0)]
    shift = np.cumsum([0, 8, 8])
    vertices = np.concatenate([one for one, _ in bodies])
    return triangle_body(vertices, np.concatenate([t + s for (_, t), s in zip(bodies, shift, strict=True)]))


def test_without_tolerance_it_is_every_ray():
    body = hollow()
    cuts, rays = self_visibility(body, SAMPLED, 0.0)
    expected = traced(body)
    assert len(cuts) == len(body.vertices)
    assert np.allclose([cuts.leaves(i) for i in range(len(cuts))], expected, atol=1e-6)
    assert rays == (body.normals @ SAMPLED.directions.T > 0).sum()


def test_the_tolerance_bounds_the_error_of_each_node():
    body, tolerance = hollow(), 0.05
    cuts, _ = self_visibility(body, SAMPLED, tolerance)
    for i, truth in enumerate(traced(body)):
        starts = np.concatenate([[0], np.cumsum(1 << cuts.heights[cuts.first[i] : cuts.first[i + 1]].astype(int))])[:-1]
        squares = np.add.reduceat(SAMPLED.solid_angle * (cuts.leaves(i) - truth) ** 2, starts)
        assert (np.sqrt(squares) <= tolerance * (1 + 1e-5)).all()
        assert cuts.leaves(i) @ SAMPLED.solid_angle == pytest.approx(truth @ SAMPLED.solid_angle, rel=1e-5, abs=1e-7)


def test_an_open_floor_and_a_ball_see_their_hemisphere():
    """The integral of the cosine over a hemisphere is pi; a faceted ball's own facets hide its horizon."""
    for vertices, triangles in (square(), sphere(48)):
        body = triangle_body(vertices, triangles)
        cuts, _ = self_visibility(body, SAMPLED, 0.01)
        light = [cuts.leaves(i) @ SAMPLED.solid_angle for i in range(0, len(cuts), 97)]
        assert np.allclose(light, np.pi, rtol=0.02)


def test_vertices_without_a_normal_see_nothing():
    vertices, triangles = square()
    body = triangle_body(np.concatenate([vertices, [[0, 0, 5]]]), triangles)
    cuts, _ = self_visibility(body, SAMPLED, 0.01)
    assert not cuts.leaves(4).any()
    assert cuts.first[5] - cuts.first[4] == 1


def test_inner_vertices_of_a_closed_body_see_nothing():
    outer, inner = box((-2, -2, -2), (2, 2, 2)), box()
    body = triangle_body(np.concatenate([outer[0], inner[0]]), np.concatenate([outer[1], inner[1] + 8]))
    cuts, _ = self_visibility(body, SAMPLED, 0.0)
    assert not np.concatenate([cuts.leaves(i) for i in range(8, 16)]).any()


def test_progress_is_told():
    class Told:
        def track(self, items, description):
            seen.append((description, len(items)))
            yield from items

    seen = []
    self_visibility(triangle_body(*square()), SAMPLED, 0.1, Told())
    assert seen == [("self-visibility", 1)]
