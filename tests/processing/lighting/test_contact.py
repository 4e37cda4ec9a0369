"""The zone around a body's surface: all of what is close is in it, nothing that is far."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.lighting.contact import CONTACT, contact_zone
from processing.lighting.triangle_body import triangle_body
from tests.processing.lighting.bodies import box


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1e3))
def test_it_holds_what_is_close_at_any_scale(seed, scale):
    low, high = np.array([-1.0, -0.5, -0.1]), np.array([1.0, 0.5, 0.1])
    vertices, triangles = box(scale * low, scale * high)
    zone, reach = contact_zone(triangle_body(vertices, triangles)), CONTACT * np.linalg.norm(high)
    points = np.random.default_rng(seed).uniform(-1.5, 1.5, (500, 3))
    outside = np.maximum(np.maximum(low - points, points - high), 0)
    inside = np.minimum(points - low, high - points).min(axis=1)
    distance = np.where(inside > 0, inside, np.linalg.norm(outside, axis=1))
    held, slack = zone.holds(scale * points), 2 * zone.cell_m / scale
    assert held[distance < reach - slack].all()
    assert not held[distance > reach + slack].any()
