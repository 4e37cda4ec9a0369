"""Directions: unit, even, in an order whose nodes are compact, the same every time."""

import numpy as np
import pytest

from processing.lighting.directions import sample_directions


@pytest.fixture(scope="module", params=[4, 6, 11])
def sampled(request):
    return sample_directions(request.param)


@pytest.fixture(scope="module")
def full():
    return sample_directions()


def test_they_are_unit_vectors_that_share_the_sphere(sampled):
    assert np.allclose(np.linalg.norm(sampled.directions, axis=1), 1)
    assert sampled.solid_angle.sum() == pytest.approx(4 * np.pi)
    assert len(sampled.directions) == 1 << sampled.height


def test_they_are_as_even_as_stated(full):
    assert full.height == 15
    assert full.unevenness < 0.005
    assert full.cap_discrepancy < 0.001


def test_caps_see_what_random_directions_lack(sampled):
    """Random directions are off by about a standard deviation of a half, over the root of their number."""
    assert sampled.cap_discrepancy < 1 / np.sqrt(len(sampled.directions))


@pytest.mark.parametrize("height", [3, 6, 9])
def test_nodes_are_compact(full, height):
    """The mean distance from a node's middle is at most twice that of a disc of its area (2/3 of its radius)."""
    nodes = full.directions.reshape(-1, 1 << height, 3)
    apart = np.arccos(np.clip(np.einsum("nki,ni->nk", nodes, full.means(height)), -1, 1))
    disc = np.arccos(1 - 2 / len(nodes))
    assert apart.mean() < 2 * disc * 2 / 3


def test_smooth_functions_integrate_to_what_they_are(full):
    """Spherical harmonics of degrees 1, 2 and 4 integrate to 0: quadrature over 4 pi."""
    x, y, z = full.directions.T
    for harmonic in (x, y, z, x * y, 3 * z * z - 1, 35 * z**4 - 30 * z**2 + 3):
        assert abs(full.solid_angle @ harmonic) < 1e-3


def test_they_are_the_same_every_time(sampled):
    again = sample_directions.__wrapped__(sampled.height)
    assert again.digest == sampled.digest
