"""Places at finite and infinite distance, seen from points."""

import numpy as np
import pytest

from processing.products.directions import falloff, toward

POINTS = np.random.default_rng(2).uniform(-0.3, 0.3, (5, 4, 3))
DIRECTION = np.array([0.6, 0.0, 0.8])


def test_irradiance_falls_with_the_squared_distance():
    square = ((2.0 * DIRECTION - POINTS) ** 2).sum(axis=-1)
    np.testing.assert_allclose(falloff(POINTS, DIRECTION, 2.0), 4.0 / square)
    assert falloff(np.zeros(3), DIRECTION, 2.0) == pytest.approx(1.0)


def test_what_is_far_away_is_as_what_is_infinitely_far():
    np.testing.assert_allclose(falloff(POINTS, DIRECTION, 1e9), falloff(POINTS, DIRECTION, np.inf), rtol=1e-8)
    np.testing.assert_allclose(toward(POINTS, DIRECTION, 1e9), toward(POINTS, DIRECTION, np.inf), atol=1e-8)


def test_near_places_are_seen_at_unit_length():
    way = toward(POINTS, DIRECTION, 0.9)
    np.testing.assert_allclose(np.linalg.norm(way, axis=-1), 1.0)
    np.testing.assert_allclose(np.cross(way, 0.9 * DIRECTION - POINTS), 0.0, atol=1e-12)
