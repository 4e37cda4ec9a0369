"""The benchmark of displacements: its sweeps are those of the rig, its figures are of what they say."""

import json

import numpy as np
import pytest

from processing.radiometry.sensor import Sensor
from simulators.optics import Optics
from tests.benchmarks.lasers import displacements
from tests.benchmarks.yardsticks.laser_scans import Location, Recording, Scanner, around, planned

PLACE = Location(60.0, 50.0)


@pytest.fixture(scope="module")
def scanner(tmp_path_factory):
    return Scanner(Optics(3, "small", tmp_path_factory.mktemp("truth")), "cam4", "brick")


def test_locations_are_even_and_leave_the_cameras_their_view():
    for places, count in [(around(2), 2), (around(8), 8), (planned(), 26)]:
        assert len(set(places)) == count
        assert all(15 < place.azimuth_deg % 360 < 345 for place in places)


def test_unlit_pixels_have_the_sensors_noise_and_lit_ones_the_stripe(scanner):
    frames = np.stack(list(scanner.sweep(PLACE, Recording()).frames)).astype(float)
    sensor = Sensor(256.0, 4095.0, 4.0, 4.0)
    still = np.ptp(frames, axis=0) < 12  # no stripe here at any time
    assert still.mean() > 0.02
    noise_e = 4.0 * np.std(np.diff(frames[:, still], axis=0)) / np.sqrt(2)
    assert noise_e == pytest.approx(np.sqrt(sensor.dark_variance_e2), rel=0.1)
    brightest = frames.argmax(axis=0)[frames.max(axis=0) > 1000]
    assert np.ptp(brightest) > 60  # it sweeps


def test_one_view_is_measured_and_compared(scanner):
    view = displacements._scan(scanner, around(3))
    result = displacements._product([view], "brick")
    figures, (whole, of_view, bilinear, limit) = result.figures, result.rows
    assert json.loads(json.dumps([dict(row) for row in result.rows])) == [dict(row) for row in result.rows]
    assert whole["error"] == of_view["error"] == figures["displacement_rms_um"]
    assert whole["error"] < bilinear["error"]
    assert limit["completeness"] == 1.0
    assert 0.9 < figures["completeness"] <= 1.0
    assert figures["mdf_within_one_code_step"] < limit["within_one_code_step"]
    fewer = displacements._product([view.fewer(1)], "brick").figures
    assert fewer["completeness"] < figures["completeness"] + 0.02  # of less that can be measured
    assert fewer["mdf_within_one_code_step"] < figures["mdf_within_one_code_step"]


def test_a_point_is_false_where_no_laser_reaches_or_far_off(scanner):
    view = displacements._scan(scanner, around(2))
    truth = scanner.truth(view.locations, displacements.TEXELS)
    exact = displacements._as_mdf(
        [(truth.displacement_m.astype(np.float32), np.ones_like(truth.displacement_m))], [view]
    )
    errors = displacements._errors(exact, [truth])
    unlit = np.isfinite(truth.displacement_m) & ~truth.lit
    assert unlit.any()
    assert errors.false_points == pytest.approx(unlit.sum() / np.isfinite(truth.displacement_m).sum())
    assert (errors.completeness, errors.within_one_code_step) == (1.0, 1.0)
    off = np.where(truth.lit, exact.displacement_m[0], np.nan)
    off[np.unravel_index(np.flatnonzero(truth.lit)[:7], off.shape)] += 6e-4
    shifted = displacements._errors(displacements._as_mdf([(off, np.ones_like(off))], [view]), [truth])
    assert shifted.false_points == pytest.approx(7 / truth.lit.sum())
    assert shifted.error_m.largest == pytest.approx(6e-4, rel=1e-3)
