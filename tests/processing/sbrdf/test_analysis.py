"""The analysis of whole BTFs: planes of which all is known, errors that fall, and what a BTF can lack."""

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
