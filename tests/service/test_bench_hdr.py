"""The HDR benchmark at a small size, with every peer that is installed here."""

import warnings

import numpy as np
import pytest

from tests.benchmarks import hdr
from tests.benchmarks.yardsticks.hdr_peers import PEERS
from tests.benchmarks.yardsticks.hdr_stack import EXPOSURE_S, SENSOR, bound_e_s, ramp

STACKS = 6  # of 192x192: 221 000 pixels know an RMS to 0.15 %, one of 64 groups to 1.2 %


@pytest.fixture(scope="module")
def compared():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what peers warn about is theirs
        return hdr.compare((192, 192), ours=STACKS, peers=STACKS)


def test_our_merge_is_at_the_bound(compared):
    ours = compared[0]["ours"]
    assert ours.rmse_over_crb == pytest.approx(1, abs=0.012)
    assert ours.group_rmse.max() < 1.15
    assert ours.bias_bright < 0.005
    assert ours.variance_ratio == pytest.approx(1, abs=0.02)
    assert ours.finite.sum() == ours.pixels == STACKS * 192 * 192


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
def test_every_peer_takes_the_stack_and_gives_radiance(compared, peer):
    """Each is unbiased in the middle, where nothing clips, and above the bound or biased at the ends."""
    if peer.missing():
        pytest.skip(peer.missing())
    found = compared[0][peer.name]
    middle = (found.radiance > 1e3) & (found.radiance < 1e5)
    assert abs(found.shifts[middle].sum() / found.finite[middle].sum()) < 0.005
    assert found.rmse_over_crb > 1.005 or found.bias_dark > 0.02
    assert found.group_rmse.max() > compared[0]["ours"].group_rmse.max()


def test_every_row_says_what_was_set_and_how_it_did(compared):
    _, seconds, rows = compared
    measured = {row["method"]: row for row in rows if "missing" not in row}
    assert measured.keys() == seconds.keys()
    for row in measured.values():
        assert row["settings"]
        assert row["bound"] == 1
        assert row["seconds"] > 0
        for low, median, high in row["relative_error_percentiles_5_50_95"].values():
            assert low < median < high


def test_figures_carry_their_sampling_error(compared):
    ours = compared[0]["ours"]
    figures, deviations = hdr.accuracy_figures(ours), hdr.sampling_errors(ours)
    assert deviations.keys() == figures.keys()
    assert figures["rmse_over_crb_all"] == pytest.approx(1, abs=5 * deviations["rmse_over_crb_all"] + 0.01)


def test_the_bound_is_the_gaussian_one_where_counts_are_many():
    """Without rounding, clipping and Poisson's skewness: 1 / sum of t^2 / (r t + read variance), within 0.1 %."""
    radiance = ramp(64)
    away = np.abs(np.log(np.outer(EXPOSURE_S, radiance) / SENSOR.saturation_e)).min(axis=0) > 0.1
    some = away & (radiance > 50)
    exposed = np.outer(EXPOSURE_S, radiance[some])
    information = EXPOSURE_S[:, None] ** 2 / (exposed + SENSOR.dark_variance_e2) * (exposed < SENSOR.saturation_e)
    np.testing.assert_allclose(bound_e_s(radiance[some]), information.sum(axis=0) ** -0.5, rtol=1e-3)


def test_the_merge_that_reads_in_part_is_as_accurate():
    """A tenth of a standard deviation is half a percent of error."""
    row = hdr.read_in_part((320, 640), stacks=3)
    assert 0.5 < row["read_ratio"] < 0.95
    assert row["error"] < 1.005 + 3 / np.sqrt(2 * 3 * 320 * 640) + 0.005
