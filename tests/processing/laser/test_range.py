"""From frames to displacements on surfaces whose truth is known, with an uneven laser in the wrong place."""

from dataclasses import replace

import numpy as np
import pytest

from processing import geometry
from processing.errors import ImageError
from processing.laser.laser_plane import SweepStatus
from processing.laser.mdf import Sweep, measure_sweep
from processing.laser.range_image import RangeStatus, range_image
from processing.laser.space_time import PeakStatus
from tests.reference import laser_range as twin
from tests.reference.stripe_rig import HOLDER, SENSOR, Rig, StoppingRig, bump, camera_at, flat, shoot, step


def measure(rig, frames, **more):
    return measure_sweep(Sweep("view", frames, SENSOR, rig.camera, rig.rig_from_sample, rig.mount, **more), HOLDER)


def ratio(result, true):
    """Error over its sigma at measured pixels whose truth is known."""
    known = (result.image.status == RangeStatus.MEASURED) & np.isfinite(true)
    error = result.image.displacement_m[known] - true[known]
    return error / np.sqrt(result.image.variance_m2[known])


def completeness(rig, result, true):
    """Share of the pixels on the sample which the laser reaches that were measured."""
    reached = twin.opening(rig.camera, rig.rig_from_sample, HOLDER) & np.isfinite(true)
    return np.mean(result.image.status[reached] == RangeStatus.MEASURED)


@pytest.mark.parametrize(
    "rig",
    [
        Rig(camera_at(60), flat(0.002)),
        Rig(camera_at(88), bump, turntable_deg=45.0, azimuth_deg=90.0),
        Rig(camera_at(30), bump, turntable_deg=90.0, azimuth_deg=170.0),
        Rig(camera_at(50), step, azimuth_deg=20.0, reverse=True),
        Rig(camera_at(70), bump, azimuth_deg=-60.0, unevenness=0.1),
        Rig(camera_at(60), flat(0.001), peak_e=40000.0),  # saturated wherever red
        Rig(camera_at(60), bump, elevation_deg=49.3, distance_m=0.86),
    ],
    ids=[
        "plane",
        "bump from above",
        "bump from the side",
        "step, reversed",
        "very uneven motor",
        "saturated",
        "three sigma off its mount",
    ],
)
def test_errors_are_as_large_as_they_say(rig):
    frames, true = shoot(rig)
    result = measure(rig, frames)
    assert result.laser.status == SweepStatus.OK
    ratios = ratio(result, true)
    assert 0.9 < np.sqrt(np.mean(ratios**2)) < 1.2
    assert completeness(rig, result, true) > 0.98
    never = (result.image.status == RangeStatus.MEASURED) & np.isnan(true)
    assert never.sum() < 0.002 * np.isfinite(true).sum()  # no false points


def test_a_motor_that_stops_costs_the_pixels_under_it():
    """These shine for twelve frames, so have no time; all others are as good as their sigmas."""
    rig = StoppingRig(camera_at(60), bump)
    frames, true = shoot(rig)
    result = measure(rig, frames)
    assert 0.9 < np.sqrt(np.mean(ratio(result, true) ** 2)) < 1.2
    assert completeness(rig, result, true) > 0.9


def test_a_camera_that_is_a_little_off_hardly_matters():
    """The holder is seen through the same camera: 20 um and 20 urad beside its place shift the surface by under 1 um.

    And by under 2 um with a focal length 1e-4 too long, which alone is 100 um of the camera's distance.
    """
    rig = Rig(camera_at(60), bump)
    frames, true = shoot(rig)
    right = measure(rig, frames).image.displacement_m
    aside = rig.camera.rig_from_camera @ geometry.rigid_from_vectors((2e-5, -1e-5, 2e-5), (2e-5, -2e-5, 1e-5))
    matrix = rig.camera.lens.matrix * np.array([[1.0001], [1.0001], [1.0]])
    matrix[:, 2] = rig.camera.lens.matrix[:, 2]
    longer = replace(rig.camera.lens, matrix=matrix)
    for camera, most_m in (
        (replace(rig.camera, rig_from_camera=aside), 1e-6),
        (replace(rig.camera, lens=longer), 2e-6),
    ):
        result = measure(replace(rig, camera=camera), frames)
        assert abs(np.nanmedian(result.image.displacement_m - right)) < most_m
        assert 0.9 < np.sqrt(np.mean(ratio(result, true) ** 2)) < 1.2


