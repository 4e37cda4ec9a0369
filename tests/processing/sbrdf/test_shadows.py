"""Shadow rounds, the shadow map, shadows of least squared error, and the compiled sums against plain twins."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.sbrdf.lafortune import LafortuneFit, fit_lafortune, lafortune_values
from processing.sbrdf.places_kernel import gather_view, nearest_of
from processing.sbrdf.shaded_lobes import Views, fit_shaded
from processing.sbrdf.shadow_kernel import light_sums
from processing.sbrdf.shadows import Darkness, ShadowStatus, darkness, fit_lit, shadow_map
from tests.benchmarks.yardsticks.btf_samples import quick_directions
from tests.reference import shadows as plain

FEW = settings(max_examples=25, deadline=None)
WAYS = quick_directions()
LIGHT, VIEW = np.repeat(WAYS, len(WAYS), axis=0), np.tile(WAYS, (len(WAYS), 1))


def lobes(texels, rng):
    """A diffuse and one broad lobe."""
    status, cost = np.zeros(texels, np.int8), np.zeros(texels, np.float32)
    fields = (
        rng.uniform(0.1, 0.4, (texels, 3)),
        np.tile([-1.0, -1.0, 1.0], (texels, 1, 1)),
        rng.uniform(2, 6, (texels, 1)),
        rng.uniform(0.1, 0.3, (texels, 1, 3)),
    )
    return LafortuneFit(*(np.float32(one) for one in fields), status, cost, np.zeros(texels, np.int32))


def shaded(texels, residue, seed=0):
    """Values of lobes under shadows of 30 % of the samples, which leave `residue` of the light, and the shadows."""
    rng = np.random.default_rng(seed)
    values = lafortune_values(lobes(texels, rng), LIGHT, VIEW)
    shadowed = rng.random(values.shape[:2]) < 0.3
    values = np.where(shadowed[..., None], np.float32(residue) * values, values)
    return values * rng.normal(1, 0.01, values.shape).astype(np.float32), shadowed


@pytest.fixture
def rng():
    return np.random.default_rng(8)


@pytest.mark.parametrize("missing", [0.0, 0.2])
def test_sums_of_lights_are_those_of_the_plain_twin(rng, missing):
    values, drawn = rng.random((2, 5, 4, 7, 3), np.float32)
    weight = rng.choice(np.float32([0, 0.1, 1, 3]), (5, 4, 7))
    values[rng.random(weight.shape) < missing] = np.nan
    weight[np.isnan(values).any(axis=-1)] = 0
    found = np.empty((5, 4, 3))
    light_sums(values, weight, drawn, found)
    np.testing.assert_allclose(found, plain.light_sums(values, weight, drawn), rtol=1e-5)


@pytest.mark.parametrize("missing", [0.0, 0.2])
def test_points_are_gathered_as_by_the_plain_twin(rng, missing):
    seen = rng.random((4, 30, 3), np.float32)
    seen[rng.random(seen.shape) < missing] = np.nan
    place = rng.integers(-1, 9, 30)
    total, count = np.zeros((9, 4, 3), np.float32), np.zeros((9, 4), np.float32)
    gather_view(seen, place, total, count)
    wanted = plain.gather_view(seen, place, 9)
    np.testing.assert_allclose(total, wanted[0], rtol=1e-5)
    np.testing.assert_array_equal(count, wanted[1])


@pytest.mark.parametrize("missing", [0.0, 0.2])
def test_the_nearest_candidate_is_that_of_the_plain_twin(rng, missing):
    seen, drawn = rng.random((40, 12), np.float32), rng.random((25, 12), np.float32)
    seen[rng.random(seen.shape) < missing] = np.nan
    candidates, extra = rng.integers(0, 25, (40, 6)), rng.random((40, 6), np.float32)
    chosen = np.empty(40, np.int64)
    nearest_of(seen, drawn, candidates, extra, chosen)
    np.testing.assert_array_equal(chosen, plain.nearest_of(seen, drawn, candidates, extra))


@pytest.mark.parametrize("residue", [0.0, 0.05, 0.1])
def test_shadows_are_found_whatever_light_is_left_in_them(residue):
    values, true = shaded(24, residue)
    start = fit_lafortune(values, LIGHT, VIEW)
    found = fit_lit(values, LIGHT, VIEW, start, darkness(values, LIGHT, VIEW, start)).shadowed
    assert (found & true).sum() >= 0.97 * max(found.sum(), true.sum())


def test_lobes_are_those_without_shadows():
    values, true = shaded(12, 0.0)
    start = fit_lafortune(values, LIGHT, VIEW)
    found = fit_lit(values, LIGHT, VIEW, start, Darkness(0.1, np.zeros(len(LIGHT), np.float32)))
    wanted = lafortune_values(fit_lafortune(np.where(true[..., None], np.nan, values), LIGHT, VIEW), LIGHT, VIEW)
    drawn = lafortune_values(found.lobes, LIGHT, VIEW)
    lit = ~true
    assert np.sqrt(np.mean((drawn - wanted)[lit] ** 2)) < 0.01 * wanted[lit].mean()  # the noise of one sample
    assert (found.status == ShadowStatus.FOUND).all()


@FEW
@given(st.floats(-6, 6), st.integers(0, 99))
def test_what_counts_as_shadow_does_not_depend_on_scale(power, seed):
    values, _ = shaded(3, 0.05, seed)
    drawn = lafortune_values(lobes(3, np.random.default_rng(seed)), LIGHT, VIEW)
    least = np.full(len(LIGHT), 0.01, np.float32)
    factor = np.float32(2.0 ** round(3 * power))  # exact in float32
    found = Darkness(0.2, least).shadowed(values, drawn)
    np.testing.assert_array_equal(Darkness(0.2, factor * least).shadowed(factor * values, factor * drawn), found)
    np.testing.assert_array_equal(found, plain.in_shadow(values, drawn, np.float32(0.2), least))


def test_the_shadow_map_is_one_outside_shadows_and_the_ratio_inside(rng):
    drawn = rng.uniform(0.2, 1, (4, 9, 3)).astype(np.float32)
    shadowed = rng.random((4, 9)) < 0.5
    values = drawn * np.where(shadowed, np.float32(0.1), np.float32(1.4))[..., None]
    values[0, 0], drawn[1, 1] = np.nan, 0
    shadowed[0, 0] = shadowed[1, 1] = True
    level = shadow_map(values, drawn, shadowed)
    assert level[0, 0] == level[1, 1] == 0  # nothing is known there
    wanted = np.where(shadowed, 0.1, 1)
    wanted[0, 0] = wanted[1, 1] = 0
    np.testing.assert_allclose(level, wanted, rtol=1e-5)


def test_an_all_shadow_texel_keeps_its_lobes_and_is_flagged():
    values, _ = shaded(6, 0.0)
    values[2] = 0
    start = fit_lafortune(values, LIGHT, VIEW)
    dark = darkness(values, LIGHT, VIEW, start)
    found = fit_lit(values, LIGHT, VIEW, start, dark)
    assert found.shadowed[2].all()
    assert found.status[2] == ShadowStatus.KEPT
    assert (np.delete(found.status, 2) == ShadowStatus.FOUND).all()


def test_lobes_and_shadows_in_turns_find_both():
    """A product of lobes and one shadow for each light is found again, up to noise, missing samples aside."""
    rng = np.random.default_rng(3)
    values = lafortune_values(lobes(10, rng), LIGHT, VIEW).reshape(10, len(WAYS), len(WAYS), 3)
    shadow = rng.choice(np.float32([0, 0.3, 1, 1]), (10, len(WAYS)))
    shadow[:, 0] = 1
    seen = values * shadow[..., None, None]
    seen[rng.random(seen.shape[:3]) < 0.1] = np.nan
    weight = np.isfinite(seen.sum(axis=-1)).astype(np.float32)
    start = fit_lafortune(seen.reshape(10, -1, 3), LIGHT, VIEW)
    found = fit_shaded(Views(seen, weight, WAYS, WAYS), start, 6)
    drawn = lafortune_values(found.lobes, LIGHT, VIEW).reshape(values.shape) * found.shadow[..., None, None]
    before = lafortune_values(start, LIGHT, VIEW).reshape(values.shape)
    error, plainly = (np.nanmean((one - seen) ** 2) for one in (drawn, before))
    assert error < 0.05 * plainly
    assert found.shadow.max(axis=1) == pytest.approx(1)
    assert found.shadow.min() >= 0


def test_more_rounds_never_raise_the_error():
    values, _ = shaded(8, 0.0, seed=4)
    views = Views(
        values.reshape(8, len(WAYS), len(WAYS), 3), np.ones((8, len(WAYS), len(WAYS)), np.float32), WAYS, WAYS
    )
    start = fit_lafortune(values, LIGHT, VIEW)
    errors = []
    for rounds in range(3):
        found = fit_shaded(views, start, rounds)
        drawn = lafortune_values(found.lobes, LIGHT, VIEW).reshape(views.values.shape)
        errors.append(np.square(drawn * found.shadow[..., None, None] - views.values).mean(axis=(1, 2, 3)))
    assert (errors[1] <= errors[0] * (1 + 1e-4)).all()
    assert (errors[2] <= errors[1] * (1 + 1e-4)).all()
