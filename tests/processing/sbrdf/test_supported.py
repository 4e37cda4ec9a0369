"""Lobes between the measured directions."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from processing.sbrdf.lafortune import FitStatus, LafortuneFit, lafortune_values
from processing.sbrdf.shaded_lobes import Views, fit_shaded
from processing.sbrdf.supported import MOST, Support, supported
from tests.benchmarks.yardsticks.btf_samples import quick_directions

TEXELS = 6
WAYS = quick_directions()
PAIRS = np.repeat(WAYS, len(WAYS), axis=0), np.tile(WAYS, (len(WAYS), 1))


def lobes(seed=1):
    """Three lobes per texel, in any direction, none narrower than exponent 8."""
    rng = np.random.default_rng(seed)
    axis = rng.uniform(-1, 1, (TEXELS, 3, 3))
    axis[..., 2] = abs(axis[..., 2])
    axis /= abs(axis).max(axis=2, keepdims=True)
    fields = (rng.uniform(0, 0.1, (TEXELS, 3)), axis, rng.uniform(1, 8, (TEXELS, 3)), rng.uniform(0, 0.1, axis.shape))
    zero = np.zeros(TEXELS)
    return LafortuneFit(
        *(one.astype(np.float32) for one in fields), zero.astype(np.int8), zero.astype(np.float32), zero
    )


@pytest.fixture(scope="module")
def values():
    """Nothing but a reflectance of 0.2 with a little noise, one texel of it missing."""
    rng = np.random.default_rng(2)
    cosine = PAIRS[0][:, 2].astype(np.float32)
    found = rng.uniform(0.19, 0.2, (TEXELS, len(cosine), 3)).astype(np.float32) * cosine[:, None]
    found[2] = np.nan
    return found


def largest(fit, seed=1):
    """Largest reflectance of each lobe (t, lobe) over many random directions, the lowest 60 deg from the normal."""
    rng = np.random.default_rng(seed)
    z, turn = rng.uniform(0.5, 1, (2, 4000)), rng.uniform(0, 2 * np.pi, (2, 4000))
    aside = np.sqrt(1 - z * z)
    light, view = np.moveaxis(np.stack([aside * np.cos(turn), aside * np.sin(turn), z]), 0, -1)
    base = np.maximum(fit.axis @ (light * view).T, 0)
    return (base ** fit.exponent[..., None]).max(axis=2) * fit.albedo.max(axis=2)


def test_lobes_that_nothing_bears_out_are_lowered(values):
    fit = lobes()
    wild = replace(fit, albedo=1e4 * fit.albedo)
    assert (largest(wild) > 10).any(axis=1).all()
    tamed = supported(wild, values, PAIRS, Support.of(values, *PAIRS))
    # Between the rings the peak of a lobe of exponent 8 may rise by a third.
    assert (largest(tamed) <= MOST * 0.2 * 4 / 3).all()
    assert (tamed.albedo[2] == 0).all()


def test_what_is_lowered_is_the_nearest_to_the_samples_under_the_limit(values):
    """As scipy's bounded least squares, texel by texel and channel by channel."""
    fit, weight = lobes(3), np.random.default_rng(4).uniform(0.1, 1, values.shape[:2]).astype(np.float32)
    wild = replace(fit, albedo=1e4 * fit.albedo)
    support = Support.of(values, *PAIRS)
    tamed, limits = supported(wild, values, PAIRS, support, weight), support.limits(wild)
    for t in (0, 1, 3):
        base = np.maximum(fit.axis[t] @ (PAIRS[0] * PAIRS[1]).T, 0) ** fit.exponent[t][:, None]
        columns = np.column_stack([np.ones(len(weight[t])), base.T]) * PAIRS[0][:, 2:] * np.sqrt(weight[t])[:, None]
        most, error = np.maximum([np.inf, *limits[t]], 1e-12), 0.0
        for channel in range(3):
            wanted = values[t, :, channel] * np.sqrt(weight[t])
            error += 2 * lsq_linear(columns, wanted, (0, most)).cost
        off = (lafortune_values(tamed.chosen(slice(t, t + 1)), *PAIRS)[0] - values[t]) * np.sqrt(weight[t])[:, None]
        assert np.square(off).sum() == pytest.approx(error, rel=1e-3)
        assert tamed.cost[t] == pytest.approx(np.square(off).mean(), rel=1e-3)


def test_lobes_as_bright_as_the_samples_stay(values):
    fit, support = lobes(), Support.of(values, *PAIRS)
    dim = replace(fit, albedo=np.minimum(fit.albedo, 0.01).astype(np.float32))
    dim.albedo[2] = 0
    assert (dim.albedo.max(axis=2) <= support.limits(dim)).all()
    kept = supported(dim, values, PAIRS, support)
    np.testing.assert_array_equal(kept.albedo, dim.albedo)
    np.testing.assert_array_equal(kept.diffuse, dim.diffuse)


def test_the_unit_of_values_does_not_matter(values):
    fit = lobes()
    wild = replace(fit, albedo=64 * fit.albedo)
    one = supported(wild, values, PAIRS, Support.of(values, *PAIRS)).albedo
    brighter = replace(wild, albedo=8 * wild.albedo, diffuse=8 * wild.diffuse)
    other = supported(brighter, 8 * values, PAIRS, Support.of(8 * values, *PAIRS)).albedo
    np.testing.assert_allclose(other, 8 * one, rtol=1e-5, atol=1e-6)


def test_lobes_with_shadows_are_held_from_any_start(values):
    fit = replace(lobes(), albedo=1e4 * lobes().albedo, status=np.full(TEXELS, FitStatus.CONVERGED, np.int8))
    shaped = values.reshape(TEXELS, len(WAYS), len(WAYS), 3)
    seen = Views(np.nan_to_num(shaped), np.isfinite(shaped[..., 0]).astype(np.float32), WAYS, WAYS)
    found = fit_shaded(seen, fit, 1)
    assert (found.lobes.albedo.max(axis=2) <= 1.001 * Support.of(values, *PAIRS).limits(found.lobes)).all()
