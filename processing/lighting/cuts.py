"""Cuts: step functions over the leaves of the tree of directions, whose steps are nodes of the tree.

A cut has exactly one node on every path from the root to a leaf. Its nodes, from left to right, are told by their
heights alone: where one ends the next begins. Source: Akerlund et al. 2007; Iwasaki et al., V.A.
"""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32, Float64

UInt8 = NDArray[np.uint8]
UInt16 = NDArray[np.uint16]
Int64 = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Cuts:
    """n cuts one after another: nodes `first[i]` to `first[i + 1]` are those of cut i, from left to right.

    `heights` (nodes,) uint8 and `values` (nodes,) float32.
    """

    first: Int64
    heights: UInt8
    values: Float32

    def __len__(self) -> int:
        return len(self.first) - 1

    @property
    def mean_size(self) -> float:
        """Nodes of a cut, on average."""
        return float(len(self.heights) / max(len(self), 1))

    def leaves(self, number: int) -> Float32:
        """The step function of one cut, a value for every leaf."""
        part = slice(self.first[number], self.first[number + 1])
        return np.repeat(self.values[part], 1 << self.heights[part].astype(np.int64))


@numba.njit(cache=True, nogil=True)
def add_cut(leaves: Float32, weights: Float64, tolerance: float, heights: UInt8, values: Float32) -> int:
    """Write the cut of highest nodes whose clustering error is within the tolerance, and return their number.

    The error of a node is the root of the weighted sum of squares by which its leaves (2^h,) differ from their weighted
    mean, which becomes its value: what the node's light can be wrong by. `heights` and `values` have room for all
    leaves. NaN leaves stay leaves.
    """
    count = len(leaves)
    top = 0
    while 1 << top < count:
        top += 1
    # Node k of height h is number 2^(top - h) + k: the root is 1, children of i are 2 i and 2 i + 1.
    weight, mean, squares = np.empty(2 * count), np.empty(2 * count), np.empty(2 * count)
    for leaf in range(count):
        weight[count + leaf], mean[count + leaf], squares[count + leaf] = weights[leaf], leaves[leaf], 0.0
    for node in range(count - 1, 0, -1):
        one, two = 2 * node, 2 * node + 1
        w = weight[one] + weight[two]
        apart = mean[two] - mean[one]
        share = weight[two] / w
        weight[node] = w
        mean[node] = mean[one] + share * apart
        squares[node] = squares[one] + squares[two] + apart * apart * share * weight[one]
    limit = tolerance * tolerance
    nodes, leaf = 0, 0
    while leaf < count:
        height = top if leaf == 0 else min(top, trailing_zeros(leaf))
        node = (1 << (top - height)) + (leaf >> height)
        while height > 0 and not squares[node] <= limit:
            node *= 2
            height -= 1
        heights[nodes], values[nodes] = height, mean[node]
        nodes += 1
        leaf += 1 << height
    return nodes


@numba.njit(cache=True, nogil=True)
def trailing_zeros(number: int) -> int:
    """Zeros at the end of a whole number that is not 0."""
    zeros = 0
    while number & 1 == 0:
        number >>= 1
        zeros += 1
    return zeros
