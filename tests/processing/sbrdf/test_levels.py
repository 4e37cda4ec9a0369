"""A BTF at half its texels: means by area, missing samples, what levels are analysed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.products import Btf, StoredBtf
from processing.sbrdf.levels import coarser_levels, halved
from tests.reference.sbrdf_plus import directions, product

FEW = settings(max_examples=40, deadline=None)


def btf(height, width, seed=0, missing=0.0):
    rng = np.random.default_rng(seed)
    reflectance = rng.uniform(0, 0.3, (4, 3, height, width, 3)).astype(np.float32)
    reflectance[rng.uniform(size=reflectance.shape) < missing] = np.nan
    return Btf(reflectance, directions(4, rng), directions(3, rng))


def refined_mean(reflectance):
    """Each texel split into as many as the coarser tile has along each side, then the plain mean of whole blocks."""
    height, width = reflectance.shape[2:4]
    rows, columns = max(height // 2, 1), max(width // 2, 1)
    fine = np.repeat(np.repeat(reflectance.astype(np.float64), rows, axis=2), columns, axis=3)
    blocks = fine.reshape(*fine.shape[:2], rows, height, columns, width, 3)
    measured = np.isfinite(blocks)
    count = measured.sum(axis=(3, 5))
    total = np.where(measured, blocks, 0).sum(axis=(3, 5))
    return np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)


@FEW
@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 99), st.sampled_from([0.0, 0.3, 1.0]))
def test_texels_are_means_by_area(height, width, seed, missing):
    fine = btf(height, width, seed, missing)
    coarse = halved(fine)
    np.testing.assert_allclose(coarse.reflectance, refined_mean(fine.reflectance), rtol=1e-5, atol=1e-7)
    assert coarse.reflectance.dtype == np.float32


@pytest.mark.parametrize("side", [8, 37])
def test_the_mean_of_all_is_kept(side):
    fine = btf(side, side)
    np.testing.assert_allclose(halved(fine).reflectance.mean(), fine.reflectance.mean(), rtol=1e-5)


def test_a_stored_btf_gives_the_same(tmp_path):
    fine = btf(33, 20)
    fine.save(tmp_path)
    stored = StoredBtf.open(tmp_path)
    np.testing.assert_array_equal(halved(stored).reflectance, halved(Btf.load(tmp_path)).reflectance)


@pytest.mark.parametrize(
    ("size", "expected"),
    [((1, 1), []), ((5, 12), [(2, 6), (1, 3), (1, 1)]), ((8, 8), [(4, 4), (2, 2), (1, 1)])],
)
def test_levels_go_down_to_one_texel(size, expected):
    seen = []

    def analyse(level):
        seen.append(level.shape[2:4])
        return product(height=level.shape[2], width=level.shape[3], centres=0)

    levels = coarser_levels(btf(*size), analyse)
    assert seen == [level.lobes.shape for level in levels] == expected
