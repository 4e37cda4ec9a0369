"""The paper's operation on cuts (Iwasaki et al., V.A.3, Steps 1 to 4): counters tell which nodes belong together.

As printed it stops when all pointers point to the last nodes, before these are operated on; here it goes on until they
are passed. Each step operates on one node of every cut.
"""

import numba
import numpy as np


@numba.njit(nogil=True)
def merged(heights, values, first, last, group, weight, found_height, found_value):
    """The product over groups of the weighted means within each; returns the number of nodes written.

    Cut j has nodes `first[j]` to `last[j]` of `heights` and `values`. Its `group[j]` ascends from 0, each group's
    weights sum to 1.
    """
    cuts = len(first)
    pointer, counter = first.copy(), np.zeros(cuts, np.int64)
    nodes = 0
    while pointer[0] < last[0]:
        lowest = 99
        for j in range(cuts):
            lowest = min(lowest, heights[pointer[j]])
        product, mean = 1.0, 0.0
        for j in range(cuts):
            mean += weight[j] * values[pointer[j]]
            if j + 1 == cuts or group[j + 1] != group[j]:
                product *= mean
                mean = 0.0
        found_height[nodes], found_value[nodes] = lowest, product
        nodes += 1
        for j in range(cuts):
            if heights[pointer[j]] == lowest:
                pointer[j] += 1
                counter[j] = 0
            else:
                counter[j] += 1 << lowest
                if counter[j] >= 1 << heights[pointer[j]]:
                    pointer[j] += 1
                    counter[j] = 0
    return nodes


@numba.njit(nogil=True)
def merged_light(heights, values, first, last, group, weight, sums):
    """Light (3,) of one vertex: the merge, then the sum over its nodes; `sums` (leaves + 1, 4) before each leaf."""
    found_height, found_value = np.empty(len(sums), np.uint8), np.empty(len(sums))
    nodes = merged(heights, values, first, last, group, weight, found_height, found_value)
    total, leaf = np.zeros(3), 0
    for node in range(nodes):
        after = leaf + (1 << found_height[node])
        for channel in range(3):
            total[channel] += found_value[node] * (sums[after, channel] - sums[leaf, channel])
        leaf = after
    return total
