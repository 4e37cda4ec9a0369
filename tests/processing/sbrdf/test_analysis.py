"""The analysis of whole BTFs: planes of which all is known, errors that fall, and what a BTF can lack."""

from dataclasses import replace

import numpy as np
import pytest

from processing.errors import ImageError
from processing.products import Btf
from processing.sbrdf.analysis import analyse
from processing.sbrdf.drawn import DrawnLobes, DrawnPlus, view_errors
from tests.benchmarks.yardsticks.btf_samples import matt_plane, quick_directions, ray_traced

WAYS = quick_directions()


@pytest.fixture(scope="module")
def brick():
    sample = ray_traced("brick", 12, 2, WAYS, WAYS)
    return sample, analyse(sample.btf)


def errors(analysis, true):
    """Squared error of SBRDF, STVS and the packed SBRDF+."""
    ways = true.light_directions, true.view_directions
    drawn = (
        DrawnLobes(analysis.sbrdf, *ways),
        DrawnLobes(analysis.stvs.lobes, *ways, analysis.stvs.shadow),
        DrawnPlus(analysis.product.quantised()),
    )
    return [view_errors(true, one.seen_from).relative() for one in drawn]


def test_a_lambertian_plane_has_no_shadow_no_hidden_point_and_no_shift():
    sample = matt_plane(8, WAYS, WAYS)
    found = analyse(sample.btf)
    assert not found.shadowed().any()
    assert not found.product.hidden.any()
    assert not found.product.shift.any()
    assert found.product.shadow.min() > 1 - 1e-4
    assert found.top_shadow.min() == 1
    assert max(errors(found, sample.true)) < 1e-6


def test_each_step_lowers_the_error(brick):
    sample, found = brick
    sbrdf, stvs, final = errors(found, sample.true)
    assert sbrdf > stvs > final


def test_shadows_are_those_of_the_height_field(brick):
    sample, found = brick
    shadowed = found.shadowed()
    true = sample.truth.shadowed
    assert (shadowed & true).sum() >= 0.9 * shadowed.sum()
    assert (shadowed & true).sum() >= 0.9 * true.sum()


@pytest.mark.parametrize(("lights", "views", "channels"), [(2, 5, 3), (5, 2, 3), (5, 5, 1)])
def test_too_few_directions_or_channels_are_an_error(lights, views, channels):
    btf = Btf(np.ones((lights, views, 2, 2, channels), np.float32), WAYS[:lights], WAYS[:views])
    with pytest.raises(ImageError):
        analyse(btf)


def told(analysis):
    """What the analysis tells is finite, and the packed product too."""
    product = analysis.product.quantised()
    lobes = product.lobes
    fields = (lobes.diffuse, lobes.axis, lobes.exponent, lobes.albedo, product.shadow, product.shift, product.centres)
    return all(np.isfinite(field).all() for field in fields) and (product.shadow >= 0).all()


def few_samples(values):
    values[:, :, 1, 1] = np.nan
    values[3:6, 2, 1, 1] = 0.1


def all_shadow(values):
    values[:, :, 2, 0] = 0


def zero_light(values):
    values[4] = 0


def missing(values):
    values[np.random.default_rng(1).random(values.shape[:4]) < 0.2] = np.nan


def nothing(values):
    values[:] = np.nan


def black(values):
    values[:] = 0


def infinite(values):
    values[2, 3, 0, 1] = np.inf


@pytest.mark.parametrize("spoil", [few_samples, all_shadow, zero_light, missing, nothing, black, infinite])
def test_what_a_btf_lacks_is_told_by_statuses(brick, spoil):
    sample, _ = brick
    values = sample.btf.reflectance[:, :, 2:6, :3].copy()
    spoil(values)
    assert told(analyse(Btf(values, WAYS, WAYS)))


@pytest.mark.parametrize("shape", [(1, 1), (1, 3), (5, 2)])
def test_tiles_of_any_shape(brick, shape):
    sample, _ = brick
    found = analyse(Btf(sample.btf.reflectance[:, :, : shape[0], : shape[1]].copy(), WAYS, WAYS))
    assert told(found)
    assert found.shadowed().shape == (len(WAYS), len(WAYS), *shape)


@pytest.mark.parametrize("scale", [2.0**-20, 2.0**20])
def test_scale_changes_lobes_alone(brick, scale):
    """Powers of two are exact in float32: lobes are as much brighter, all else is the same but for rounding."""
    sample, found = brick
    scaled = analyse(replace(sample.btf, reflectance=sample.btf.reflectance * np.float32(scale)))
    assert (scaled.shadowed() == found.shadowed()).mean() > 0.999
    assert scaled.scale == pytest.approx(scale * found.scale)
    true = replace(sample.true, reflectance=sample.true.reflectance * np.float32(scale))
    np.testing.assert_allclose(errors(scaled, true), errors(found, sample.true), rtol=1e-2)


def test_directions_in_another_order_and_twice(brick):
    """Views and lights permuted and one of each repeated: shadows follow, errors stay about the same."""
    sample, found = brick
    rng = np.random.default_rng(6)
    lights, views = (rng.permutation([*range(len(WAYS)), 7]) for _ in range(2))
    pick = np.ix_(lights, views)
    btf, true = (Btf(one.reflectance[pick], WAYS[lights], WAYS[views]) for one in (sample.btf, sample.true))
    other = analyse(btf)
    assert (other.shadowed() == found.shadowed()[pick]).mean() > 0.99
    np.testing.assert_allclose(errors(other, true), errors(found, sample.true), rtol=0.25)
