"""Refinement against plain searches; what the light from above tells; planes; what a BTF can lack."""

from dataclasses import dataclass

import numba
import numpy as np
import pytest

from processing.products import Btf
from processing.sbrdf.flow_votes import Occlusion
from processing.sbrdf.heights import visible, vote_heights
from processing.sbrdf.like_points import best_matches
from processing.sbrdf.refinement import distances, overhead, refine
from processing.sbrdf.samples import Samples
from tests.benchmarks.yardsticks.btf_samples import matt_plane, quick_directions, ray_traced
from tests.reference import occlusion as plain

WAYS = quick_directions()


@dataclass
class Drawn:
    """A reconstruction (light, view, y, x, 3) that is given."""

    values: np.ndarray

    def seen_from(self, view):
        return self.values[:, view]


class FromTop:
    """What the top view sees, for every view."""

    def __init__(self, samples):
        self.values = samples.seen_from(samples.top)

    def seen_from(self, view):
        return self.values


def nothing_voted(samples):
    _, views, height, width, _ = samples.shape
    return Occlusion(
        np.zeros((views, height, width, 2), np.float32),
        np.zeros((views, height, width), bool),
        np.zeros((views, height, width), np.float32),
    )


@pytest.fixture(scope="module")
def peanuts():
    return ray_traced("peanut", 16, 3, WAYS, WAYS)


@pytest.fixture(scope="module")
def refined(peanuts):
    samples = Samples.of(peanuts.btf)
    return refine(samples, FromTop(samples), nothing_voted(samples))


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def test_distances_are_those_of_the_plain_twin(rng):
    seen, drawn = rng.random((2, 5, 7, 12), np.float32)
    seen[1, 2, :5], drawn[3, 4, 7:] = np.nan, np.nan
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
    assert (np.abs(shift).max(axis=0) <= [4.5, 3]).all()  # the short way around


def test_a_like_point_lies_within_the_window(rng):
    """On a tile longer than the window the copy at 150 texels is too far, the one at 100 is not."""
    drawn = rng.random((1, 600, 6), np.float32)
    seen = drawn.copy()
    seen[0, 10], seen[0, 300] = drawn[0, 160], drawn[0, 400]
    shift, distance = best_matches(seen, drawn, np.array([[0, 10], [0, 300]]))
    assert distance[0] > 0.01
    assert (distance[1], *shift[1]) == (0, 100, 0)


def test_without_a_light_from_above_a_hidden_point_that_looks_like_a_seen_one_takes_its_place(rng):
    """The paper's rule: of two hidden points one is a copy of a texel elsewhere, the other like nothing seen."""
    ways = np.array([[0, 0, 1.0], [0.6, 0, 0.8], [0, 0.6, 0.8]])
    drawn = Drawn(np.repeat(rng.random((2, 1, 8, 8, 3)), 3, axis=1).astype(np.float32))
    values = drawn.values + 0.002
    values[:, 1, 2, 3] = drawn.values[:, 0, 7, 1]
    values[:, 1, 5, 5] = 4.0
    lights = ways[1:]
    samples = Samples(Btf((values / lights[:, 2].reshape(2, 1, 1, 1, 1)).astype(np.float32), lights, ways), 1.0)
    voted = nothing_voted(samples)
    voted.hidden[1, [2, 5], [3, 5]] = True
    assert overhead(samples) is None
    found = refine(samples, drawn, voted)
    assert np.argwhere(found.hidden).tolist() == [[1, 5, 5]]
    assert found.shift[1, 2, 3].tolist() == [-2, -3]


def test_a_seen_point_does_not_move_to_its_like_across_the_tile(rng):
    """Its shift is interpolated with those of its neighbours, which stand still: all between would be drawn."""
    ways = np.array([[0, 0, 1.0], [0.6, 0, 0.8], [0, 0.6, 0.8]])
    drawn = Drawn(np.repeat(rng.random((3, 1, 12, 12, 3)), 3, axis=1).astype(np.float32))
    values = drawn.values.copy()
    values[:, 1, 2, 3] = drawn.values[:, 0, 7, 9]
    samples = Samples(Btf((values / ways[:, 2].reshape(3, 1, 1, 1, 1)).astype(np.float32), ways, ways), 1.0)
    found = refine(samples, drawn, nothing_voted(samples))
    assert not found.hidden[1, 2, 3]
    assert np.abs(found.shift[1]).max() < 3


