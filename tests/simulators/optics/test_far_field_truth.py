"""Truth of far-field BTFs: shadows, hidden points and shifts, against the values and against rays from the top."""

import numpy as np
import pytest

from simulators import far_field
from simulators.far_field import btf_below, one_period
from simulators.far_field_truth import depths, traced, truth
from simulators.layout import direction
from simulators.samples.relief import ReliefSample, flat_relief

WAYS = np.array([direction(*np.radians(pair)) for pair in ((0, 90), (20, 55), (140, 40), (260, 25))])
PERIOD_M, DEPTH_M, TEXELS = 0.06, 1e-3, 24


@pytest.fixture(scope="module", params=["brick", "pipe"])
def name(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def found(name):
    return traced(name, 3, (WAYS, WAYS), TEXELS, DEPTH_M)


def test_values_are_those_of_the_btf_and_zero_exactly_in_shadow(name, found):
    values, known = found
    np.testing.assert_array_equal(values, btf_below(name, 3, (WAYS, WAYS), TEXELS, 1, DEPTH_M))
    np.testing.assert_array_equal(values.max(axis=-1) == 0, known.shadowed)
    assert 0.01 < known.shadowed.mean() < 0.9


def test_a_ray_straight_down_at_the_shifted_place_meets_the_same_point(name, found):
    """To the micrometre which float32 leaves of the shift, times the slope of a steep side."""
    _, known = found
    sample, period_m = one_period(name, 3, (WAYS, WAYS))
    view, row, column = np.nonzero(~known.hidden)
    shift, points = known.shift[view, row, column], known.points_m[view, row, column]
    x = ((column + 0.5 + shift[:, 0]) / TEXELS - 0.5) * period_m
    y = (0.5 - (row + 0.5 + shift[:, 1]) / TEXELS) * period_m
    starts = np.stack([x, y, np.zeros_like(x)], axis=-1)
    starts[:, :2] -= period_m * np.round(starts[:, :2] / period_m)
    hits = sample.trace(starts, np.broadcast_to([0.0, 0.0, -period_m], starts.shape))
    away_m = np.linalg.norm(hits.points - points[hits.ray], axis=1)
    assert len(hits.ray) == len(starts)
    assert np.quantile(away_m, 0.995) < 2 * sample.offset_m
    assert np.isnan(known.shift[known.hidden]).all()


def test_depths_are_those_of_the_points_and_of_the_plane_that_a_steady_texel_lies_in(name, found):
    """From the top a texel of any plane shows the same point."""
    _, known = found
    np.testing.assert_array_equal(depths(name, 3, WAYS, TEXELS, DEPTH_M), -known.points_m[..., 2])
    higher, lower = (depths(name, 3, WAYS[:1], TEXELS, depth_m) for depth_m in (0.0, 2 * DEPTH_M))
    np.testing.assert_allclose(higher, lower, atol=1e-6)


def test_what_is_hidden_is_what_light_from_straight_above_does_not_reach(name, found):
    """Another question to another tracer: shadow rays start off the surface, so that edges may differ."""
    _, known = found
    dark = known.shadowed[0]
    assert (dark == known.hidden).mean() > 0.98
    assert not known.hidden[0].any()
    assert known.hidden.any() == (name == "pipe"), "a height field hides nothing from the top"


def test_height_over_the_plane_of_the_texels_shifts_toward_the_view(name, found):
    """By the tangent of the polar angle; the plane itself stays."""
    _, known = found
    _, period_m = one_period(name, 3, (WAYS, WAYS))
    height_m = known.points_m[..., 2] + DEPTH_M
    slope = WAYS[:, :2] / WAYS[:, 2:] * [1, -1] * TEXELS / period_m
    expected = height_m[..., None] * slope[:, None, None]
    seen = ~known.hidden
    np.testing.assert_allclose(known.shift[seen], expected[seen], atol=1e-3)


def test_a_flat_plane_has_neither_shadow_nor_hidden_points(monkeypatch):
    plate = ReliefSample(flat_relief(PERIOD_M * 2, -DEPTH_M, 0.5))
    monkeypatch.setitem(far_field.SAMPLES, "plate", lambda seed: (plate, PERIOD_M))
    known = truth("plate", 1, (WAYS, WAYS), 6, DEPTH_M)
    assert not known.shadowed.any()
    assert not known.hidden.any()
    np.testing.assert_allclose(known.shift, 0.0, atol=1e-4)


def test_the_same_arguments_give_the_same_bits_and_others_are_refused():
    first, again = (truth("brick", 3, (WAYS[:1], WAYS[:2]), 6, DEPTH_M) for _ in range(2))
    for name in ("points_m", "shadowed", "hidden", "shift"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    with pytest.raises(ValueError, match="'sphere' is not periodic"):
        truth("sphere", 1, (WAYS, WAYS), 4, DEPTH_M)
