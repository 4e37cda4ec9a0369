"""Binary functions over the leaves as the ascending positions at which they change; they begin visible.

Each stands for exactly one lossless cut, whose nodes are merged only from equal children: the aligned pieces of the
runs between the changes.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from processing.lighting.cuts import Cuts, trailing_zeros
from processing.lighting.rays import Bool

UInt8 = NDArray[np.uint8]
UInt16 = NDArray[np.uint16]
Int64 = NDArray[np.int64]


def toggles_of(visible: Bool) -> UInt16:
    """Positions at which a function (2^height,) of the leaves changes."""
    return np.flatnonzero(np.diff(np.concatenate([[True], visible]).astype(np.int8))).astype(np.uint16)


def visible_leaves(toggles: UInt16, height: int) -> Bool:
    """The function (2^height,) that changes at these positions."""
    changed = np.zeros(1 << height, np.int64)
    changed[toggles] = 1
    return np.asarray(np.cumsum(changed) % 2 == 0)


def binary_cuts(first: Int64, toggles: UInt16, height: int) -> Cuts:
    """The lossless cuts of functions i, whose changes are `toggles[first[i] : first[i + 1]]`; values are 0 and 1."""
    sizes = node_counts(first, toggles, height)
    ends = np.concatenate([[0], np.cumsum(sizes)])
    heights, values = np.empty(ends[-1], np.uint8), np.empty(ends[-1], np.float32)
    _write_cuts(first, toggles, height, ends, heights, values)
    return Cuts(ends, heights, values)


@numba.njit(cache=True, nogil=True)
def run_height(position: int, end: int, height: int) -> int:
    """Height of the highest node that begins at this leaf and does not pass the end."""
    found = height if position == 0 else trailing_zeros(position)
    while 1 << found > end - position:
        found -= 1
    return found


@numba.njit(cache=True, nogil=True)
def node_counts(first: Int64, toggles: UInt16, height: int) -> Int64:
    """Nodes (n,) of the lossless cut of each of n functions."""
    sizes = np.zeros(len(first) - 1, np.int64)
    for i in range(len(sizes)):
        position, k = 0, first[i]
        while position < 1 << height:
            end = toggles[k] if k < first[i + 1] else 1 << height
            k += 1
            while position < end:
                position += 1 << run_height(position, end, height)
                sizes[i] += 1
    return sizes


@numba.njit(cache=True, nogil=True)
def _write_cuts(first: Int64, toggles: UInt16, height: int, ends: Int64, heights: UInt8, values: UInt8) -> None:
    for i in range(len(first) - 1):
        position, k, node, visible = 0, first[i], ends[i], 1
        while position < 1 << height:
            end = toggles[k] if k < first[i + 1] else 1 << height
            k += 1
            while position < end:
                heights[node] = run_height(position, end, height)
                values[node] = visible
                position += 1 << heights[node]
                node += 1
            visible = 1 - visible
