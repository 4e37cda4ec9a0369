"""Cuts in plain NumPy: the slow twins of `processing.lighting`'s kernels."""

import numpy as np


def cut(leaves, weights, tolerance):
    """Heights and values of the highest nodes whose root of the weighted sum of squares is within the tolerance."""
    height = len(leaves).bit_length() - 1
    values, weights = np.asarray(leaves, np.float64), np.asarray(weights, np.float64)
    mean = np.average(values, weights=weights)
    if height == 0 or np.sum(weights * (values - mean) ** 2) <= tolerance**2:
        return [(height, mean)]
    half = len(leaves) // 2
    return cut(leaves[:half], weights[:half], tolerance) + cut(leaves[half:], weights[half:], tolerance)


def binary_cut(leaves):
    """Heights and values of the highest nodes whose leaves are all equal."""
    if (leaves == leaves[0]).all():
        return [(len(leaves).bit_length() - 1, bool(leaves[0]))]
    half = len(leaves) // 2
    return binary_cut(leaves[:half]) + binary_cut(leaves[half:])


def preorder(leaves, value_known=False):
    """Bits of the lossless cut from the root down, without those that are known: leaves have no children, and the right
    one of two nodes of the cut has the other value than the left one."""
    if (leaves == leaves[0]).all():
        ends = [] if len(leaves) == 1 else [0]
        return ends if value_known else [*ends, int(leaves[0])]
    half = len(leaves) // 2
    left_is_node = bool((leaves[:half] == leaves[0]).all())
    right_is_node = bool((leaves[half:] == leaves[half]).all())
    return [1, *preorder(leaves[:half]), *preorder(leaves[half:], left_is_node and right_is_node)]
