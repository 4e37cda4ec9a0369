"""The planes of a sweep: from points on two heights to a laser's place, with a covariance that is true."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing import geometry
from processing.laser.even_spline import abscissae, basis, even_knots, locate, spline_on, value_and_slope
from processing.laser.fan import fan_angle, fan_distance, fan_gradient, fan_source
from processing.laser.holder import opening, reference_region, wanted_pixels
from processing.laser.laser_plane import SweepStatus, fit_sweep
from tests.reference import laser_range as twin
from tests.reference.stripe_rig import HOLDER, Rig, camera_at, flat

RIG = Rig(camera_at(60), flat(0.002))
TRUE = np.array([np.radians(RIG.elevation_deg), RIG.distance_m, np.radians(RIG.azimuth_deg), 0.0])


def reference(rig):
    """Points of the white frame and the moments at which the true plane holds them."""
    region = reference_region(rig.camera, rig.rig_from_sample, HOLDER, rig.source)
    points = region.points_m[region.height > 0]
    moments = np.linspace(0, rig.frames - 1, 20001)
    fans = rig.fan(moments)
    order = np.argsort(fans)
    times = np.interp(fan_angle(TRUE, points), fans[order], moments[order], left=np.nan, right=np.nan)
    return points[np.isfinite(times)], times[np.isfinite(times)]


def test_reference_points_are_where_the_rays_hit():
    """Every pixel of the region sees the holder at the point that it claims."""
    for rig in (RIG, replace(RIG, turntable_deg=30.0, camera=camera_at(25)), replace(RIG, camera=camera_at(88))):
        region = reference_region(rig.camera, rig.rig_from_sample, HOLDER, rig.source)
        hits, _ = rig.hits()
        chosen = region.height > 0
        assert (region.height == 1).sum() > 200
        assert (region.height == 2).sum() > 200
        np.testing.assert_allclose(region.points_m[chosen], hits[chosen], atol=1e-8)
        assert rig.lit(hits)[chosen].all()
        assert not (chosen & opening(rig.camera, rig.rig_from_sample, HOLDER)).any()


VIEWS = (
    RIG,
    replace(RIG, turntable_deg=30.0, camera=camera_at(25)),
    replace(RIG, turntable_deg=77.0, camera=camera_at(15), azimuth_deg=170.0),
    replace(RIG, camera=camera_at(88), azimuth_deg=-100.0),
)


@pytest.mark.parametrize("rig", VIEWS, ids=["high", "turned", "low", "above"])
def test_every_pixel_sees_the_part_that_the_twin_sees(rig):
    """But for the few whose way passes an edge between two of the twin's steps."""
    view = (rig.camera, rig.rig_from_sample, HOLDER, rig.source)
    expected = twin.holder_parts(*view)
    height, sample = reference_region(*view).height, opening(*view[:3])
    np.testing.assert_array_equal(sample, expected == twin.OPENING)
    assert np.mean(np.where(sample, twin.OPENING, height) != expected) < 2e-4
    np.testing.assert_array_equal(wanted_pixels(*view), (height > 0) | sample)


def test_a_camera_of_one_row_knows_no_footprint():
    """So no pixel is safe from an edge; those that look into the opening do not need it."""
    row = replace(RIG.camera, size=(1, 160))
    assert not reference_region(row, RIG.rig_from_sample, HOLDER, RIG.source).height.any()


@settings(max_examples=40, deadline=None)
@given(
    st.tuples(st.floats(0.3, 1.4), st.floats(0.3, 2.0), st.floats(-3.1, 3.1), st.floats(-0.1, 0.1)).map(np.array),
    st.tuples(*[st.floats(-0.05, 0.05)] * 3),
)
def test_gradient_of_the_fan_angle(fan, point):
    """To the error of central differences."""
    points = np.array([point, (0.0, 0.0, 0.0)])
    np.testing.assert_allclose(fan_gradient(fan, points), twin.fan_slopes(fan, points), rtol=1e-6, atol=1e-7)


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 40), st.floats(-1e4, 1e4), st.integers(0, 2**32 - 1))
def test_even_splines_are_scipys(pieces, first, seed):
    """Value, slope and basis at any time between the ends."""
    rng = np.random.default_rng(seed)
    knots, coefficients = even_knots(first, first + 1.5 * pieces, pieces), rng.normal(size=pieces + 3)
    spline = spline_on(knots, coefficients)
    np.testing.assert_allclose(spline_on(knots, 2 * abscissae(knots))(knots[3:-3]), 2 * knots[3:-3], atol=1e-8)
    for time in rng.uniform(knots[3], knots[-4], 5):
        value, slope = value_and_slope.py_func(knots, coefficients, time)
        assert value == pytest.approx(float(spline(time)), abs=1e-9)
        assert slope == pytest.approx(float(spline.derivative()(time)), abs=1e-8)
        piece, place = locate.py_func(knots, time)
        assert basis.py_func(place) @ coefficients[piece : piece + 4] == pytest.approx(value, abs=1e-9)


def test_fan_is_the_plane_through_source_and_point():
    source, level, up = fan_source(TRUE)
    np.testing.assert_allclose(source, RIG.source, atol=1e-12)
    point = np.array([0.02, 0.01, -0.003])
    angle = fan_angle(TRUE, point)
    normal = np.sin(angle) * level - np.cos(angle) * up
    assert abs((point - source) @ normal) < 1e-12
    assert fan_distance(TRUE, point) == pytest.approx(0.8, abs=0.03)


