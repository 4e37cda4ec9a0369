"""What a flat body hides by its outline: as rays to its triangles say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.lighting.directions import sample_directions
from processing.lighting.outline import flat_outline
from processing.lighting.toggles import visible_leaves
from processing.lighting.triangle_body import triangle_body
from tests.processing.lighting.bodies import box, square

SAMPLED = sample_directions(9)
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0], [0.48, 0.64, 0.6]])


def grid(keep):
    """A floor of squares (rows, columns), those kept; every vertex is there once for each of its triangles."""
    corners = np.argwhere(keep)[:, None] + np.array([[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]])
    flat = corners.reshape(-1, 2).astype(float)
    vertices = np.column_stack([flat, np.zeros(len(flat))]) @ TURN.T + 0.3
    return triangle_body(vertices, np.arange(len(vertices)).reshape(-1, 3))


def hidden(body, point, rays=SAMPLED.rays):
    return body.occluder.blocks(np.broadcast_to(point.astype(np.float32), rays.shape).copy(), rays)


RING = np.ones((4, 3), bool)
RING[1:3, 1] = False


@pytest.mark.parametrize(("keep", "edges"), [(np.ones((3, 5), bool), 4), (RING, 8), (np.array([[1, 1], [1, 0]]), 6)])
def test_straight_edges_are_one(keep, edges):
    outline = flat_outline(grid(keep))
    assert len(outline.edges) == edges


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1e-4, 0.02, 1.0, 30.0]))
def test_it_hides_what_the_triangles_hide(seed, height):
    """But for rays that pass an edge within rounding; in the plane itself nothing is hidden."""
    rng = np.random.default_rng(seed)
    body = grid(RING)
    points = (np.column_stack([rng.uniform(-2, 6, (3, 2)), np.full(3, height)]) @ TURN.T) + 0.3
    counts, toggles = flat_outline(body).changes(points, np.zeros((3, 3)), SAMPLED)
    ends = np.cumsum(counts)
    for point, end, count in zip(points, ends, counts, strict=True):
        visible = visible_leaves(toggles[end - count : end], 9)
        assert (visible == hidden(body, point)).sum() <= (0 if height else len(visible))
        if height == 0:
            assert visible.all()


def test_above_a_horizon_it_is_the_same():
    body = triangle_body(*square(3.0))
    points, normals = np.array([[0.2, 0.1, 0.5], [1.4, -1, 2]]), np.array([[1.0, 0, 0], [0.6, 0, -0.8]])
    counts, toggles = flat_outline(body).changes(points, normals, SAMPLED)
    for point, normal, end, count in zip(points, normals, np.cumsum(counts), counts, strict=True):
        above = SAMPLED.directions @ normal > 0
        visible = visible_leaves(toggles[end - count : end], 9)
        assert np.array_equal(visible[above], ~hidden(body, point)[above])


def test_bodies_that_are_no_simple_area_have_none():
    vertices, triangles = square()
    twice = triangle_body(vertices, np.concatenate([triangles, triangles]))
    comb = np.zeros((3, 41), bool)
    comb[0], comb[1:, ::2] = True, True
    for body in (triangle_body(*box()), twice, grid(comb), grid(np.eye(2, dtype=bool))):
        assert flat_outline(body) is None
