"""The benchmark of occlusion on a few texels: the truth scores as such, the tile repeats."""

import numpy as np
import pytest

from processing.sbrdf.flow_votes import Occlusion
from tests.benchmarks.sbrdfs import occlusion
from tests.benchmarks.yardsticks.btf_samples import quick_directions, ray_traced


@pytest.fixture(scope="module")
def scene():
    directions = quick_directions()
    return ray_traced("peanut", 16, 3, directions, directions)


def test_the_truth_has_no_error(scene):
    true = scene.truth
    found = Occlusion(np.nan_to_num(true.shift), true.hidden, true.hidden.astype(np.float32))
    row = occlusion._row(found, scene, slice(None))
    assert (row["precision"], row["recall"], row["p90"]) == (1, 1, 0)
    assert occlusion._figures([("peanut", found, found, scene)])["hidden_after_over_before"] == 1


def test_errors_go_the_short_way_around_the_tile(scene):
    true = scene.truth
    found = Occlusion(np.nan_to_num(true.shift) + 16, true.hidden, true.hidden.astype(np.float32))
    assert occlusion._errors(found, scene)[0].max() < 1e-5


def test_every_flow_has_its_row(scene, monkeypatch):
    """The fast three, under three lights."""
    monkeypatch.setattr(occlusion, "FLOW_LIGHTS", 3)
    monkeypatch.setattr(occlusion, "FLOWS", dict(list(occlusion.FLOWS.items())[:3]))
    rows = list(occlusion._by_other_flows(scene))
    assert len(rows) == 3
    assert all(0 <= row["hidden"] <= 1 for row in rows)
