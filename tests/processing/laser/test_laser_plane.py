"""The planes of a sweep: from points on two heights to a laser's place, with a covariance that is true."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing import geometry
from processing.laser.even_spline import abscissae, basis, even_knots, locate, spline_on, value_and_slope
from processing.laser.fan import angle_slopes, fan_angle, fan_frame, fan_source
from processing.laser.holder import reference_region, wanted_pixels
from processing.laser.laser_plane import SweepStatus, fit_sweep, sweep_planes
from processing.laser.space_time import PeakTimes
from tests.reference import laser_range as twin
from tests.reference.stripe_rig import HOLDER, Rig, StoppingRig, camera_at, flat

RIG = Rig(camera_at(60), flat(0.002))


def true_fan(rig):
    return np.array([np.radians(rig.elevation_deg), rig.distance_m, np.radians(rig.azimuth_deg), 0.0])


TRUE = true_fan(RIG)


def reference(rig):
    """Points of the white frame and the moments at which the true plane holds them."""
    region = reference_region(rig.camera, rig.rig_from_sample, HOLDER, rig.source)
    points = region.points_m[region.height > 0]
    moments = np.linspace(0, rig.frames - 1, 20001)
    fans = rig.fan(moments)
    order = np.argsort(fans)
    times = np.interp(fan_angle(true_fan(rig), points), fans[order], moments[order], left=np.nan, right=np.nan)
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
        assert not (chosen & twin.opening(rig.camera, rig.rig_from_sample, HOLDER)).any()


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
    height, wanted = reference_region(*view).height, wanted_pixels(*view)
    np.testing.assert_array_equal(wanted & (height == 0), expected == twin.OPENING)
    assert wanted[height > 0].all()
    assert np.mean(np.where(wanted & (height == 0), twin.OPENING, height) != expected) < 2e-4


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
    """To the error of central differences; the squared distance from the axis comes with it."""
    *slopes, square = angle_slopes.py_func(fan_frame(fan), *point)
    np.testing.assert_allclose(slopes, twin.fan_slopes(fan, np.array([point]))[0], rtol=1e-6, atol=1e-7)
    assert np.sqrt(square) == pytest.approx(twin.fan_distance(fan, np.array(point)))


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
    assert twin.fan_distance(TRUE, point) == pytest.approx(0.8, abs=0.03)


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
        assert twin.fan_distance(fan, other) == pytest.approx(
            np.linalg.norm(towards - (towards @ axis) * axis), abs=1e-12
        )


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


SWEEPS = {
    "usual": RIG,
    "even": replace(RIG, unevenness=0.0),
    "very uneven": replace(RIG, unevenness=0.3),
    "stopping": StoppingRig(RIG.camera, RIG.surface),
    "reversed, three sigma off its mount": replace(RIG, reverse=True, elevation_deg=45 + 4.3, distance_m=0.86),
    "low camera, turned holder": replace(RIG, camera=camera_at(25), turntable_deg=-117.0, azimuth_deg=170.0),
}


@pytest.mark.parametrize("rig", SWEEPS.values(), ids=SWEEPS)
def test_planes_are_as_good_as_their_covariance_says(rig):
    """Where a sample lies, over eight sweeps whose points differ in noise as a mosaic's do, and whose motors differ.

    Some hundred independent numbers: their root mean square is within 0.1 of 1, a little under it since Tukey's weights
    make the covariance 4 % too large and a spline's knots are more than most motors need.
    """
    points, times = reference(rig)
    moments, sample = points_of_the_sample(rig)
    rng = np.random.default_rng(9)
    sigma = rng.choice([0.006, 0.02, 0.02, 0.05], times.size)
    ratios = []
    for _ in range(8):
        sweep = fit_sweep(points, times + sigma * rng.normal(size=times.size), sigma**2, rig.mount)
        assert sweep.status == SweepStatus.OK
        inside = (moments > sweep.first) & (moments < sweep.last)
        error = fan_angle(sweep.fan, sample[inside]) - sweep.spline(moments[inside])
        ratios.append(error / np.sqrt(twin.angle_variance(sweep, sample[inside], moments[inside], 0.0)))
    assert 0.75 < np.sqrt(np.mean(np.concatenate(ratios) ** 2)) < 1.1


def points_of_the_sample(rig):
    """Moments (n,) while the laser turns, and points (n, 3) of the true planes then, anywhere in the sample's box."""
    rng = np.random.default_rng(4)
    moments = rng.uniform(5, rig.frames - 6, 200)
    moments = moments[np.abs(rig.fan(moments + 0.1) - rig.fan(moments)) > 0]
    source, level, up = fan_source(true_fan(rig))
    side, angle, depth = np.cross(up, level), rig.fan(moments), rng.uniform(0, 0.004, moments.size)
    out = (source[2] + depth) / np.tan(angle)
    along = rng.uniform(-0.03, 0.03, moments.size)
    return moments, source - out[:, None] * level - (source[2] + depth)[:, None] * up + along[:, None] * side


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-3, 0.1, 1e3]))
def test_the_unit_of_length_does_not_matter(seed, scale):
    """Angles stay, the distance scales, as do points and mount."""
    points, times = (values[::5] for values in reference(RIG))
    times = times + np.random.default_rng(seed).normal(0, 0.01, times.size)
    mount = replace(
        RIG.mount, distance_m=RIG.mount.distance_m * scale, distance_tolerance_m=RIG.mount.distance_tolerance_m * scale
    )
    one = fit_sweep(points, times, np.full(times.size, 1e-4), RIG.mount)
    other = fit_sweep(points * scale, times, np.full(times.size, 1e-4), mount)
    np.testing.assert_allclose(other.fan / [1, scale, 1, 1], one.fan, atol=1e-7)
    np.testing.assert_allclose(other.spline(50.5), one.spline(50.5), atol=1e-8)


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_sweep_and_its_mirror_in_time_are_one(seed):
    points, times = (values[::5] for values in reference(RIG))
    times, variance = times + np.random.default_rng(seed).normal(0, 0.01, times.size), np.full(times.size, 1e-4)
    one, other = fit_sweep(points, times, variance, RIG.mount), fit_sweep(points, 95.0 - times, variance, RIG.mount)
    assert (np.abs(other.fan - one.fan) < 0.05 * one.deviation).all()
    assert (other.first, other.last) == pytest.approx((95.0 - one.last, 95.0 - one.first))


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([np.nan, np.inf, -np.inf]), st.sampled_from([0, 1, 2]))
def test_what_is_no_number_has_no_say(seed, nothing, where):
    """In points, times or variances."""
    points, times = (values[::5] for values in reference(RIG))
    variance = np.full(times.size, 1e-4)
    bad = np.random.default_rng(seed).random(times.size) < 0.1
    clean = fit_sweep(points[~bad], times[~bad], variance[~bad], RIG.mount)
    spoilt = [points.copy(), times.copy(), variance.copy()]
    spoilt[where][bad] = nothing
    np.testing.assert_array_equal(fit_sweep(*spoilt, RIG.mount).fan, clean.fan)


