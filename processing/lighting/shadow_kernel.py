"""Shadows of bodies on vertices, added up leaf by leaf: of each body its field's function or the vertex's own list."""

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from processing.lighting.rays import Bool
from processing.lighting.shells import find_cell
from processing.products.arrays import Float32, Float64, Int32

UInt16 = NDArray[np.uint16]
UInt64 = NDArray[np.uint64]
Int64 = NDArray[np.int64]

WEIGHT_STEPS = 65536  # weights are multiples of 2^-16, so that sums of eight of them are exact in float32
NOTHING, FIELD = -1, -2
_MET, _ANY = 8, 65535


class Slot(NamedTuple):
    """A body that throws shadows: its field's sample points (see `Shells`, `VisibilityField`), and changes of
    visibility at vertices themselves, `lists`. What a body does not have is empty."""

    radii: Float64
    neighbours: Int32
    sealed: Bool
    first: Int64
    toggles: UInt16
    lists: UInt16


class Shadows(NamedTuple):
    """What hides the light of vertices (n,): `slots` are bodies.

    `begin` and `end` (n, slots) are of the vertex's list in the slot, or `begin` is FIELD or NOTHING. Fields are asked
    at `places` (n, 3), less `middle` (slots, 3), times `turn` (slots, 3, 3). `leaf[slot]`, where `turned[slot]`, tells
    which of the field's leaves each of the vertex's is, and `met[slot]` which runs of them (see `runs_met`).
    """

    begin: Int64
    end: Int64
    places: Float64
    middle: Float64
    turn: Float64
    turned: Bool
    leaf: UInt16
    met: UInt16
    slots: list[Slot]


class Scratch(NamedTuple):
    """Room for one thread: `change` (bodies, leaves), `marks` (bits of leaves), `function` (leaves) and `bent` (runs)
    are zeros between two vertices."""

    change: Float32
    function: Float32
    bent: Bool
    level: Float32
    marks: UInt64
    now: Float32
    place: Float64
    corner: Int32
    weight: Float32


