"""Highlights that are no brighter than white."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.highlights import whitened
from processing.products import Btf, StoredBtf
from processing.svd import factor_btf
from tests.benchmarks.yardsticks.material_samples import rings

DIRECTIONS = rings(((0, 1), (40, 5), (70, 5)))
COSINES = DIRECTIONS[:, 2].reshape(-1, 1, 1, 1, 1)


def matt(seed: int, glints: float = 0.0) -> Btf:
    """Texels of two colours; a few samples in a thousand are a hundred times as bright."""
    rng = np.random.default_rng(seed)
    colours = np.where(rng.uniform(size=(12, 12, 1)) < 0.5, [0.2, 0.1, 0.05], [0.3, 0.3, 0.3])
    values = np.broadcast_to(colours, (len(DIRECTIONS), len(DIRECTIONS), 12, 12, 3)).astype(np.float32)
    glint = rng.uniform(size=values.shape[:4]) < glints
    return Btf(np.where(glint[..., None], 30.0, values).astype(np.float32), DIRECTIONS, DIRECTIONS)


def left_of_body_colour(terms: Btf | object, true: Btf) -> float:
    """Root mean square of what four grey terms miss of a BTF without glints, over the BTF's own."""
    factors = factor_btf(terms, 4, "grey").btf
    drawn = sum(factors.values(k)[:, None] * factors.weights[k][None, :, None, None, :] for k in range(4))
    return float(np.sqrt(np.mean((drawn - true.reflectance) ** 2) / np.mean(true.reflectance**2)))


@given(st.integers(0, 99), st.floats(1e-6, 1e6))
@settings(max_examples=20, deadline=None)
def test_nothing_is_brighter_than_white_and_what_is_not_stays(seed, scale):
    """White goes with the scale."""
    btf = matt(seed, 0.004)
    scaled = replace(btf, reflectance=(btf.reflectance * np.float32(scale)))
    limited = whitened(scaled)
    assert limited.white == pytest.approx(whitened(btf).white * scale, rel=1e-5)
    (_, _, block), *_ = limited.blocks()
    shown = block * COSINES
    assert shown.max() <= limited.white * (1 + 1e-6)
    low = scaled.reflectance * COSINES < limited.white * (1 - 1e-6)
    np.testing.assert_array_equal(block[low], scaled.reflectance[low])


def test_few_terms_keep_the_colours_that_glints_would_take():
    """Glints in 0.4 % of the samples cost four terms most of what they hold without them, unless they are white."""
    calm, glinting = matt(1), matt(1, 0.004)
    assert left_of_body_colour(calm, calm) < 1e-3
    assert left_of_body_colour(whitened(glinting), calm) < 0.5 * left_of_body_colour(glinting, calm)


def test_missing_samples_stay_missing_and_tell_nothing_of_white():
    btf = matt(2, 0.004)
    holes = np.random.default_rng(3).uniform(size=btf.reflectance.shape) < 0.3
    limited = whitened(replace(btf, reflectance=np.where(holes, np.nan, btf.reflectance)))
    assert limited.white == pytest.approx(whitened(btf).white, rel=0.05)
    np.testing.assert_array_equal(np.isnan(limited.rows(slice(0, 12))), holes)
    empty = replace(btf, reflectance=np.full_like(btf.reflectance, np.nan))
    assert np.isnan(whitened(empty).rows(slice(0, 2))).all()


def test_a_stored_one_is_the_same_block_by_block(tmp_path):
    """To the half floats that it is stored in, and a percentile of other samples."""
    btf = matt(4, 0.004)
    btf.save(tmp_path)
    stored = whitened(StoredBtf.open(tmp_path))
    assert stored.white == pytest.approx(whitened(btf).white, rel=0.02)
    gathered = np.full(btf.shape, np.nan, np.float32)
    for lights, rows, block in stored.blocks():
        gathered[lights, :, rows] = block
    np.testing.assert_allclose(gathered, np.minimum(btf.reflectance, stored.white / COSINES), rtol=2e-3)
