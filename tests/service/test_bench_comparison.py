"""The comparison of representations of materials, on a small sphere."""

import numpy as np
import pytest

from processing.products import ResidualBasis
from tests.benchmarks.srfs.comparison import compare
from tests.benchmarks.yardsticks.material_methods import eight_methods
from tests.benchmarks.yardsticks.material_samples import arm_sphere


@pytest.fixture(scope="module")
def rows():
    return compare(arm_sphere("stone", 12, 3))


def test_every_method_answers_at_measured_and_at_held_out_directions(rows):
    expected = [(which, method) for which in ("measured", "held-out") for method in eight_methods(ResidualBasis.HALF)]
    assert [(row["directions"], row["method"]) for row in rows] == expected
    for row in rows:
        assert np.isfinite([row["mse"], row["psnr_db"], row["relative_mse"], row["over_phong"]]).all()
        assert 0 < row["flip"] < 1


def test_what_stores_more_of_a_varied_stone_comes_nearer_to_it(rows):
    """The stone's colour varies, so even at lights that were left out a residual helps the lobe, and FLIP sees it."""
    found = {(row["directions"], row["method"]): row for row in rows}
    for which in ("measured", "held-out"):
        for key in ("mse", "flip"):
            errors = [found[which, method][key] for method in ("constant", "Phong", "SRF, joint lobe")]
            assert errors == sorted(errors, reverse=True)
    assert found["measured", "SRF, best basis"]["mse"] <= found["measured", "SRF, joint lobe"]["mse"]
