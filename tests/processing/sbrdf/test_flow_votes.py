"""The vote of flows over lights: a plane moves nothing, a texture that moved is followed, hidden is what none finds."""

import cv2
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
