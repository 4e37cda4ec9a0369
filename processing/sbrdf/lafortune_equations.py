"""Albedos, steps and costs of the Lafortune fit from the inner products of `lafortune_kernel.gram_of`.

The model is linear in the albedos: they are solved for wherever the lobes stand, and the lobes move by Gauss and
Newton's steps in what the albedos cannot follow (variable projection, Golub and Pereyra 1973, in Kaufman's form), with
Levenberg and Marquardt's damping. Parameters are three per lobe (log n and the two free components of C) and, last, the
diffuse; `slots` says which unknown each stands for: -1 where it is solved for with the albedos, the same number where
lobes share it. The two layouts differ in nothing else.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float64
from processing.sbrdf.lafortune_kernel import TILE

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

SHAPES = 3  # parameters of a lobe besides its albedo
_RIDGE = 1e-7  # of the diagonal: twin lobes share what neither determines alone
_DEAD = 1e-12  # of the diffuse's square: a lobe that no sample sees
_MOST_LOG, _MOST_AXIS = 1.2, 0.5  # of one step
_SWEEPS = 8


@numba.njit(nogil=True, cache=True)
def column_of(p: int) -> int:
    """Column of a linear coefficient (diffuse, lobes) in the Gram matrix."""
    return 3 if p == 0 else TILE * p


@numba.njit(nogil=True, cache=True)
def _slope(p: int, lobes: int) -> int:
    """Column of a parameter's slope in the Gram matrix."""
    return 3 if p == SHAPES * lobes else TILE * (1 + p // SHAPES) + 1 + p % SHAPES


@numba.njit(nogil=True, cache=True)
def factorise(matrix: Float64, size: int) -> None:
    """Cholesky's lower factor in place, with the ridge on the diagonal; the inverses of its diagonal on it."""
    for i in range(size):
        pivot = matrix[i, i] * (1.0 + _RIDGE)
        floor = matrix[i, i] * _RIDGE
        for k in range(i):
            pivot -= matrix[i, k] * matrix[i, k]
        inverse = 1.0 / math.sqrt(max(pivot, floor, 1e-300))
        matrix[i, i] = inverse
        for j in range(i + 1, size):
            total = matrix[j, i]
            for k in range(i):
                total -= matrix[j, k] * matrix[i, k]
            matrix[j, i] = total * inverse


@numba.njit(nogil=True, cache=True)
def back_substitute(factor: Float64, size: int, x: Float64) -> None:
    """Solve in place with the factor of `factorise`."""
    for i in range(size):
        total = x[i]
        for k in range(i):
            total -= factor[i, k] * x[k]
        x[i] = total * factor[i, i]
    for i in range(size - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, size):
            total -= factor[k, i] * x[k]
        x[i] = total * factor[i, i]


@numba.njit(nogil=True, cache=True)
def _pick(gram: Float64, free: Bools, lobes: int, matrix: Float64, picked: Ints) -> int:
    """The normal matrix of the free coefficients, and which they are."""
    count = 0
    for p in range(1 + lobes):
        if free[p]:
            picked[count] = p
            count += 1
    for i in range(count):
        for j in range(i + 1):
            matrix[i, j] = gram[column_of(picked[i]), column_of(picked[j])]
    return count


@numba.njit(nogil=True, cache=True)
def solve_channel(gram: Float64, channel: int, before: Float64, free: Bools, albedo: Float64) -> None:
    """Albedos >= 0 of one channel: least squares over those that `free` (in and out) allows, the others as they come.

    `gram` holds the residuals that `before` leaves; `albedo` comes with what is not free: 0, or what is given.
    """
    lobes = len(before) - 1
    matrix, x, picked = np.empty((5, 5)), np.empty(5), np.empty(5, np.int64)
    for _ in range(_SWEEPS):
        count = _pick(gram, free, lobes, matrix, picked)
        for i in range(count):
            column = column_of(picked[i])
            x[i] = gram[channel, column]
            for p in range(1 + lobes):
                if not free[p]:
                    x[i] -= gram[column, column_of(p)] * (albedo[p] - before[p])
        factorise(matrix, count)
        back_substitute(matrix, count, x)
        worst, least = -1, 0.0
        for i in range(count):
            if x[i] + before[picked[i]] < least:
                worst, least = i, x[i] + before[picked[i]]
        if worst < 0:
            for i in range(count):
                albedo[picked[i]] = np.float64(np.float32(before[picked[i]] + x[i]))
            return
        free[picked[worst]] = False
        albedo[picked[worst]] = 0.0


@numba.njit(nogil=True, cache=True)
def cost_of(gram: Float64, channel: int, before: Float64, albedo: Float64) -> float:
    """Sum of squares of one channel."""
    lobes = len(before) - 1
    cost = gram[channel, channel]
    for p in range(1 + lobes):
        change, column = albedo[p] - before[p], column_of(p)
        cost -= 2.0 * change * gram[channel, column]
        for q in range(1 + lobes):
            cost += change * (albedo[q] - before[q]) * gram[column, column_of(q)]
    return float(max(cost, 0.0))


@numba.njit(nogil=True, cache=True)
def solve_albedos(gram: Float64, before: Float64, diffuse_free: bool, free: Bools, albedo: Float64) -> float:
    """Best albedos (3, 1 + j) for the lobes that the Gram matrix is of, and the sum of squares that is left.

    Coefficients that are `free` (3, 1 + j) at the end are above 0. Without `diffuse_free` the diffuse stays.
    """
    lobes, cost = before.shape[1] - 1, 0.0
    for channel in range(3):
        for p in range(1 + lobes):
            column = column_of(p)
            free[channel, p] = gram[column, column] > _DEAD * gram[3, 3]
            albedo[channel, p] = 0.0
        if not diffuse_free:
            free[channel, 0] = False
            albedo[channel, 0] = before[channel, 0]
        solve_channel(gram, channel, before[channel], free[channel], albedo[channel])
        _free_again(gram, channel, before[channel], diffuse_free, free[channel], albedo[channel])
        cost += cost_of(gram, channel, before[channel], albedo[channel])
    return cost


@numba.njit(nogil=True, cache=True)
def cost_with(gram: Float64, before: Float64, diffuse_free: bool, allowed: Bools) -> float:
    """Sum of squares at the best albedos of some of the lobes alone, `allowed` (1 + j)."""
    cost, albedo = 0.0, np.empty(before.shape[1])
    for channel in range(3):
        free = allowed.copy()
        albedo[:] = 0.0
        if not diffuse_free:
            free[0], albedo[0] = False, before[channel, 0]
        solve_channel(gram, channel, before[channel], free, albedo)
        cost += cost_of(gram, channel, before[channel], albedo)
    return cost


@numba.njit(nogil=True, cache=True)
def _free_again(gram: Float64, channel: int, before: Float64, diffuse_free: bool, free: Bools, albedo: Float64) -> None:
    """Once more with those that were taken for 0 too early."""
    lobes, again = len(before) - 1, False
    for p in range(0 if diffuse_free else 1, 1 + lobes):
        column = column_of(p)
        if free[p] or not gram[column, column] > _DEAD * gram[3, 3]:
            continue
        slope = gram[channel, column]
        for q in range(1 + lobes):
            slope -= gram[column, column_of(q)] * (albedo[q] - before[q])
        if slope > 0:
            free[p] = again = True
    if again:
        solve_channel(gram, channel, before, free, albedo)


@numba.njit(nogil=True, cache=True)
def _project(gram: Float64, free: Bools, lobes: int, follow: Float64, left: Float64) -> None:
    """How the free albedos follow a parameter, `follow` (1 + j, p); products of what is `left` of the slopes."""
    matrix, x, picked = np.empty((4, 4)), np.empty(4), np.empty(4, np.int64)
    count, parameters = _pick(gram, free, lobes, matrix, picked), SHAPES * lobes + 1
    factorise(matrix, count)
    follow[:, :] = 0.0
    for p in range(parameters):
        column = _slope(p, lobes)
        for i in range(count):
            x[i] = gram[column_of(picked[i]), column]
        back_substitute(matrix, count, x)
        for i in range(count):
            follow[picked[i], p] = x[i]
        for q in range(parameters):
            total = gram[column, _slope(q, lobes)]
            for i in range(count):
                total -= x[i] * gram[column_of(picked[i]), _slope(q, lobes)]
            left[p, q] = total


@numba.njit(nogil=True, cache=True)
def equations(solved: tuple[Float64, Float64, Float64, Bools], slots: Ints, follow: Float64, room: Float64) -> int:
    """Normal matrix and, in its last row, the right side of the unknowns, into `room` (n + 1, n); their number.

    `solved`: the Gram matrix, and albedos before, found, and which of those are free, as in `solve_albedos`; `follow`
    (3, 1 + j, p) is how they follow the parameters.
    """
    gram, before, albedo, free = solved
    lobes = before.shape[1] - 1
    parameters, unknowns = SHAPES * lobes + 1, 0
    for p in range(parameters):
        unknowns = max(unknowns, slots[p] + 1)
    room[: unknowns + 1, :unknowns] = 0.0
    left = np.empty((parameters, parameters))
    for channel in range(3):
        known = channel > 0
        for p in range(1 + lobes):
            known = known and free[channel, p] == free[channel - 1, p]
        if known:
            follow[channel] = follow[channel - 1]
        else:
            _project(gram, free[channel], lobes, follow[channel], left)
        for p in range(parameters):
            if slots[p] < 0:
                continue
            weight = 1.0 if p == SHAPES * lobes else albedo[channel, 1 + p // SHAPES]
            column = _slope(p, lobes)
            slope = gram[channel, column]
            for q in range(1 + lobes):
                slope -= gram[column, column_of(q)] * (albedo[channel, q] - before[channel, q])
            room[unknowns, slots[p]] += weight * slope
            for q in range(parameters):
                if slots[q] >= 0:
                    other = 1.0 if q == SHAPES * lobes else albedo[channel, 1 + q // SHAPES]
                    room[slots[p], slots[q]] += weight * other * left[p, q]
    return unknowns


@numba.njit(nogil=True, cache=True)
def step_of(room: Float64, unknowns: int, stuck: Bools, damping: float, step: Float64) -> float:
    """The damped step of the unknowns that are not `stuck`, and what it gains if the model is linear."""
    matrix, x, picked = np.empty((unknowns, unknowns)), np.empty(unknowns), np.empty(unknowns, np.int64)
    step[:] = 0.0
    count, largest = 0, 0.0
    for p in range(unknowns):
        largest = max(largest, room[p, p])
    for p in range(unknowns):
        if not stuck[p] and room[p, p] > 1e-14 * largest:
            picked[count] = p
            count += 1
    for i in range(count):
        for j in range(i + 1):
            matrix[i, j] = room[picked[i], picked[j]]
        matrix[i, i] *= 1.0 + damping
        x[i] = room[unknowns, picked[i]]
    factorise(matrix, count)
    back_substitute(matrix, count, x)
    for i in range(count):
        step[picked[i]] = x[i]
    gain = 0.0
    for i in range(count):
        gain += 2.0 * x[i] * room[unknowns, picked[i]]
        for j in range(count):
            gain -= x[i] * x[j] * room[picked[i], picked[j]]
    return gain


@numba.njit(nogil=True, cache=True)
def shorten(step: Float64, slots: Ints, lobes: int) -> float:
    """Scale a step that goes further than the slopes can be trusted; by what."""
    scale = 1.0
    for p in range(SHAPES * lobes):
        limit, size = _MOST_LOG if p % SHAPES == 0 else _MOST_AXIS, abs(step[slots[p]])
        if size * scale > limit:
            scale = limit / size
    step *= scale
    return scale


@numba.njit(nogil=True, cache=True)
def normalise(lobe: Float64) -> float:
    """Scale C so that its largest component is +-1, with C_z >= 0; by what its values grow.

    With C_z < 0 a lobe would peak beyond all samples, at the horizon, and there be as high as it likes.
    """
    lobe[2] = max(lobe[2], 0.0)
    size = max(abs(lobe[0]), abs(lobe[1]), lobe[2])
    if size > 0:
        lobe[0], lobe[1], lobe[2] = lobe[0] / size, lobe[1] / size, lobe[2] / size
        return float(size ** math.exp(lobe[3]))
    return 1.0


@numba.njit(nogil=True, cache=True)
def held_component(lobe: Float64) -> int:
    """Which component of C is +-1: the one that is not a parameter."""
    if abs(lobe[0]) >= abs(lobe[1]) and abs(lobe[0]) >= abs(lobe[2]):
        return 0
    return 1 if abs(lobe[1]) >= abs(lobe[2]) else 2