def test_single_precision_is_enough():
    points, times = reference(RIG)
    times, variance = times + np.random.default_rng(2).normal(0, 0.01, times.size), np.full(times.size, 1e-4)
    double = fit_sweep(points, times, variance, RIG.mount)
    single = fit_sweep(*(values.astype(np.float32) for values in (points, times, variance)), RIG.mount)
    assert (np.abs(single.fan - double.fan) < 0.05 * double.deviation).all()


@pytest.mark.parametrize(("low", "high"), [(0, 33), (57, 95)], ids=["first third", "last part"])
def test_a_sweep_seen_in_part_knows_its_part(low, high):
    """Planes are known where points were seen, and nowhere else."""
    points, times = reference(RIG)
    seen = (times > low) & (times < high)
    sweep = fit_sweep(points[seen], times[seen], np.full(seen.sum(), 1e-6), RIG.mount)
    assert sweep.status == SweepStatus.OK
    assert low <= sweep.first < sweep.last <= high
    moments = np.linspace(-5, 100, 400)
    known = np.isfinite(sweep.planes(moments)[1])
    np.testing.assert_array_equal(known, (moments >= sweep.first) & (moments <= sweep.last))


@settings(max_examples=12, deadline=None)
@given(st.floats(-180, 180))
def test_any_turn_of_the_table_serves(turntable_deg):
    """The holder's frame tells the laser whatever side it shows, within four of its sigmas."""
    rig = replace(RIG, turntable_deg=turntable_deg)
    points, times = reference(rig)
    times = times + np.random.default_rng(1).normal(0, 0.01, times.size)
    sweep = fit_sweep(points, times, np.full(times.size, 1e-4), rig.mount)
    assert sweep.status == SweepStatus.OK
    assert (np.abs(sweep.fan - TRUE) < 4 * sweep.deviation).all()


def test_a_holder_without_a_step_keeps_the_nominal_laser():
    """Its two parts are one height; without parts there is no stripe."""
    flat_holder, none = replace(HOLDER, step_m=0.0), replace(HOLDER, inner_m=HOLDER.sample_m, outer_m=HOLDER.sample_m)
    peaks = holder_peaks(RIG)
    flat_sweep = sweep_planes(peaks, RIG.camera, RIG.rig_from_sample, flat_holder, RIG.mount)
    assert flat_sweep.status == SweepStatus.ONE_HEIGHT
    assert sweep_planes(peaks, RIG.camera, RIG.rig_from_sample, none, RIG.mount).status == SweepStatus.NO_STRIPE


def holder_peaks(rig):
    """Peak times of a plane at the reference height, without noise."""
    rays, centre = rig.camera.pixel_rays(), rig.camera.centre_m
    angle = fan_angle(true_fan(rig), centre - rays * (centre[2] / rays[..., 2:]))
    moments = np.linspace(0, rig.frames - 1, 2001)
    time = np.interp(angle, rig.fan(moments), moments, left=np.nan, right=np.nan).astype(np.float32)
    one = np.ones_like(time)
    return PeakTimes(time, 1e-4 * one, 5e3 * one, np.where(np.isnan(time), 1, 0).astype(np.uint8), one)


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


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), kind=st.sampled_from(["one place", "flashes", "exact", "anything"]))
def test_what_is_no_sweep_is_told(seed, kind):
    """Points that no moving plane meets, and variances of any size: planes with a covariance, or none at all."""
    rng = np.random.default_rng(seed)
    mount = Rig(camera_at(60), flat(0.002)).mount
    count = int(rng.choice([60, 80, 400]))
    points = np.column_stack([rng.uniform(-0.05, 0.05, (count, 2)), -0.008 * rng.integers(0, 2, count)])
    times = rng.uniform(0.0, 100.0, count)
    variances = 10.0 ** rng.uniform(-30, 30, count)
    if kind == "one place":
        points[:] = points[0] + 1e-9 * rng.random((count, 3))
    elif kind == "flashes":
        times = rng.choice([0.0, 30.0], count)
    elif kind == "exact":
        variances[:] = 1e-300
    sweep = fit_sweep(points, times, variances, mount)
    if sweep.status != SweepStatus.NO_STRIPE:
        assert np.isfinite(sweep.spline.c).all()
        assert (np.diag(sweep.covariance) > 0).all()
