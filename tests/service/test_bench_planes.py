"""The planes' part of the laser benchmark: its truth and its bound against each other, its peers."""

import numpy as np
import pytest

from processing.laser.fan import fan_angle
from processing.laser.holder import plane_hits
from processing.laser.laser_plane import sweep_planes
from processing.laser.mdf import measure_sweep
from processing.laser.range_image import RangeStatus, range_image
from tests.benchmarks.lasers.planes import Merging, angle_errors_deg, noisy_peaks, place_errors, plane_rows, true_planes
from tests.benchmarks.yardsticks.located_sweeps import brick, location, smooth_cap
from tests.reference.stripe_rig import HOLDER, Rig, camera_at, flat


@pytest.fixture(scope="module", params=[smooth_cap, brick], ids=["cap", "brick"])
def measured(request):
    located = request.param(3)
    return located, measure_sweep(located.sweep, located.holder)


def test_true_planes_hold_the_true_points(measured):
    """At the time at which the true angle is that of a point, to a micrometre of interpolation in time."""
    located, _ = measured
    camera = located.sweep.camera
    seen = np.isfinite(located.displacement_m)
    points = plane_hits(camera, 0.0)[seen] + located.displacement_m[seen, None] * camera.pixel_rays()[seen]
    moments = np.linspace(0, 93, 4000)
    angles = located.angle(moments)
    rising = np.argsort(angles)
    times = np.interp(fan_angle(located.fan, points), angles[rising], moments[rising], left=np.nan, right=np.nan)
    known = np.isfinite(times)
    normal, offset = true_planes(located, times[known])
    assert known.mean() > 0.9
    assert np.abs(np.einsum("ni,ni->n", normal, points[known]) - offset).max() < 1e-6


def test_errors_are_at_the_bound_and_not_under_it(measured):
    """Over thousands of pixels whose bounds differ a hundredfold the errors are 0.97 to 1.06 of them."""
    error, sigma, bound, complete = Merging("one", [measured]).merged(1)
    assert len(error) > 2000
    assert 0.97 < np.sqrt(np.mean((error / bound) ** 2)) < 1.06
    assert 0.95 < np.sqrt(np.mean((sigma / bound) ** 2)) < 1.06
    assert complete > 0.95


def test_planes_and_laser_are_where_they_should_be(measured):
    """Four numbers of each laser within four of their sigmas; planes within a fiftieth of a degree."""
    assert np.abs(place_errors(*measured)).max() < 4
    assert angle_errors_deg(*measured).max() < 0.02


def test_locations_are_spread_over_mountings_and_azimuths():
    places = np.array([location(number) for number in range(26)])
    assert len(np.unique(places[:, 1])) == 5
    assert np.diff(np.sort(places[:, 0])).max() < 30
    assert np.abs(places[:, 0]).max() <= 180


def test_one_model_beats_planes_of_single_frames():
    ours, two_heights, parallel = plane_rows(1.0)
    assert ours["over_its_bound"] < 1.1
    assert min(two_heights["over_its_bound"], parallel["over_its_bound"]) > 2 * ours["over_its_bound"]
    assert two_heights["measured"] > 0.9


def test_what_is_timed_is_measured():
    """The speed's peak times are those of a sample in its holder: the rays' cuts are on it, none is given up early."""
    rig = Rig(camera_at(60), flat(0.002))
    peaks, view = noisy_peaks(rig, np.random.default_rng(7)), (rig.camera, rig.rig_from_sample, HOLDER)
    image = range_image(peaks, *view, sweep_planes(peaks, *view, rig.mount))
    looking = image.status != RangeStatus.NOT_SAMPLE
    assert np.mean(image.status[looking] == RangeStatus.MEASURED) > 0.95
    depth_m = -rig.camera.pixel_rays()[..., 2] * image.displacement_m
    assert np.nanmedian(np.abs(depth_m - 0.002)) < 2e-5  # a hundredth of a frame, in which the trace moves 1.1 mm
