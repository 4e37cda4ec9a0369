"""The paper's merge, which judges the fast kernels: it is the product of the unpacked functions."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.lighting.toggles import binary_cuts
from tests.reference.merge import merged

HEIGHT = 6


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.lists(st.integers(1, 4), min_size=1, max_size=3))
def test_it_is_the_product_of_the_means_of_leaves(seed, groups):
    rng = np.random.default_rng(seed)
    group = np.repeat(np.arange(len(groups)), groups)
    toggles = [np.sort(rng.choice(1 << HEIGHT, rng.integers(0, 9), replace=False)) for _ in group]
    first = np.concatenate([[0], np.cumsum([len(t) for t in toggles])])
    cuts = binary_cuts(first, np.concatenate(toggles).astype(np.uint16), HEIGHT)
    weight = rng.uniform(0.1, 1, len(group))
    weight /= np.bincount(group, weight)[group]
    heights, values = np.empty(1 << HEIGHT, np.uint8), np.empty(1 << HEIGHT)
    ends = cuts.first
    nodes = merged(cuts.heights, cuts.values, ends[:-1], ends[1:], group, weight, heights, values)
    expected = np.ones(1 << HEIGHT)
    for number in range(len(groups)):
        expected *= sum(weight[j] * cuts.leaves(j) for j in np.flatnonzero(group == number))
    found = np.repeat(values[:nodes], 1 << heights[:nodes].astype(int))
    assert len(found) == 1 << HEIGHT  # as printed, the last nodes would be missing
    assert np.allclose(found, expected, rtol=0, atol=1e-12)
