"""Lobes between the measured directions."""

from dataclasses import replace

import numpy as np
import pytest

from processing.products import Btf
from processing.sbrdf.drawn import DrawnPlus
from processing.sbrdf.supported import MOST, supported
from tests.render import synthetic

SHAPE = (5, 4)


@pytest.fixture(scope="module")
def product():
    return synthetic.weave(SHAPE, largest_exponent=8.0)


@pytest.fixture(scope="module")
def btf(product):
    """Nothing but 0.2 everywhere, one texel of it missing."""
    lights, views = product.lights.directions, product.views.directions
    values = np.full((len(lights), len(views), *SHAPE, 3), 0.2, np.float32)
    values[:, :, 2, 1] = np.nan
    return Btf(values, lights, views)


def largest(lobes, seed=1):
    """Largest value (y, x) over many random directions, the lowest 75 deg from the normal."""
    rng = np.random.default_rng(seed)
    z, turn = rng.uniform(np.cos(np.radians(75)), 1, (2, 4000)), rng.uniform(0, 2 * np.pi, (2, 4000))
    aside = np.sqrt(1 - z * z)
    light, view = np.moveaxis(np.stack([aside * np.cos(turn), aside * np.sin(turn), z]), 0, -1)
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return lobes.evaluate(rows[..., None], columns[..., None], light, view).max(axis=(-1, -2))


def test_lobes_that_nothing_bears_out_are_lowered(product, btf):
    wild = replace(product.lobes, albedo=1e4 * product.lobes.albedo)
    assert (largest(wild) > 100).all()
    tamed = supported(replace(product, lobes=wild), btf).lobes
    measured = np.isfinite(btf.reflectance[0, 0, ..., 0])
    # Of each lobe the limit, between whose rings the peak of one of exponent 8 may rise by a third.
    assert (largest(tamed)[measured] <= 3 * MOST * 0.2 * 4 / 3 + tamed.diffuse.max()).all()
    assert (tamed.albedo[~measured] == 0).all()
    np.testing.assert_allclose(tamed.albedo / tamed.albedo.max(-1, keepdims=True).clip(1e-9),
                               wild.albedo / wild.albedo.max(-1, keepdims=True).clip(1e-9) * (tamed.albedo > 0),
                               rtol=1e-5)  # fmt: skip


def test_lobes_as_bright_as_the_samples_stay(product, btf):
    dim = replace(product.lobes, albedo=np.minimum(product.lobes.albedo, 0.2))
    kept = supported(replace(product, lobes=dim), replace(btf, reflectance=np.full_like(btf.reflectance, 0.2)))
    np.testing.assert_array_equal(kept.lobes.albedo, dim.albedo)
    np.testing.assert_array_equal(DrawnPlus(kept).seen_from(1), DrawnPlus(replace(product, lobes=dim)).seen_from(1))


def test_the_unit_of_reflectance_does_not_matter(product, btf):
    wild = replace(product.lobes, albedo=64 * product.lobes.albedo)
    one = supported(replace(product, lobes=wild), btf).lobes.albedo
    brighter = replace(wild, albedo=8 * wild.albedo)
    other = supported(replace(product, lobes=brighter), replace(btf, reflectance=8 * btf.reflectance)).lobes.albedo
    np.testing.assert_allclose(other, 8 * one, rtol=1e-6)
