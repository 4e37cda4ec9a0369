"""The laser benchmark: its forward model and bounds against what is known, its peers, its figures."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.benchmarks import laser
from tests.benchmarks.lasers import pulses, steps
from tests.benchmarks.yardsticks.stripe_peers import PEERS
from tests.reference.stripe_cards import CELLS, Card, noise_covariance, range_bound_m, time_bound

FIGURES = {
    "peak_time_rmse_over_crb", "peak_time_rmse_over_crb_saturated", "peak_outliers", "sigma_t0_calibration",
    "stage1_bandwidth_share", "full_gpx_frames_per_s", "full_speedup_vs_numpy_parabola",
    "gain_over_argmax", "albedo_step_error_reduction", "plane_angle_error_deg", "displacement_rmse_over_bound",
    "weights_paper_rmse", "weights_variance_rmse", "displacement_rms_um", "completeness", "false_point_share",
    "mdf_within_one_code_step",
}  # fmt: skip
ERRORS = ("error", "median", "p95", "largest")


def middle(card, electrons):
    """First moment (rows, p) of the pulses: exact without noise for any pulse that is sampled once per sigma."""
    times = card.times[:, None, None]
    return (electrons * times).sum(axis=0) / electrons.sum(axis=0)


@pytest.mark.parametrize("slope_deg", [-35, 0, 45, 70])
@pytest.mark.parametrize("frames", [92, 400])
def test_without_noise_the_middle_of_the_pulse_is_the_surface(slope_deg, frames):
    """To a nanometre; 104 mm in 92 frames is one sigma per frame."""
    card = Card(rows=1, slope_rad=np.radians(slope_deg), advance_m=0.104 / frames)
    height = card.range_m(middle(card, card.electrons()), card.x_m)
    error = (height - card.surface_m(card.x_m))[:, card.looked_at]
    assert np.abs(error).max() < 1e-9


@pytest.mark.parametrize("ratio", [1.0, 10.0])
def test_an_edge_in_a_pixel_moves_its_pulse_to_where_the_light_comes_from(ratio):
    """The first moment of the pulse is that of the albedo in the footprint; the other pixels do not feel the edge."""
    card = Card(rows=16, ratio=ratio)
    shown = card.albedo.reshape(16, -1, CELLS)
    cells = ((np.arange(CELLS) + 0.5) / CELLS - 0.5) * card.pixel_m
    expected = card.x_m + (shown * cells).sum(axis=-1) / shown.sum(axis=-1)
    found = middle(card, card.electrons()) * card.advance_m
    np.testing.assert_allclose(found[:, card.looked_at], expected[:, card.looked_at], atol=1e-9)


def test_the_light_is_as_bright_as_stated():
    """A fine pixel under a still stripe that it faces counts peak_e; three times as long a shutter is as bright."""
    card = Card(rows=1, slope_rad=np.pi / 4, pixel_m=1e-5, half_m=1e-5, exposure_frames=0.0, advance_m=1e-4)
    assert card.electrons().max() == pytest.approx(card.peak_e, rel=1e-3)
    blurred = replace(Card(rows=1), exposure_frames=0.9)
    np.testing.assert_allclose(blurred.electrons().sum(axis=0), Card(rows=1).electrons().sum(axis=0), rtol=1e-6)


@pytest.mark.parametrize("contrast", [0.05, 0.2])
def test_speckle_has_its_mean_contrast_and_correlation(contrast):
    """Within what 20 000 pulses tell (0.7 % of the contrast)."""
    card = Card(rows=500, speckle=contrast)
    factor = card._speckle(np.random.default_rng(1), (len(card.times), card.rows, len(card.x_m)))
    assert factor.mean() == pytest.approx(1, abs=0.01 * contrast + 1e-3)
    assert factor.std() == pytest.approx(contrast, rel=0.03)
    together = np.corrcoef(factor.reshape(len(factor), -1))
    np.testing.assert_allclose(together, card.correlation(), atol=0.05)


def test_the_bound_of_many_photons_is_the_closed_one():
    """Width over the root of the number of photo-electrons, where photons are all but the noise; within 2 %."""
    card = Card(rows=1, peak_e=14000.0, ambient_e=0.0, advance_m=0.0003, pixel_m=0.0001, half_m=0.0005)
    mean = card.electrons()[:, 0, card.looked_at]
    width = card.sigma_m / np.cos(card.angle_rad) / card.advance_m
    np.testing.assert_allclose(time_bound(card)[0], width / np.sqrt(mean.sum(axis=0)), rtol=0.02)


@pytest.mark.parametrize(
    "changes", [{}, {"speckle": 0.2}, {"peak_e": 300.0}, {"peak_e": 30000.0}, {"ambient_e": 1000.0}]
)
def test_the_best_linear_estimate_at_the_truth_has_the_error_of_the_bound(changes):
    """On frames as they are shot, so that their noise is the one of the bound; all rows of a plain card are alike.

    13 600 pulses tell 0.6 %. Poisson's skewness and the clipped counts are worth 3 %.
    """
    card = Card(rows=800, **changes)
    counts = (card.shoot(5).astype(float) - card.camera.black_dn) * card.camera.gain_e_per_dn
    one, step = replace(card, rows=1), 1e-3
    clean = one.electrons()[:, 0]
    by_time = (one.electrons(-step) - one.electrons(step))[:, 0] / (2 * step)
    normalised, variances = [], []
    for pixel in np.flatnonzero(card.looked_at):
        mean = clean[:, pixel]
        kept = mean + card.ambient_e < card.camera.full_e
        slopes = np.stack([by_time[:, pixel], mean, np.ones_like(mean)])[:, kept]
        shared = card.speckle**2 * card.correlation()[np.ix_(kept, kept)]
        inverse = np.linalg.inv(noise_covariance(card, mean[kept], shared))
        covariance = np.linalg.inv(slopes @ inverse @ slopes.T)
        off = counts[kept, :, pixel] - mean[kept, None] - card.ambient_e
        normalised.append((covariance @ slopes @ inverse @ off)[0] / np.sqrt(covariance[0, 0]))
        variances.append(covariance[0, 0])
    assert np.sqrt(np.mean(np.square(normalised))) == pytest.approx(1, abs=0.04)
    linear_m = np.sqrt(np.mean(variances)) * card.advance_m / np.tan(card.angle_rad)
    assert 0.94 * linear_m < range_bound_m(card) <= linear_m * 1.001  # the noise itself tells of the signal, too


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
def test_peers_are_right_where_nothing_is_in_their_way(peer):
    """A plain card, finely swept, without noise: to a tenth of a frame or pixel, the highest sample to half a frame."""
    card = Card(rows=4, peak_e=14000.0, advance_m=0.0006)
    frames = card.camera.without_noise(card.electrons() + card.ambient_e)
    about = (card.sigma_m / np.cos(card.angle_rad) / card.advance_m, card.trace_m / card.pixel_m)
    errors = steps._errors(card, peer.find(frames, about), peer.in_space)
    unit_m = (card.pixel_m if peer.in_space else card.advance_m) / np.tan(card.angle_rad)
    assert np.isfinite(errors).all()
    assert np.abs(errors).max() < (0.51 if peer.name == "argmax" else 0.1) * unit_m


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
def test_peers_take_frames_without_a_stripe(peer):
    """No exception, no warning; what has a threshold says that there is nothing."""
    card = Card(rows=4, peak_e=0.0)
    found = peer.find(card.shoot(1), (1.0, 2.0))
    assert found.shape == ((len(card.times), 4) if peer.in_space else (4, len(card.x_m)))


def test_ours_is_at_the_bound_on_a_plain_card_and_best_of_those_in_time():
    """816 pulses tell an RMS to 2.5 %."""
    card = Card(rows=48)
    rows = {row["method"]: row for row in steps.compare(card, seed=3)}
    assert rows["ours"]["error"] < 1.1 * range_bound_m(card) * 1e6
    assert rows["ours says"]["error"] == pytest.approx(rows["ours"]["error"], rel=0.1)
    in_time = [row["error"] for peer in PEERS if not peer.in_space for row in [rows[peer.name]]]
    assert rows["ours"]["error"] <= min(in_time)


def test_at_an_edge_of_reflectance_space_fails_and_time_does_not():
    """On one card without an edge the centroid of a row is as good; at 10:1 time leaves 15 % of its error at most."""
    assert steps.step_error_reduction(rows=48) > 0.85
    rows = {row["method"]: row["error"] for row in steps.compare(steps.edge(10.0, rows=48), seed=3)}
    assert rows["ours"] < 0.1 * min(rows["row centroid"], rows["row ridge"])


def test_over_a_plate_space_is_as_good_as_time_over_a_relief_it_is_not():
    """So the row methods' geometry is right: a fifth of a pixel is 100 um. They see one surface, not many."""
    plate, relief = ({row["method"]: row for row in steps.relief_rows(s, "small")} for s in ("white", "brick"))
    assert max(plate["row centroid"]["error"], plate["row ridge"]["error"]) < 100
    assert plate["ours"]["error"] < 2 * plate["ours says"]["error"]
    assert relief["ours"]["error"] < min(relief["row centroid"]["error"], relief["row ridge"]["error"]) / 4
    assert relief["ours"]["error"] < 1.3 * relief["ours says"]["error"]
    assert relief["ours"]["error"] < relief["argmax"]["error"] / 4


