"""Light on the leaves: none is lost, whatever turns it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from processing.errors import GeometryError, ImageError
from processing.lighting.directions import sample_directions
from processing.lighting.light import EnvironmentLight, leaf_at, leaves_of, nearest_leaves, turned_leaves
from processing.products.light_environment import Environment

SAMPLED = sample_directions(9)
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0], [0.48, 0.64, 0.6]])


def sky(sun=0.0, size=8):
    radiance = np.random.default_rng(1).uniform(0, 2, (6, size, size, 3)).astype(np.float32)
    radiance[4, 3, 5] += np.float32(sun)
    return Environment(radiance)


@pytest.mark.parametrize("turn", [np.eye(3), TURN])
@pytest.mark.parametrize("sun", [0.0, 1e5])
def test_all_light_arrives(sun, turn):
    made = sky(sun)
    found = EnvironmentLight(made, SAMPLED).turned(turn)
    assert np.allclose(found.values.sum(axis=0), made.integral, rtol=1e-5)
    assert np.allclose(found.sums[-1, :3], made.integral, rtol=1e-5)


def test_an_even_sky_lights_leaves_by_their_size():
    found = EnvironmentLight(Environment(np.ones((6, 4, 4, 3), np.float32)), SAMPLED).turned(TURN)
    assert np.allclose(found.values, SAMPLED.solid_angle[:, None], rtol=0.05)  # 770 parts fall on each leaf


def test_a_sun_is_where_it_is_turned_to():
    made = sky(1e5)
    brightest = EnvironmentLight(made, SAMPLED).turned(TURN).values[:, 0].argmax()
    toward = TURN @ made.directions[4, 3, 5]
    assert SAMPLED.directions[brightest] @ toward > np.cos(0.15)  # a texel is 0.25 across, a leaf 0.16


def test_a_dark_sky_keeps_its_digits_beside_a_sun():
    dim = Environment(np.full((6, 8, 8, 3), 1e-3, np.float32))
    radiance = dim.radiance.copy()
    radiance[4, 3, 5] = 1e5
    both, alone = (EnvironmentLight(one, SAMPLED).turned(np.eye(3)) for one in (Environment(radiance), dim))
    dark = both.values[:, 0] == alone.values[:, 0]
    assert dark.mean() > 0.95
    leaf = int(np.flatnonzero(dark)[-1])
    assert both.sums[leaf + 1, 0] - both.sums[leaf, 0] == pytest.approx(alone.values[leaf, 0], rel=1e-4)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1.0])
def test_what_is_no_light_is_refused(bad):
    radiance = np.ones((6, 2, 2, 3), np.float32)
    radiance[0, 0, 0, 0] = bad
    with pytest.raises(ImageError):
        Environment(radiance)


@pytest.mark.parametrize("bad", [np.diag([1.0, 1, -1]), 2 * np.eye(3), np.full((3, 3), np.nan), np.eye(4)])
def test_only_rotations_turn(bad):
    with pytest.raises(GeometryError):
        EnvironmentLight(sky(), SAMPLED).turned(bad)


def test_leaves_are_found_within_a_cell_of_the_table():
    directions = np.random.default_rng(2).normal(size=(500, 3))
    found = np.array([leaf_at(*way, nearest_leaves(SAMPLED)) for way in directions])
    along = (directions / np.linalg.norm(directions, axis=1, keepdims=True)) @ SAMPLED.directions.T
    near = np.arccos(np.clip(along, -1, 1))
    assert (near[np.arange(500), found] - near.min(axis=1)).max() < 2 * 2 / 256


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.sampled_from([4, 9, 12]))
def test_turned_leaves_are_the_nearest_ones(seed, height):
    sampled, turn = sample_directions(height), Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    ways = sampled.directions @ turn.T
    found = turned_leaves(turn, sampled)
    expected = leaves_of(ways, sampled)
    along = [(ways * sampled.directions[leaf]).sum(axis=1) for leaf in (found, expected)]
    assert np.allclose(*along, rtol=0, atol=1e-12)
