"""Light that reaches vertices past their own body and others, and leaves them toward the eye: everything found anew.

Visibility is a step function over the leaves: the steps of the vertex's own cut times, for each other body, the mean of
the functions of the eight sample points around. Changes of all of them are marked in a bit for each leaf and their
weights added where they are; a walk over the bits carries the product along. The result is the sum over all leaves, as
exact as the paper's merge of cuts, without its counters.
"""

from typing import Any, NamedTuple

import numba
import numpy as np
from numba.cpython.unsafe.numbers import trailing_zeros
from numpy.typing import NDArray

from processing.lighting.lobe_nodes import Nodes, Surface, room_for_nodes, write_nodes
from processing.lighting.shadow_kernel import Scratch, Shadows, mark, mark_shadows, scratch_for
from processing.products.arrays import Float32, Float64

UInt16 = NDArray[np.uint16]
UInt64 = NDArray[np.uint64]
Int64 = NDArray[np.int64]

_first_bit: Any = trailing_zeros  # an intrinsic of numba's, which only compiled code calls

_TOLERANCE = 0.004  # of the clustering of products that are kept: half of that of the cuts themselves


class Steps(NamedTuple):
    """Step functions of vertices: the value from leaf `start[k]` on is `value[k]`, k from `begin[i]` to `end[i]`.

    The first step of each begins at leaf 0.
    """

    begin: Int64
    end: Int64
    start: UInt16
    value: Float32


@numba.njit(nogil=True, cache=True)
def moving_frame(steps: Steps, shadows: Shadows, surface: Surface, sums: Float64, radiance: Float32) -> None:
    """Write the radiance (n, 3) of vertices; `sums` (leaves + 1, 4) are the light's before each leaf."""
    leaves = len(sums) - 1
    scratch = scratch_for(shadows, leaves)
    nodes = room_for_nodes(leaves, surface.heights)
    for i in range(len(radiance)):
        active = mark_shadows(i, shadows, scratch)
        for k in range(write_nodes(surface, i, nodes)):
            mark(scratch.marks, nodes.start[k])
        for k in range(steps.begin[i], steps.end[i]):
            mark(scratch.marks, steps.start[k])
        scratch.now[:active] = 1
        _walk(steps, i, scratch, active, sums, nodes, radiance[i])


@numba.njit(nogil=True, cache=True)
def merged_steps(steps: Steps, shadows: Shadows, leaves: int) -> Steps:
    """The whole product as steps; neighbours of nearly one value are one."""
    scratch = scratch_for(shadows, leaves)
    count = len(steps.begin)
    first = np.zeros(count + 1, np.int64)
    start, value = np.empty(count * 1024 + leaves, np.uint16), np.empty(count * 1024 + leaves, np.float32)
    for i in range(count):
        if first[i] + leaves > len(start):
            start, value = _longer(start, leaves), _longer(value, leaves)
        active = mark_shadows(i, shadows, scratch)
        for k in range(steps.begin[i], steps.end[i]):
            mark(scratch.marks, steps.start[k])
        scratch.now[:active] = 1
        first[i + 1] = first[i] + _keep(steps, i, scratch, active, start[first[i] :], value[first[i] :])
    return Steps(first[:-1], first[1:], start[: first[count]].copy(), value[: first[count]].copy())


@numba.njit(nogil=True, cache=True)
def _longer(array: NDArray[Any], room: int) -> NDArray[Any]:
    found = np.empty(2 * len(array) + room, array.dtype)
    found[: len(array)] = array
    return found


@numba.njit(nogil=True, cache=True)
def _walk(  # noqa: PLR0913 - what one vertex needs, packed as far as it is one thing
    steps: Steps, i: int, scratch: Scratch, active: int, sums: Float64, nodes: Nodes, radiance: Float32
) -> None:
    """Add up visibility times light times reflectance over the marked leaves, and clear what was marked."""
    marks, now, node_start, node_f = scratch.marks, scratch.now[:active], nodes.start, nodes.value
    total = np.zeros(3)
    part = np.zeros(3)
    last, value, own, node = np.int64(0), np.float32(0), np.float32(0), 0
    k, end = steps.begin[i], steps.end[i]
    for word in range(len(marks)):
        bits = marks[word]
        if bits == 0:
            continue
        marks[word] = 0
        while bits != 0:
            leaf = np.int64((word << 6) + np.int64(_first_bit(bits)))
            bits &= bits - np.uint64(1)
            for c in range(3):
                part[c] += value * (sums[leaf, c] - sums[last, c])
            last = leaf
            if leaf == node_start[node + 1]:
                for c in range(3):
                    total[c] += part[c] * node_f[node, c]
                    part[c] = 0
                node += 1
            if k < end and steps.start[k] == leaf:
                own = steps.value[k]
                k += 1
            value = _product(own, scratch.change, now, leaf)
    for c in range(3):
        radiance[c] = total[c] + (part[c] + value * (sums[len(sums) - 1, c] - sums[last, c])) * node_f[node, c]


@numba.njit(nogil=True, cache=True)
def _product(own: np.float32, change: Float32, now: Float32, leaf: np.int64) -> np.float32:
    value = own
    for body in range(len(now)):
        now[body] += change[body, leaf]
        change[body, leaf] = 0
        value *= now[body]
    return value


@numba.njit(nogil=True, cache=True)
def _keep(steps: Steps, i: int, scratch: Scratch, active: int, start: UInt16, value: Float32) -> int:
    """Write the steps of the product, clear what was marked, and return how many they are.

    Neighbours become one, their mean, as long as their clustering error is within the tolerance (see `cuts.add_cut`).
    """
    marks, now, at = scratch.marks, scratch.now[:active], -1
    leaves = 64 * len(marks)
    limit = _TOLERANCE * _TOLERANCE * leaves / (4 * np.pi)
    own, found, last = np.float32(0), np.float32(0), np.int64(0)
    weight, mean, squares = 0.0, 0.0, 0.0
    k, end = steps.begin[i], steps.end[i]
    for word in range(len(marks) + 1):
        bits = marks[word] if word < len(marks) else np.uint64(1)  # the end closes the last run
        if bits == 0:
            continue
        if word < len(marks):
            marks[word] = 0
        while bits != 0:
            leaf = np.int64((word << 6) + np.int64(_first_bit(bits)))
            bits &= bits - np.uint64(1)
            if leaf > last:
                width, apart = np.float64(leaf - last), found - mean
                more = apart * apart * weight * width / (weight + width)
                if at < 0 or squares + more > limit:
                    at += 1
                    start[at] = last
                    weight, mean, squares = width, np.float64(found), 0.0
                else:
                    weight += width
                    mean += apart * width / weight
                    squares += more
                value[at] = mean
            if word == len(marks):
                break
            last = leaf
            if k < end and steps.start[k] == leaf:
                own = steps.value[k]
                k += 1
            found = _product(own, scratch.change, now, leaf)
    return at + 1
