"""Codes of cuts: the same cuts forth and back, in as many bits as they say."""

import zlib
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from processing.errors import ImageError
from processing.lighting import coding
from processing.lighting.cuts import Cuts
from processing.lighting.toggles import binary_cuts, toggles_of, visible_leaves
from tests.reference import cuts as slow

HEIGHT = 7


@st.composite
def functions(draw):
    """Bounds and changes of some functions: from one value everywhere to another at every leaf."""
    runs = draw(st.lists(st.lists(st.integers(0, 2**HEIGHT - 1), max_size=40, unique=True), max_size=6))
    dense = draw(st.lists(arrays(np.bool_, 2**HEIGHT, elements=st.booleans()), max_size=2))
    toggles = [np.array(sorted(run), np.uint16) for run in runs] + [toggles_of(one) for one in dense]
    first = np.concatenate([[0], np.cumsum([len(one) for one in toggles])]).astype(np.int64)
    return first, np.concatenate([*toggles, np.zeros(0, np.uint16)])


@st.composite
def valued_cuts(draw):
    """Cuts of binary functions, with other values."""
    cuts = binary_cuts(*draw(functions()), HEIGHT)
    seed = draw(st.integers(0, 2**32 - 1))
    values = np.random.default_rng(seed).choice([0, 1, 0.25, np.pi / 4], len(cuts.heights)).astype(np.float32)
    return Cuts(cuts.first, cuts.heights, values)


def same(one, two, tolerance=0.0):
    return (
        np.array_equal(one.first, two.first)
        and np.array_equal(one.heights, two.heights)
        and np.allclose(one.values, two.values, rtol=0, atol=tolerance)
    )


@settings(deadline=None, max_examples=40)
@given(functions())
def test_height_and_index_forms_come_back_in_5_and_17_bits(made):
    cuts = binary_cuts(*made, HEIGHT)
    nodes = len(cuts.heights)
    by_height, by_index = coding.height_form(cuts), coding.index_form(cuts, HEIGHT)
    assert len(by_height) == -(-5 * nodes // 8)
    assert len(by_index) == -(-17 * nodes // 8)
    assert same(coding.from_height_form(by_height, nodes, HEIGHT), cuts)
    assert same(coding.from_index_form(by_index, nodes, HEIGHT), cuts)


@settings(deadline=None, max_examples=40)
@given(functions())
def test_what_lies_on_disk_comes_back(made):
    first, toggles = made
    code = coding.toggles_to_disk(first, toggles, HEIGHT)
    back = coding.toggles_from_disk(code, len(first) - 1, HEIGHT)
    assert np.array_equal(back[0], first)
    assert np.array_equal(back[1], toggles)


@settings(deadline=None, max_examples=40)
@given(functions())
def test_preorder_bits_are_those_of_their_slow_twin(made):
    first, toggles = made
    leaves = [visible_leaves(toggles[a:b], HEIGHT) for a, b in pairwise(first)]
    assert coding._preorder(first, toggles, HEIGHT).tolist() == [bit for one in leaves for bit in slow.preorder(one)]


@settings(deadline=None, max_examples=40)
@given(functions())
def test_before_compression_there_are_at_most_three_bits_a_node(made):
    """n nodes have n - 1 parents, n ends and n values."""
    nodes = len(binary_cuts(*made, HEIGHT).heights)
    assert len(coding._preorder(*made, HEIGHT)) <= max(3 * nodes - (len(made[0]) - 1), 0)


@settings(deadline=None, max_examples=40)
@given(valued_cuts())
def test_cuts_with_values_come_back_within_half_a_step(cuts):
    step = 0.5 / coding.VALUE_STEPS + 1e-7
    code = coding.valued_height_form(cuts)
    assert len(code) == -(-len(cuts.heights) // 2) + 2 * len(cuts.heights)
    assert same(coding.from_valued_height_form(code, len(cuts.heights), HEIGHT), cuts, step)
    once = coding.cuts_from_disk(coding.cuts_to_disk(cuts, HEIGHT), HEIGHT)
    assert same(once, cuts, step)
    assert same(coding.cuts_from_disk(coding.cuts_to_disk(once, HEIGHT), HEIGHT), once)


def test_node_numbers_are_those_of_a_heap():
    """The root is 1; of a tree of height 2, its leaves are 4 to 7."""
    assert coding.node_numbers(np.array([2, 1, 0, 0, 0, 0, 1], np.uint8), 2).tolist() == [1, 2, 6, 7, 4, 5, 3]


def test_the_full_tree_of_2_to_the_15_leaves_fits():
    alternating = np.arange(1 << 15, dtype=np.int64).astype(np.uint16)
    first = np.array([0, 1 << 15])
    cuts = binary_cuts(first, alternating, 15)
    assert same(coding.from_index_form(coding.index_form(cuts, 15), 1 << 15, 15), cuts)
    assert np.array_equal(
        coding.toggles_from_disk(coding.toggles_to_disk(first, alternating, 15), 1, 15)[1], alternating
    )


def test_damaged_codes_are_told():
    first, toggles = np.array([0, 3, 5]), np.array([1, 5, 9, 0, 64], np.uint16)
    cuts = binary_cuts(first, toggles, HEIGHT)
    code = coding.toggles_to_disk(first, toggles, HEIGHT)
    with pytest.raises(ImageError, match="damaged"):
        coding.toggles_from_disk(code[:-3], 2, HEIGHT)
    short = zlib.compress(zlib.decompress(code)[:2])
    with pytest.raises(ImageError, match="end after"):
        coding.toggles_from_disk(short, 2, HEIGHT)
    with pytest.raises(ImageError, match="nodes of 5 bits"):
        coding.from_height_form(coding.height_form(cuts)[:-1], len(cuts.heights), HEIGHT)
    for bad in (b"", coding.cuts_to_disk(cuts, HEIGHT)[:-2]):
        with pytest.raises(ImageError, match="damaged"):
            coding.cuts_from_disk(bad, HEIGHT)
