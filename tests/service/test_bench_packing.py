"""The benchmark of packing on few texels: sizes of the layouts, and k-means at least as good as its peers."""

import numpy as np
import pytest

from tests.benchmarks.sbrdfs import packing
from tests.benchmarks.yardsticks.btf_samples import quick_directions, ray_traced


@pytest.fixture(scope="module")
def weave():
    directions = quick_directions()
    return ray_traced("weave", 24, 2, directions, directions[[0, 8, 12, 16]])


def test_sizes_are_those_of_the_layouts():
    sizes = {(row["method"], row["size"]): row["bytes"] for row in packing._sizes()}
    assert sizes["SBRDF+, 16 floats", "64 x 64 x 81 x 81"] == 1024 * 512 * 4 + 64 * 64 * 16 * 4
    assert sizes["SBRDF+, 24 floats", "64 x 64 x 81 x 81"] == 1024 * 512 * 4 + 64 * 64 * 24 * 4


def test_k_means_leaves_no_more_than_its_peers(weave):
    """All are near the same optimum: within a tenth of each other's squared error."""
    rows = list(packing._clusters(weave))
    for count in {row["value"] for row in rows}:
        inertia = {row["method"]: row["inertia"] for row in rows if row["value"] == count}
        assert inertia.pop("k-means") <= 1.1 * min(inertia.values())


def test_more_centres_leave_less_error(weave):
    ours = [row for row in packing._clusters(weave) if row["method"] == "k-means"]
    assert (np.diff([row["error"] for row in ours]) < 0).all()


def test_eight_bits_cost_little_and_packing_codes_as_it_says(weave):
    """The texture and the formula differ by the eleven bits of the scale."""
    added = {row["method"]: row["error"] for row in packing._codes(weave)}
    assert abs(added["centres, packed"]) < 0.01
    assert added["centres, packed"] == pytest.approx(added["centres, cube root"], abs=1e-4)
