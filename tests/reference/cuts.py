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
