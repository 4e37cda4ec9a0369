"""Plain NumPy twins of the laser range kernels: what each pixel sees of the holder, and rays cut by the planes."""

import numpy as np

from processing import geometry
from processing.laser.fan import fan_angle, fan_source
from processing.laser.holder import plane_hits

NOTHING, UPPER, LOWER, OPENING = range(4)
MEASURED, NOT_SAMPLE, NO_PEAK, NO_PLANE, OUTSIDE_BOX = range(5)
SAFETY_M, MARGIN_M, GRAZING = 0.0004, 0.0003, 0.05


def holder_parts(camera, rig_from_sample, holder, source_m):
    """Part (h, w) of the holder that every pixel sees; ways are looked at in 200 steps."""
    upper, lower = plane_hits(camera, 0.0), plane_hits(camera, -holder.step_m)
    sides = [np.linalg.norm(np.gradient(upper, axis=axis), axis=-1) for axis in (0, 1)]
    margin = np.maximum(*sides) / 2 + SAFETY_M
    at_upper, at_lower = (_ring(points, rig_from_sample) for points in (upper, lower))
    towards = np.asarray(source_m) - lower
    light = lower + towards * (holder.step_m / towards[..., 2:])
    on_upper = (at_upper > holder.sample_m / 2 + margin) & (at_upper < holder.inner_m / 2 - margin)
    on_lower = (at_lower > holder.inner_m / 2 + margin) & (at_lower < holder.outer_m / 2 - margin)
    for end in (upper, light):
        for share in np.linspace(0, 1, 201):
            on_lower &= _ring(lower + share * (end - lower), rig_from_sample) > holder.inner_m / 2 + margin
    part = np.where(on_upper, UPPER, np.where(on_lower, LOWER, NOTHING))
    return np.where(at_upper < holder.sample_m / 2, OPENING, part)


def opening(camera, rig_from_sample, holder):
    """Pixels (h, w) whose rays enter the sample's opening through the reference plane."""
    return _ring(plane_hits(camera, 0.0), rig_from_sample) < holder.sample_m / 2


def _ring(points, rig_from_sample):
    local = geometry.transform_points(geometry.invert(rig_from_sample), points)
    return np.abs(local[..., :2]).max(axis=-1)


def fan_slopes(fan, points):
    """Derivatives (n, 4) of the fan's angle by central differences."""
    step = 1e-5
    rises = [fan_angle(fan + s, points) - fan_angle(fan - s, points) for s in step * np.eye(4)]
    return np.stack(rises, axis=-1) / (2 * step)


def fan_distance(fan, points):
    """Distance (...) in metres of points (..., 3) from the fan's axis."""
    source, level, up = fan_source(fan)
    return np.linalg.norm(np.stack([(source - points) @ level, (source - points) @ up]), axis=0)


def cut_rays(times, variances, camera, sample, sweep):
    """Status, displacement and variance (h, w) from peak times (h, w); `sample`: rig_from_sample and the holder."""
    rig_from_sample, holder = sample
    start, rays = plane_hits(camera, 0.0), camera.pixel_rays()
    inside = _ring(start, rig_from_sample) < holder.sample_m / 2
    normal, offset = sweep.planes(np.where(np.isfinite(times), times, np.inf).astype(float))
    slant = (normal * rays).sum(axis=-1)
    depth = np.where(np.abs(slant) > GRAZING, (offset - (normal * start).sum(axis=-1)) / slant, np.nan)
    points = start + depth[..., None] * rays
    good = inside & np.isfinite(depth)
    variance = np.full(depth.shape, np.nan)
    of_angle = angle_variance(sweep, points[good], times[good].astype(float), variances[good])
    variance[good] = of_angle * (fan_distance(sweep.fan, points[good]) / slant[good]) ** 2
    local = geometry.transform_points(geometry.invert(rig_from_sample), points)
    margin = MARGIN_M + 3 * np.sqrt(variance)
    out = np.abs(local[..., :2]).max(axis=-1) > holder.sample_m / 2 + margin
    out |= (local[..., 2] > margin) | (local[..., 2] < -holder.depth_m - margin)
    vague = variance > holder.depth_m**2 / 12
    status = np.where(
        np.isnan(times), NO_PEAK, np.where(np.isnan(depth) | vague, NO_PLANE, np.where(out, OUTSIDE_BOX, 0))
    )
    status = np.where(inside, status, NOT_SAMPLE)
    found = status == MEASURED
    return status, np.where(found, depth, np.nan), np.where(found, variance, np.nan)


def angle_variance(sweep, points, times, time_variances):
    """Variance (n,) of the angles between points and the planes at their times."""
    basis = sweep.spline.design_matrix(times, sweep.spline.t, 3).toarray()
    jacobian = np.hstack([fan_slopes(sweep.fan, points), -basis])
    model = np.einsum("ij,jk,ik->i", jacobian, sweep.covariance, jacobian, optimize=True)
    excess = sweep.local_excess_rad[np.searchsorted(sweep.spline.t[4:-4], times, side="right")]
    return sweep.spline.derivative()(times) ** 2 * time_variances + excess**2 + model
