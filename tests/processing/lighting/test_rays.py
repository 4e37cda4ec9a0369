"""Rays: what triangles block, from both sides and where they meet."""

import numpy as np
import pytest

from processing.lighting.rays import Occluder
from processing.threads import in_parts
from tests.processing.lighting.bodies import sphere


@pytest.fixture(scope="module")
def ball():
    return sphere(32)


def test_a_ball_blocks_from_both_sides_what_is_towards_it(ball):
    vertices, triangles = ball
    directions = np.float32([[0, 0, -1], [0, 0, 1], [1, 0, 0]])
    occluder = Occluder(vertices, triangles)
    assert occluder.blocks(np.tile(np.float32([0.1, 0, 3]), (3, 1)), directions).tolist() == [True, False, False]
    assert occluder.blocks(np.zeros((3, 3), np.float32), directions).all()


def test_rays_do_not_slip_through_edges_and_vertices(ball):
    vertices, triangles = ball
    middles = vertices[triangles[:, :2]].mean(axis=1)
    toward = np.concatenate([vertices, middles]).astype(np.float32)
    assert Occluder(vertices, triangles).blocks(np.zeros_like(toward), toward).all()


def test_threads_find_what_one_finds(ball):
    occluder, rng = Occluder(*ball), np.random.default_rng(1)
    origins, directions = rng.normal(size=(2, 4096, 3)).astype(np.float32)
    parts = in_parts(lambda start, stop: occluder.blocks(origins[start:stop], directions[start:stop]), 4096, 256)
    assert np.array_equal(np.concatenate(parts), occluder.blocks(origins, directions))


def test_the_first_hit_is_the_nearest_triangle():
    vertices = np.array([[x, y, z] for z in (1.0, 2.0) for x, y in ((-1, -1), (3, -1), (-1, 3))])
    occluder = Occluder(vertices, np.array([[3, 4, 5], [0, 1, 2]], np.int32))
    up, down = [0, 0, 1], [0, 0, -1]
    assert occluder.first_hits(np.zeros((2, 3), np.float32), np.float32([up, down])).tolist() == [1, -1]