def test_the_light_from_above_finds_what_is_hidden(peanuts, refined):
    """Aim of the product on 64 x 64 texels, here on coarser ones: 0.9 and 0.9."""
    true = peanuts.truth.hidden
    both = (true & refined.hidden).sum()
    assert both >= 0.9 * refined.hidden.sum()
    assert both >= 0.85 * true.sum()


def test_shifts_are_those_of_the_truth(peanuts, refined):
    """Half of what is not hidden is found within half a texel."""
    error = np.linalg.norm(refined.shift - peanuts.truth.shift, axis=-1)
    assert np.median(error[~peanuts.truth.hidden & ~refined.hidden]) < 0.5


def test_the_number_of_threads_and_the_order_of_views_change_nothing(peanuts, refined):
    before = numba.get_num_threads()
    order = np.random.default_rng(1).permutation(len(WAYS))
    btf = Btf(peanuts.btf.reflectance[:, order], WAYS, WAYS[order])
    numba.set_num_threads(1)
    try:
        samples = Samples.of(btf)
        again = refine(samples, FromTop(samples), nothing_voted(samples))
    finally:
        numba.set_num_threads(before)
    assert np.array_equal(again.hidden, refined.hidden[order])
    close = np.isclose(again.shift, refined.shift[order], atol=1e-3).all(axis=-1)
    assert close.mean() > 0.99  # sums over the views are in another order


def test_heights_of_a_moved_texture_are_flat():
    """A texture half a texel over the plane of the texels, under any light, is found at that height."""
    top = np.stack([np.sin(np.add.outer(np.arange(24) * a, np.arange(24) * b) * np.pi / 12 + c)
                    for a, b, c in ((1, 2, 0), (3, -1, 1), (2, 2, 2), (-1, 3, 4))])  # fmt: skip
    waves = np.fft.fft2(top)
    u, v = np.meshgrid(np.fft.fftfreq(24), np.fft.fftfreq(24))
    views = np.array([[0, 0, 1.0], [0.6, 0, 0.8], [0, -0.8, 0.6], [-0.8, 0, 0.6]])

    def seen(view):
        right, down = 0.5 * view[0] / view[2], -0.5 * view[1] / view[2]
        return 2 + np.fft.ifft2(waves * np.exp(2j * np.pi * (u * right + v * down))).real

    values = np.repeat(np.stack([seen(view) for view in views], axis=1)[..., None], 3, axis=-1)
    lights = np.repeat(views[:1], 4, axis=0)
    samples = Samples(Btf(values.astype(np.float32), lights, views), 1.0)
    heights = vote_heights(samples, FromTop(samples))
    assert np.median(np.abs(heights - 0.5)) < 0.05


def test_a_view_sees_the_nearest_part_of_a_field():
    """A ridge of height 2 hides what lies behind it: the twin walks the ray in small steps, ours are below 0.1."""
    heights = np.zeros((6, 12), np.float32)
    heights[:, 5] = 2
    view = np.array([0.8, 0, 0.6])
    found = visible(heights, view)
    wanted = plain.first_meeting(heights, view)
    assert np.allclose(found, wanted, atol=0.1)


def test_a_lambertian_plane_has_no_shift_and_nothing_hidden():
    samples = Samples.of(matt_plane(6, WAYS, WAYS).btf)
    found = refine(samples, FromTop(samples), nothing_voted(samples))
    assert not found.hidden.any()
    assert not found.shift.any()


@pytest.mark.parametrize("size", [(1, 1), (1, 5), (3, 2)])
@pytest.mark.parametrize("what", ["noise", "missing", "some missing", "dark"])
def test_poor_pictures_give_finite_shifts(rng, size, what):
    values = rng.random((4, 4, *size, 3)).astype(np.float32)
    if what == "some missing":
        values[rng.random(values.shape) < 0.3] = np.nan
    elif what != "noise":
        values[:] = np.nan if what == "missing" else 0
    ways = np.array([[0, 0, 1.0], [0, 0, 1.0], [0.6, 0, 0.8], [0.999, 0, 0.04]])
    samples = Samples.of(Btf(values, ways, ways))
    found = refine(samples, FromTop(samples), nothing_voted(samples))
    assert np.isfinite(found.shift).all()
    assert what == "noise" or not found.hidden[:3].any() or what == "some missing"


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_scale_changes_nothing(peanuts, refined, factor):
    btf = Btf((peanuts.btf.reflectance * factor).astype(np.float32), WAYS, WAYS)
    samples = Samples.of(btf)
    again = refine(samples, FromTop(samples), nothing_voted(samples))
    assert (again.hidden == refined.hidden).mean() > 0.999
    assert np.isclose(again.shift, refined.shift, atol=1e-2).all(axis=-1).mean() > 0.98
