"""Poisson filling, against patches that are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from processing.environment.poisson import fill
from processing.errors import ImageError

MASKS = arrays(bool, (9, 11), elements=st.booleans()).filter(lambda mask: not mask.all())


def scene(seed, shape=(9, 11, 3)):
    return np.random.default_rng(seed).normal(size=shape)


@settings(deadline=None)
@given(MASKS, st.integers(0, 99), st.floats(-1e6, 1e6))
def test_a_known_patch_comes_back_whatever_is_added_to_the_guide(mask, seed, offset):
    """Any mask, also in the corners: with the truth's own differences the truth returns; outside nothing changes."""
    truth = scene(seed)
    damaged = np.where(mask[..., None], 1e9, truth)
    found = fill(damaged, mask, truth + offset)
    np.testing.assert_allclose(found, truth, atol=1e-9 * max(abs(offset), 1))
    np.testing.assert_array_equal(found[~mask], truth[~mask])


@settings(deadline=None)
@given(MASKS, st.integers(0, 99))
def test_a_membrane_stays_between_its_borders(mask, seed):
    """Maximum principle, and a plane is a membrane where the mask does not touch the picture's edge."""
    truth = scene(seed, (9, 11))
    found = fill(np.where(mask, np.nan, truth), mask)
    assert found.min() >= truth[~mask].min() - 1e-9
    assert found.max() <= truth[~mask].max() + 1e-9
    inner = mask.copy()
    inner[[0, -1]], inner[:, [0, -1]] = False, False
    plane = np.add.outer(2.0 * np.arange(9), -3.0 * np.arange(11))
    np.testing.assert_allclose(fill(np.where(inner, 0.0, plane), inner), plane, atol=1e-9)


def test_float_light_of_any_scale_is_cloned():
    """A patch of another place over a range of 1e5, where pictures of 8 bits would clip: linear in the light."""
    rng = np.random.default_rng(0)
    target, guide = 1e5 * rng.random((30, 40, 3)), 1e5 * rng.random((30, 40, 3))
    mask = np.zeros((30, 40), bool)
    mask[8:20, 10:33] = True
    found = fill(target, mask, guide)
    np.testing.assert_allclose(fill(1e-8 * target, mask, 1e-8 * guide), 1e-8 * found, rtol=1e-9)

    def laplacian(f: np.ndarray) -> np.ndarray:
        return 4 * f[9:19, 11:32] - f[8:18, 11:32] - f[10:20, 11:32] - f[9:19, 10:31] - f[9:19, 12:33]

    np.testing.assert_allclose(laplacian(found), laplacian(guide), atol=1e-5)


def test_no_mask_changes_nothing_and_a_full_one_is_refused():
    truth = scene(1)
    np.testing.assert_array_equal(fill(truth, np.zeros((9, 11), bool)), truth)
    with pytest.raises(ImageError, match="no known pixel"):
        fill(truth, np.ones((9, 11), bool))
    with pytest.raises(ImageError, match="shape"):
        fill(truth, np.zeros((9, 12), bool))
    with pytest.raises(ImageError, match="no numbers"):
        fill(np.full((9, 11, 3), np.nan), np.eye(9, 11, dtype=bool))