@settings(max_examples=40, deadline=None)
@given(
    st.tuples(st.floats(0.3, 1.4), st.floats(0.3, 2.0), st.floats(-3.1, 3.1), st.floats(-0.05, 0.05)).map(np.array),
    st.tuples(*[st.floats(-0.05, 0.05)] * 3).map(np.array),
    st.floats(-1.0, 1.0),
)
def test_all_points_of_a_fan_plane_have_its_angle(fan, point, along):
    """Moved along the axis or along the ray from the laser a point stays in its plane."""
    source, level, up = fan_source(fan)
    axis = np.cross(level, up)
    assert abs(source @ source - fan[1] ** 2) < 1e-12
    for other in (point + along * axis, source + (1.5 + along) * (point - source)):
        assert fan_angle(fan, other) == pytest.approx(fan_angle(fan, point), abs=1e-9)
        towards = source - other
        assert fan_distance(fan, other) == pytest.approx(np.linalg.norm(towards - (towards @ axis) * axis), abs=1e-12)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-1e4, 1e4))
def test_order_of_points_and_start_of_the_clock_do_not_matter(seed, start):
    """Up to the place of the knots in the clock's digits: a hundredth of a sigma."""
    rng = np.random.default_rng(seed)
    points, times = (values[::5] for values in reference(RIG))
    times, order = times + rng.normal(0, 0.01, times.size), rng.permutation(times.size)
    one = fit_sweep(points, times, np.full(times.size, 1e-4), RIG.mount)
    other = fit_sweep(points[order], times[order] + start, np.full(times.size, 1e-4), RIG.mount)
    assert other.status == one.status == SweepStatus.OK
    assert (np.abs(other.fan - one.fan) < 0.01 * one.deviation).all()
    assert other.first - one.first == pytest.approx(start, abs=1e-6)


@settings(max_examples=10, deadline=None)
@given(st.floats(-3.1, 3.1), st.sampled_from([25, 60, 88]))
def test_a_square_holder_looks_the_same_after_a_quarter_turn(turn, elevation_deg):
    camera = camera_at(elevation_deg)
    here, there = (
        reference_region(camera, geometry.rotation_z(angle), HOLDER, RIG.source) for angle in (turn, turn + np.pi / 2)
    )
    assert np.mean(here.height != there.height) < 1e-3  # rounding at the edges


@pytest.mark.parametrize("reverse", [False, True])
def test_true_laser_is_found_within_its_uncertainty(reverse):
    """Four noisy sweeps: the mean square of 16 normalised errors stays under 2.56, chi-square's 99.95 % quantile."""
    rig = replace(RIG, reverse=reverse)
    points, times = reference(rig)
    rng = np.random.default_rng(5)
    ratios, sigma = [], 0.01
    for _ in range(4):
        noise = rng.normal(0, sigma, times.size)
        sweep = fit_sweep(points, times + noise, np.full(times.size, sigma**2), rig.mount)
        assert sweep.status == SweepStatus.OK
        ratios.append((sweep.fan - TRUE) / sweep.deviation)
    assert np.mean(np.square(ratios)) < 2.56


def test_planes_between_frames_hold_the_true_points():
    points, times = reference(RIG)
    sweep = fit_sweep(points, times, np.full(times.size, 1e-6), RIG.mount)
    inside = (times > sweep.first) & (times < sweep.last)
    normal, offset = sweep.planes(times)
    off_m = np.einsum("ij,ij->i", normal, points) - offset
    assert np.abs(off_m[inside]).max() < 3e-6  # a ripple of 36 um amplitude, followed to less than a tenth
    assert np.isnan(sweep.planes(np.array([-5.0, 200.0]))[1]).all()


def test_a_fifth_of_wrong_times_changes_nothing():
    points, times = reference(RIG)
    rng = np.random.default_rng(2)
    noisy = times + rng.normal(0, 0.01, times.size)
    wrong = rng.random(times.size) < 0.2
    clean = fit_sweep(points[~wrong], noisy[~wrong], np.full((~wrong).sum(), 1e-4), RIG.mount)
    noisy[wrong] = rng.uniform(5, 90, wrong.sum())
    dirty = fit_sweep(points, noisy, np.full(times.size, 1e-4), RIG.mount)
    assert dirty.outliers >= 0.9 * wrong.sum()
    assert np.all(np.abs(dirty.fan - clean.fan) < 2 * clean.deviation)


def test_unexplained_scatter_is_found():
    """Times that scatter more than they say make the planes' variance say so."""
    points, times = reference(RIG)
    rng = np.random.default_rng(2)
    sweep = fit_sweep(points, times + rng.normal(0, 0.05, times.size), np.full(times.size, 1e-4), RIG.mount)
    rate = abs(float(sweep.spline.derivative()(48.0)))
    assert sweep.excess_rad == pytest.approx(np.sqrt(0.05**2 - 0.01**2) * rate, rel=0.1)


def test_one_height_keeps_the_nominal_laser():
    points, times = reference(RIG)
    upper = points[:, 2] > -1e-6
    sweep = fit_sweep(points[upper], times[upper], np.full(upper.sum(), 1e-4), RIG.mount)
    assert sweep.status == SweepStatus.ONE_HEIGHT
    assert sweep.deviation[0] > 0.5 * RIG.mount.elevation_tolerance_rad


@pytest.mark.parametrize("count", [0, 1, 30])
def test_too_few_points_are_a_status(count):
    points, times = reference(RIG)
    sweep = fit_sweep(points[:count], times[:count], np.full(count, 1e-4), RIG.mount)
    assert sweep.status == SweepStatus.NO_STRIPE
    assert np.isnan(sweep.planes(np.array([1.0]))[1]).all()


def test_a_standing_stripe_is_a_status():
    points, times = reference(RIG)
    sweep = fit_sweep(points, np.full(times.size, 12.0), np.full(times.size, 1e-4), RIG.mount)
    assert sweep.status == SweepStatus.NO_STRIPE