def test_rows_are_json_with_sorted_errors():
    card = Card(rows=8, echo=0.8)  # ours measures nothing here
    rows = json.loads(json.dumps(steps.compare(card, seed=1)))
    assert {row["method"] for row in rows} == {method.name for method in steps.METHODS} | {"ours says"}
    for row in rows:
        assert 0 <= row["measured"] <= 1
        assert row["seconds"] > 0 or row.get("reference")
        if row["error"] is not None:
            assert row["median"] <= row["p95"] <= row["largest"]
            assert row["error"] <= row["largest"]


@pytest.mark.parametrize("width", pulses.WIDTHS)
def test_the_bound_of_bright_pulses_is_the_closed_one(width):
    """Width over the root of the number of photo-electrons; background and read noise take two percent."""
    many = np.sqrt(2 * np.pi) * width * 14000.0
    found = pulses.bound(np.linspace(29, 31, 50), width, 14000.0)
    np.testing.assert_allclose(np.sqrt(np.mean(found**2)), width / np.sqrt(many), rtol=0.03)


@pytest.mark.parametrize("height_e", [1000.0, pulses.CLIPPED * pulses.SENSOR.saturation_e])
def test_pulses_are_timed_at_the_bound_and_by_no_other_better(height_e):
    """4000 pulses tell an RMS to 1.1 %."""
    ours, *peers = pulses.compare(1.5, height_e, 4000)
    assert ours["measured"] > 0.998
    assert 0.95 < ours["error"] < 1.06
    assert 0.95 < ours["over_its_sigma"] < 1.06
    assert ours["outliers"] == 0
    assert all(peer["error"] > ours["error"] for peer in peers)


@pytest.mark.long
def test_the_short_form_has_every_figure():
    result = laser.run(quick=True)
    assert result.figures.keys() >= FIGURES
    assert all(np.isfinite(value) for value in result.figures.values())
    assert json.loads(json.dumps([dict(row) for row in result.rows])) == [dict(row) for row in result.rows]
