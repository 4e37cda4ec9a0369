"""Refinement of hidden points against a plain search."""

from dataclasses import dataclass

import numpy as np
import pytest

from processing.products import Btf
from processing.sbrdf.flow_votes import Occlusion
from processing.sbrdf.like_points import best_matches
from processing.sbrdf.refinement import distances, refine
from processing.sbrdf.samples import Samples
from tests.reference import occlusion as plain


@dataclass
class Drawn:
    """A reconstruction that is given."""

    values: np.ndarray

    def seen_from(self, view):
        return self.values[:, view]


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def test_distances_are_those_of_the_plain_twin(rng):
    seen, drawn = rng.random((2, 5, 7, 12), np.float32)
    shift = rng.uniform(-9, 9, (5, 7, 2)).astype(np.float32)
    wanted = plain.apart(seen, plain.moved(drawn, shift))
    assert np.allclose(distances(seen, drawn, shift), wanted, atol=1e-5)


@pytest.mark.parametrize("missing", [0.0, 0.2])
def test_best_matches_are_those_of_a_plain_search(rng, missing):
    """Points that a little noise sets apart from their like find it, with values missing on either side too."""
    drawn = rng.random((6, 9, 30), np.float32)
    order = rng.permutation(54)
    seen = (drawn.reshape(54, 30)[order].reshape(6, 9, 30) + rng.normal(0, 0.01, (6, 9, 30))).astype(np.float32)
    for values in (seen, drawn):
        values[rng.random(values.shape) < missing] = np.nan
    places = np.argwhere(np.ones((6, 9), bool))
    shift, distance = best_matches(seen, drawn, places)
    for (row, column), (right, down), found in zip(places, shift, distance, strict=True):
        there = plain.best_match(seen[row, column], drawn)
        assert ((row + down) % 6, (column + right) % 9) == there[:2]
        assert found == pytest.approx(there[2], abs=1e-5)
    assert np.abs(shift).max(axis=0) == pytest.approx([4.5, 3], abs=0.5)  # the short way around


def test_a_hidden_point_that_looks_like_a_seen_one_takes_its_place(rng):
    """One of two hidden points is a copy of a texel elsewhere, the other like nothing seen from the top."""
    lights = views = np.array([[0, 0, 1.0], [0.6, 0, 0.8]])
    values = np.repeat(rng.random((2, 1, 8, 8, 3)), 2, axis=1)
    drawn = Drawn(values.astype(np.float32) + 0.001)
    values = values.copy()
    values[:, 1, 2, 3] = drawn.values[:, 0, 7, 1]
    values[:, 1, 5, 5] = 4.0
    samples = Samples(Btf((values / lights[:, 2].reshape(2, 1, 1, 1, 1)).astype(np.float32), lights, views), 1.0)
    hidden = np.zeros((2, 8, 8), bool)
    hidden[1, 2, 3] = hidden[1, 5, 5] = True
    refined = refine(samples, drawn, Occlusion(np.zeros((2, 8, 8, 2), np.float32), hidden, hidden.astype(np.float32)))
    assert np.argwhere(refined.hidden).tolist() == [[1, 5, 5]]
    assert refined.shift[1, 2, 3].tolist() == [-2, -3]