@pytest.mark.parametrize("elevation_deg", [30, 75])
def test_rays_are_cut_as_in_the_twin(elevation_deg):
    """Status, displacement and variance, also of times outside the sweep and of points outside the box."""
    rig = Rig(camera_at(elevation_deg), bump, turntable_deg=20.0)
    frames, _ = shoot(rig)
    result = measure(rig, frames)
    rng = np.random.default_rng(3)
    wild = rng.random(rig.camera.size) < 0.3
    times = np.where(wild, rng.uniform(-9, 105, wild.shape), result.peaks.time_frames).astype(np.float32)
    variance = np.where(wild, 1e-4, result.peaks.variance).astype(np.float32)
    peaks = replace(
        result.peaks, time_frames=times, variance=variance, status=np.where(np.isnan(times), 1, 0).astype(np.uint8)
    )
    image = range_image(peaks, rig.camera, rig.rig_from_sample, HOLDER, result.laser)
    status, displacement, spread = twin.cut_rays(
        times, variance, rig.camera, (rig.rig_from_sample, HOLDER), result.laser
    )
    np.testing.assert_array_equal(image.status, status)
    assert set(np.unique(status)) == set(RangeStatus)
    np.testing.assert_allclose(image.displacement_m, displacement, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(image.variance_m2, spread, rtol=1e-4)


def test_red_pixels_reach_the_shot_noise():
    """Red pixels of a plane, 5000 electrons high: within 15 % of w / sqrt(sqrt(2 pi) w A) times the cut's speed.

    The excess is the camera's read noise and background, and what the planes themselves cost.
    """
    rig = Rig(camera_at(60), flat(0.002))
    frames, true = shoot(rig)
    result = measure(rig, frames)
    error = (result.image.displacement_m - true)[::2, ::2]
    width = np.nanmedian(result.peaks.width_frames)
    normal, _ = result.laser.planes(np.array([47.0, 48.0]))
    advance_m = np.linalg.norm(normal[1] - normal[0]) * rig.distance_m
    slant = abs(normal[0] @ rig.camera.rays(np.array([[79.5, 63.5]]))[0])
    bound_m = np.sqrt(width / (np.sqrt(2 * np.pi) * 5000)) * advance_m / slant
    assert np.sqrt(np.nanmean(error**2)) < 1.15 * bound_m


def test_albedo_does_not_move_the_surface():
    """Stripes of 5:1 in albedo leave no trace in the displacement: both kinds have zero mean error."""
    rig = Rig(camera_at(60), flat(0.002), albedo=lambda x, y: np.where(np.floor(x / 0.004) % 2 == 0, 0.1, 0.5))
    frames, true = shoot(rig)
    result = measure(rig, frames)
    points, _ = rig.hits()
    bright = np.floor(rig.local(points)[..., 0] / 0.004) % 2 == 1
    error = (result.image.displacement_m - true) / np.sqrt(result.image.variance_m2)
    for part in (bright, ~bright):
        values = error[part & np.isfinite(error)]
        assert abs(values.mean()) < 5 / np.sqrt(len(values))


def test_shadow_stays_a_hole():
    """The step's wall shades its foot from a laser behind it: those pixels are holes, not surfaces."""
    rig = Rig(camera_at(60), step, azimuth_deg=180.0)
    frames, true = shoot(rig)
    result = measure(rig, frames)
    shaded = twin.opening(rig.camera, rig.rig_from_sample, HOLDER) & np.isnan(true)
    assert shaded.sum() > 50
    assert np.mean(result.image.status[shaded] == RangeStatus.NO_PEAK) > 0.98


def test_a_dropped_frame_is_known_by_its_time():
    rig = Rig(camera_at(60), flat(0.002))
    frames, true = shoot(rig)
    result = measure(rig, np.delete(frames, 40, axis=0), times=np.delete(np.arange(len(frames)), 40))
    assert 0.9 < np.sqrt(np.mean(ratio(result, true) ** 2)) < 1.2


def test_a_ghost_stripe_makes_holes_not_points():
    """A second laser plane as bright as the first, twenty frames late: no pixel gives a depth from it."""
    rig = Rig(camera_at(60), flat(0.002))
    frames, true = shoot(rig)
    inside = twin.opening(rig.camera, rig.rig_from_sample, HOLDER)
    ghost = np.where(inside, np.roll(frames, 20, axis=0), 256)
    result = measure(rig, np.maximum(frames, ghost))
    early = inside & np.isfinite(true) & (result.peaks.status == PeakStatus.DOUBLE)
    assert early.sum() > 0.7 * (inside & np.isfinite(true)).sum()
    wrong = np.abs(ratio(result, true)) > 6
    assert wrong.sum() < 0.01 * inside.sum()


@pytest.mark.parametrize("frames", [1, 5, 90])
def test_without_a_stripe_there_is_a_status(frames):
    rig = Rig(camera_at(60), flat(0.002))
    dark = np.full((frames, *rig.camera.size), 260, np.uint16)
    result = measure(rig, dark)
    assert result.laser.status == SweepStatus.NO_STRIPE
    assert not np.any(result.image.status == RangeStatus.MEASURED)
    assert np.all(np.isnan(result.image.displacement_m))


def test_one_bright_frame_is_a_status():
    rig = Rig(camera_at(60), flat(0.002))
    frames, _ = shoot(replace(rig, frames=1))
    assert measure(rig, frames).laser.status == SweepStatus.NO_STRIPE


def test_points_lie_on_the_surface():
    rig = Rig(camera_at(60), flat(0.002))
    frames, _ = shoot(rig)
    points = measure(rig, frames).image.points(rig.camera)
    assert np.nanmedian(points[..., 2]) == pytest.approx(-0.002, abs=5e-6)


def test_frames_of_another_size_are_refused():
    rig = Rig(camera_at(60), flat(0.002))
    with pytest.raises(ImageError, match="camera of"):
        measure(rig, np.zeros((20, 32, 32), np.uint16))
