"""Covering spheres hold what they stand for, and little else."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.lighting.cover import covering_spheres
from processing.lighting.triangle_body import triangle_body
from tests.processing.lighting.bodies import sphere


@settings(deadline=None, max_examples=30)
@given(st.integers(1, 60), st.integers(0, 2**32 - 1))
def test_every_triangle_lies_in_one_of_them_and_in_the_first(count, seed):
    rng = np.random.default_rng(seed)
    body = triangle_body(rng.normal(size=(3 * count, 3)), np.arange(3 * count).reshape(-1, 3))
    spheres = covering_spheres(body)
    corners = body.vertices[body.triangles]
    apart = np.linalg.norm(corners[:, :, None] - spheres[:, :3], axis=-1).max(axis=1) - spheres[:, 3]
    assert (apart[:, 0] < 1e-9).all()
    assert (apart[:, 1:].min(axis=1) < 1e-9).all()


def test_two_balls_far_apart_have_no_sphere_between_them():
    vertices, triangles = sphere(8)
    both = np.concatenate([vertices, vertices + np.array([50, 0, 0])])
    spheres = covering_spheres(triangle_body(both, np.concatenate([triangles, triangles + len(vertices)])))
    assert (spheres[1:, 3] <= 1 + 1e-9).all()
    assert spheres[0, 3] > 25