@numba.njit(nogil=True, cache=True)
def scratch_for(shadows: Shadows, leaves: int) -> Scratch:
    """Room for the slots of shadows."""
    bodies = shadows.begin.shape[1]
    change, function = np.zeros((bodies, leaves), np.float32), np.zeros(leaves, np.float32)
    bent, level = np.zeros(leaves // _run(leaves), np.bool_), np.empty(leaves // _run(leaves), np.float32)
    marks, now = np.zeros((leaves + 63) // 64, np.uint64), np.empty(bodies, np.float32)
    cell = np.empty(3), np.empty(8, np.int32), np.empty(8, np.float32)
    return Scratch(change, function, bent, level, marks, now, *cell)


@numba.njit(nogil=True, cache=True)
def mark(marks: UInt64, leaf: int) -> None:
    """Set the bit of a leaf."""
    marks[leaf >> 6] |= np.uint64(1) << np.uint64(leaf & 63)


@numba.njit(nogil=True, cache=True)
def mark_shadows(i: int, shadows: Shadows, scratch: Scratch) -> int:
    """Add the changes of the bodies that matter to vertex i, a row of `change` for each, and return how many."""
    active = 0
    for k in range(shadows.begin.shape[1]):
        begin = shadows.begin[i, k]
        if begin >= 0:
            slot, row, weight = shadows.slots[k], scratch.change[active], np.float32(1)
            for at in range(begin, shadows.end[i, k]):
                weight = -weight
                row[slot.lists[at]] = weight
                mark(scratch.marks, slot.lists[at])
            active += 1
        elif begin == FIELD:
            _mark_field(i, k, shadows, scratch, scratch.change[active])
            active += 1
    return active


@numba.njit(nogil=True, cache=True)
def _mark_field(i: int, k: int, shadows: Shadows, scratch: Scratch, change: Float32) -> None:
    slot, place, index, weight = shadows.slots[k], scratch.place, scratch.corner, scratch.weight
    for axis in range(3):
        place[axis] = 0
        for other in range(3):
            place[axis] += (shadows.places[i, other] - shadows.middle[k, other]) * shadows.turn[k, other, axis]
    find_cell(place, slot.radii, slot.neighbours, slot.sealed, index, weight)
    round_weights(weight)
    turned, run = shadows.turned[k], _run(len(change))
    row = scratch.function if turned else change
    for corner in range(8):
        share = weight[corner]
        if share == 0:
            continue
        for at in range(slot.first[index[corner]], slot.first[index[corner] + 1]):
            share = -share
            row[slot.toggles[at]] += share
            if turned:
                scratch.bent[slot.toggles[at] // run] = True
            else:
                mark(scratch.marks, slot.toggles[at])
    if turned:
        _sum_up(scratch)
        _turned(scratch, shadows.leaf[k], shadows.met[k], change)


@numba.njit(nogil=True, cache=True)
def round_weights(weight: Float32) -> None:
    """Make weights (8,) that sum to 1 or 0 multiples of 2^-16 with the same sum, so that what all see is exactly 1."""
    most, total, rounded = 0, np.float32(0), np.float32(0)
    for corner in range(8):
        total += weight[corner]
        weight[corner] = np.rint(weight[corner] * np.float32(WEIGHT_STEPS))
        rounded += weight[corner]
        if weight[corner] > weight[most]:
            most = corner
    weight[most] += np.rint(total) * np.float32(WEIGHT_STEPS) - rounded
    for corner in range(8):
        weight[corner] /= np.float32(WEIGHT_STEPS)


@numba.njit(nogil=True, cache=True)
def _run(leaves: int) -> int:
    """Leaves that are looked at together where frames are turned."""
    return min(leaves, 32)


@numba.njit(nogil=True, cache=True)
def runs_met(leaf: UInt16) -> UInt16:
    """Runs of a field's leaves that each run of a vertex's meets (runs, 8), by the table `leaf`; ANY where more."""
    run = _run(len(leaf))
    found = np.empty((len(leaf) // run, _MET), np.uint16)
    for i in range(len(found)):
        count = 0
        for k in range(i * run, (i + 1) * run):
            met = leaf[k] // run
            known = False
            for j in range(min(count, _MET)):
                known |= found[i, j] == met
            if not known:
                if count < _MET:
                    found[i, count] = met
                count += 1
        found[i, min(count, _MET) :] = found[i, 0]
        if count > _MET:
            found[i, 0] = _ANY
    return found


@numba.njit(nogil=True, cache=True)
def _sum_up(scratch: Scratch) -> None:
    """Turn changes into the function, in runs where it bends; what it is elsewhere, or at a run's end, is `level`."""
    function, value, run = scratch.function, np.float32(1), _run(len(scratch.function))
    for i in range(len(scratch.bent)):
        for k in range(i * run, (i + 1) * run if scratch.bent[i] else 0):
            value += function[k]
            function[k] = value
        scratch.level[i] = value


@numba.njit(nogil=True, cache=True)
def _turned(scratch: Scratch, leaf: UInt16, met: UInt16, change: Float32) -> None:
    """Changes of a field in another frame than the vertex's: where its function bends, it is asked leaf by leaf."""
    function, bent, level, run = scratch.function, scratch.bent, scratch.level, _run(len(leaf))
    before = np.float32(1)
    for i in range(len(met)):
        value = level[met[i, 0]] if met[i, 0] != _ANY else np.float32(0)
        even = met[i, 0] != _ANY
        for j in range(_MET if even else 0):
            even &= not bent[met[i, j]] and level[met[i, j]] == value
        for k in range(i * run, i * run + 1 if even else (i + 1) * run):
            if not even:
                value = function[leaf[k]] if bent[leaf[k] // run] else level[leaf[k] // run]
            if value != before:
                change[k] = value - before
                mark(scratch.marks, k)
                before = value
    for i in range(len(bent)):
        if bent[i]:
            function[i * run : (i + 1) * run] = 0
            bent[i] = False
