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


def textured(seed: int) -> Btf:
    """Three looks of dark texels, and three others of the tenth that is ten times as bright."""
    rng = np.random.default_rng(seed)
    looks = rng.uniform(0.01, 0.1, (6, len(DIRECTIONS)))
    shares = rng.uniform(size=(len(DIRECTIONS), 12, 12, 3, 6))
    bright = rng.uniform(size=(12, 12, 1, 1)) < 0.1
    shares *= np.where(bright, [0, 0, 0, 10, 10, 10], [1, 1, 1, 0, 0, 0])
    return Btf(np.moveaxis(shares @ looks, -1, 1).astype(np.float32), DIRECTIONS, DIRECTIONS)


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


@pytest.mark.parametrize("colour", ["colour", "grey"])
def test_told_white_terms_are_the_best_of_what_is_weighed(colour):
    """Rows over their texel's mean and a fortieth of white, by the decomposition of the whole matrix."""
    btf = textured(5)
    white = white_of(btf)
    shown = np.minimum(btf.reflectance, white / COSINES) * COSINES
    weight = 1 / (shown.mean(axis=(1, 4), keepdims=True) + white / 40)
    columns = (1,) if colour == "colour" else (1, 4)
    matrix = np.moveaxis(shown * weight, columns, range(-len(columns), 0))
    values = np.linalg.svd(matrix.reshape(-1, np.prod([btf.shape[k] for k in columns])), compute_uv=False)
    found = factor_btf(btf, 4, colour, white)
    np.testing.assert_allclose(found.squared_singular_values, values**2, rtol=1e-6, atol=1e-9 * values[0] ** 2)
    kept = sum(found.btf.values(k)[:, None] * found.btf.colours[k][None, :, None, None, :] for k in range(4))
    left = np.square((kept * COSINES - shown) * weight).sum() / np.square(shown * weight).sum()
    assert np.sqrt(left) == pytest.approx(found.relative_rmse(4), rel=1e-4)


def test_what_is_dark_keeps_its_look():
    """By squared errors the few bright texels take most of four terms."""
    btf = textured(6)
    shown = btf.reflectance.mean(axis=(0, 1, 4))
    dark = shown < shown.mean()
    weighed, plain = (drawn(btf, 4, white)[..., dark, :] for white in (white_of(btf), np.inf))
    true = replace(btf, reflectance=btf.reflectance[..., dark, :])
    assert left_of(true, weighed) < 0.85 * left_of(true, plain)


@given(st.integers(0, 99), st.floats(1e-6, 1e6))
@settings(max_examples=10, deadline=None)
def test_terms_of_pictures_go_with_the_scale(seed, scale):
    btf = textured(seed)
    scaled = replace(btf, reflectance=btf.reflectance * np.float32(scale))
    one, other = (factor_btf(each, 3, "colour", white_of(each)) for each in (btf, scaled))
    assert other.relative_rmse(3) == pytest.approx(one.relative_rmse(3), rel=1e-4)
    np.testing.assert_allclose(other.btf.eigenmaps, one.btf.eigenmaps * scale, rtol=2e-3, atol=2e-3 * scale)


def test_a_black_one_has_terms_of_nothing():
    btf = replace(textured(7), reflectance=np.zeros((11, 11, 4, 4, 3), np.float32))
    factors = factor_btf(btf, 2, "colour", white_of(btf))
    assert not factors.btf.eigenmaps.any()
    assert factors.relative_rmse(2) == 0


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
