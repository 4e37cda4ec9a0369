"""What the analysis sees of a BTF: the cosine inside, one scale, what is missing, and the order of samples."""

import numpy as np
import pytest

from processing.products import Btf
from processing.sbrdf.samples import Samples

LIGHTS = np.array([[0, 0, 1.0], [0.6, 0, 0.8], [0, 0.8, 0.6], [0.8, 0, -0.6]])
VIEWS = np.array([[0.6, 0, 0.8], [0, 0, 1.0], [0, -0.96, -0.28]])


@pytest.fixture
def btf():
    values = np.random.default_rng(2).uniform(0.1, 0.5, (4, 3, 3, 2, 3)).astype(np.float32)
    return Btf(values, LIGHTS, VIEWS)


def test_rows_and_views_are_the_same_samples_in_the_order_of_pairs(btf):
    samples = Samples.of(btf)
    light, view = samples.pairs()
    rows = samples.texels(slice(0, 3)).reshape(3, 2, 4, 3, 3)
    for v in range(3):
        np.testing.assert_array_equal(samples.seen_from(v), np.moveaxis(rows[:, :, :, v], 2, 0))
    np.testing.assert_array_equal(light.reshape(4, 3, 3)[:, 1], LIGHTS)
    np.testing.assert_array_equal(view.reshape(4, 3, 3)[2], VIEWS)
    assert samples.top == 1


def test_values_hold_the_cosine_and_are_missing_under_the_horizon(btf):
    btf.reflectance[1, 1, 0, 0, 2] = np.inf
    samples = Samples(btf, 2.0)
    top = samples.seen_from(1)
    wanted = btf.reflectance[2, 1] * np.float32(0.6 / 2.0)
    np.testing.assert_allclose(top[2], wanted, rtol=1e-6)
    assert np.isnan(top[3]).all()
    assert np.isnan(samples.seen_from(2)).all()
    assert np.isnan(top[1, 0, 0, 2])
    assert np.isfinite(top[:3]).sum() == top[:3].size - 1


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_a_btf_without_light_has_the_scale_one(btf, value):
    btf.reflectance[:] = value
    assert Samples.of(btf).scale == 1.0


def test_all_but_a_thousandth_of_the_top_view_lie_under_the_scale(btf):
    samples = Samples.of(btf)
    top = samples.seen_from(samples.top)
    assert (top[np.isfinite(top)] <= 1 + 1e-6).mean() > 0.95  # of 54 values the largest alone is above
