"""What is white, and factors whose glints are no brighter."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.highlights import white_of
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


def drawn(btf: Btf, rank: int, white: float = np.inf) -> np.ndarray:
    """What grey terms make of it."""
    factors = factor_btf(btf, rank, "grey", white).btf
    return sum(factors.values(k)[:, None] * factors.weights[k][None, :, None, None, :] for k in range(rank))


def left_of(true: Btf, found: np.ndarray) -> float:
    """Root mean square of what is missed, over the BTF's own."""
    return float(np.sqrt(np.mean((found - true.reflectance) ** 2) / np.mean(true.reflectance**2)))


@given(st.integers(0, 99), st.floats(1e-6, 1e6))
@settings(max_examples=20, deadline=None)
def test_white_goes_with_the_scale(seed, scale):
    btf = matt(seed, 0.004)
    scaled = replace(btf, reflectance=btf.reflectance * np.float32(scale))
    assert white_of(scaled) == pytest.approx(white_of(btf) * scale, rel=1e-5)


def test_all_terms_draw_glints_as_white_and_the_rest_as_it_is():
    btf = matt(1, 0.004)
    white = white_of(btf)
    limited = np.minimum(btf.reflectance, white / COSINES)
    assert limited.max() < btf.reflectance.max()
    np.testing.assert_allclose(drawn(btf, 3 * len(DIRECTIONS), white), limited, atol=1e-4 * limited.max())


def test_few_terms_keep_the_colours_that_glints_would_take():
    """Glints in 0.4 % of the samples cost four terms most of what they hold without them, unless they are white."""
    calm, glinting = matt(1), matt(1, 0.004)
    assert left_of(calm, drawn(calm, 4)) < 1e-3
    assert left_of(calm, drawn(glinting, 4, white_of(glinting))) < 0.5 * left_of(calm, drawn(glinting, 4))


def test_missing_samples_tell_nothing_of_white():
    btf = matt(2, 0.004)
    holes = np.random.default_rng(3).uniform(size=btf.reflectance.shape) < 0.3
    holed = replace(btf, reflectance=np.where(holes, np.nan, btf.reflectance))
    assert white_of(holed) == pytest.approx(white_of(btf), rel=0.05)
    assert np.isinf(white_of(replace(btf, reflectance=np.full_like(btf.reflectance, np.nan))))


def test_a_stored_one_has_the_same_white(tmp_path):
    """To the half floats that it is stored in, and a percentile of other samples."""
    btf = matt(4, 0.004)
    btf.save(tmp_path)
    assert white_of(StoredBtf.open(tmp_path)) == pytest.approx(white_of(btf), rel=0.02)
