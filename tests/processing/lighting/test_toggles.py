"""Changes over the leaves: the same function forth and back, and its lossless cut by the highest nodes."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from processing.lighting.toggles import binary_cuts, toggles_of, visible_leaves
from tests.reference import cuts as slow

functions = st.integers(0, 8).flatmap(
    lambda height: st.lists(arrays(np.bool_, 1 << height, elements=st.booleans(), fill=st.booleans()), max_size=5)
)


@settings(deadline=None)
@given(functions)
def test_changes_are_the_function_and_cuts_their_slow_twin(leaves):
    toggles = [toggles_of(one) for one in leaves]
    height = len(leaves[0]).bit_length() - 1 if leaves else 3
    for one, changes in zip(leaves, toggles, strict=True):
        assert np.array_equal(visible_leaves(changes, height), one)
    first = np.concatenate([[0], np.cumsum([len(changes) for changes in toggles])]).astype(np.int64)
    cuts = binary_cuts(first, np.concatenate([*toggles, np.zeros(0, np.uint16)]), height)
    assert len(cuts) == len(leaves)
    for i, one in enumerate(leaves):
        assert np.array_equal(cuts.leaves(i).astype(bool), one)
        twin = slow.binary_cut(one)
        assert cuts.heights[cuts.first[i] : cuts.first[i + 1]].tolist() == [height for height, _ in twin]


def test_all_leaves_of_the_full_tree_can_change():
    """Positions to 2^15 fit in two bytes, and the last leaf is one."""
    alternating = np.arange(1 << 15) % 2 == 1
    toggles = toggles_of(alternating)
    assert toggles.dtype == np.uint16
    assert len(toggles) == 1 << 15
    assert np.array_equal(visible_leaves(toggles, 15), alternating)
    assert len(binary_cuts(np.array([0, 1 << 15]), toggles, 15).heights) == 1 << 15
