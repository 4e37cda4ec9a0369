"""Visibility at single points: what lies under a horizon is left out, blocks are refined where they are unlike."""

import numpy as np
import pytest

from processing.lighting.directions import sample_directions
from processing.lighting.toggles import visible_leaves
from processing.lighting.tracing import BodyTracer, leaf_rays
from processing.lighting.triangle_body import triangle_body
from tests.processing.lighting.bodies import box, sphere

SAMPLED = sample_directions(12)
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0], [0.48, 0.64, 0.6]])
NORMALS = np.array([[0, 0, 1.0], [0.6, 0, -0.8], [0, 0, 0]])
POINTS = np.array([[0.1, 0.2, -1.05], [-2.0, 0.3, 1.5], [1.3, 1.3, 0]])


def unpacked(counts, toggles):
    ends = np.cumsum(counts)
    return np.array([visible_leaves(toggles[end - n : end], 12) for end, n in zip(ends, counts, strict=True)])


@pytest.mark.parametrize("body", [triangle_body(*sphere(12)), triangle_body(*box((-1, -1, -0.9), (1, 1, 1)))])
def test_blocks_are_the_leaves_but_for_slivers(body):
    tracer, leaves = BodyTracer(body), leaf_rays(SAMPLED)
    every, some = tracer.changes(POINTS, NORMALS, leaves), tracer.changes_of_blocks(POINTS, NORMALS, leaves)
    apart = unpacked(*every[:2]) != unpacked(*some[:2])
    assert (apart @ SAMPLED.solid_angle < 0.002 * 4 * np.pi).all()
    assert some[2] < 0.7 * every[2]


def test_what_is_above_the_horizon_is_what_was_traced_in_any_frame():
    body = triangle_body(*sphere(12))
    counts, toggles, _ = BodyTracer(body).changes(POINTS, NORMALS, leaf_rays(SAMPLED).turned(TURN))
    for point, normal, visible in zip(POINTS, NORMALS, unpacked(counts, toggles), strict=True):
        ways = SAMPLED.directions @ TURN.T
        above = ways @ normal >= 0
        starts = np.broadcast_to(point.astype(np.float32), ways.shape).copy()
        assert np.array_equal(visible[above], ~body.occluder.blocks(starts, ways.astype(np.float32))[above])
