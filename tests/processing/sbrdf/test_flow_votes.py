"""The vote of flows over lights: a plane moves nothing, a texture that moved is followed, hidden is what none finds."""

import cv2
import numba
import numpy as np
import pytest

from processing.products import Btf
from processing.sbrdf.flow_votes import count_votes, vote_flow
from processing.sbrdf.samples import Samples
from tests.reference import occlusion as plain
from tests.reference.ptm import dome


def samples(values, lights, views):
    """Of values with the cosine inside, (light, view, y, x, 3)."""
    return Samples(Btf((values / lights[:, 2].reshape(-1, 1, 1, 1, 1)).astype(np.float32), lights, views), 1.0)


def texture(rng, lights, size):
    """A smooth random texture (light, y, x, 3) that looks different under each light."""
    noise = rng.normal(size=(lights, *size, 1)).astype(np.float32)
    smooth = [cv2.GaussianBlur(np.tile(one, (3, 3, 1)), None, 1.5)[size[0] : -size[0], size[1] : -size[1]]
              for one in noise]  # fmt: skip
    smooth = np.stack(smooth)
    return 0.5 + 0.1 * np.repeat(smooth[..., None] / smooth.std(), 3, axis=-1)


def test_the_vote_is_that_of_the_plain_twin():
    rng = np.random.default_rng(3)
    flows = rng.normal(0, 1, (9, 4, 6, 2)).astype(np.float32)
    meets = rng.random((9, 4, 6)) < 0.7
    shift, ratio = np.zeros((4, 6, 2), np.float32), np.zeros((4, 6), np.float32)
    count_votes(flows, meets, shift, ratio)
    wanted_shift, wanted_ratio = plain.count_votes(flows, meets)
    assert np.allclose(shift, wanted_shift, atol=1e-6)
    assert np.allclose(ratio, wanted_ratio, atol=1e-6)


def test_a_lambertian_plane_has_no_shift_and_nothing_hidden():
    directions = dome(9)
    plane = np.broadcast_to(0.2 * directions[:, 2].reshape(-1, 1, 1, 1, 1), (9, 9, 12, 12, 3))
    found = vote_flow(samples(plane, directions, directions))
    assert not found.hidden.any()
    assert not found.shift.any()


@pytest.mark.parametrize("factor", [1e-6, 1.0, 1e6])
def test_a_texture_that_moved_is_followed_around_the_tile(factor):
    rng = np.random.default_rng(4)
    lights, views = dome(9), np.array([[0.6, 0, 0.8], [0, 0, 1.0]])
    top = texture(rng, 9, (16, 24))
    found = vote_flow(samples(factor * np.stack([np.roll(top, (1, 2), (1, 2)), top], axis=1), lights, views))
    assert found.hidden.mean() < 0.02
    assert np.allclose(np.median(found.shift[0], axis=(0, 1)), [-2, -1], atol=0.1)
    assert not found.shift[1].any()  # the top view itself, wherever it stands


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (5, 3)])
@pytest.mark.parametrize("what", ["missing", "some missing", "dark", "one light dark"])
def test_poor_pictures_give_finite_votes(size, what):
    rng = np.random.default_rng(6)
    ways = dome(5)[[0, 3, 3, 1]]  # unsorted, and one of them twice
    values = rng.random((4, 4, *size, 3)).astype(np.float32)
    if what == "some missing":
        values[rng.random(values.shape) < 0.2] = np.nan
    else:
        values[: 1 if what == "one light dark" else None] = np.nan if what == "missing" else 0
    found = vote_flow(samples(values, ways, ways))
    assert np.isfinite(found.shift).all()
    assert ((found.hidden_ratio >= 0) & (found.hidden_ratio <= 1)).all()
    assert not found.hidden.any() or what in ("some missing", "one light dark")


def test_a_light_that_shows_nothing_has_no_vote():
    """Of nine lights four are dark or even: the outcome is that of the other five."""
    rng = np.random.default_rng(7)
    lights, views = dome(9), np.array([[0, 0, 1.0], [0.6, 0, 0.8]])
    top = texture(rng, 9, (16, 16))
    values = np.stack([top, np.roll(top, 2, 2)], axis=1)
    values[1:5] = np.array([0, 0, 0.5, 0.5]).reshape(4, 1, 1, 1, 1)
    found = vote_flow(samples(values, lights, views))
    wanted = vote_flow(samples(np.delete(values, slice(1, 5), 0), np.delete(lights, slice(1, 5), 0), views))
    assert np.array_equal(found.hidden_ratio, wanted.hidden_ratio)
    assert np.allclose(found.shift, wanted.shift, atol=1e-6)


def test_threads_change_nothing_and_opencv_keeps_its_own():
    rng = np.random.default_rng(8)
    lights, views = dome(5), dome(4)
    case = samples(rng.random((5, 4, 12, 10, 3)), lights, views)
    before, threads = cv2.getNumThreads(), numba.get_num_threads()
    found = vote_flow(case)
    numba.set_num_threads(1)
    try:
        again = vote_flow(case)
    finally:
        numba.set_num_threads(threads)
    assert cv2.getNumThreads() == before
    assert np.array_equal(found.shift, again.shift)
    assert np.array_equal(found.hidden, again.hidden)
