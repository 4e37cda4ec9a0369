"""The descent of one texel's Lafortune lobes from a start, and the choice between starts and numbers of lobes."""

import math

import numba
import numpy as np

from processing.products.arrays import Float32, Float64
from processing.sbrdf.lafortune_equations import (
    SHAPES,
    Bools,
    Ints,
    equations,
    held_component,
    normalise,
    shorten,
    solve_albedos,
    step_of,
)
from processing.sbrdf.lafortune_kernel import BLOCK, TILE, gram_of

CONVERGED, AT_BOUND, TOO_FEW_SAMPLES, DIVERGED, STOPPED = 0, 1, 2, 3, 4

_TRUSTED = 0.05  # of log n and of C
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-2, 1e-9, 1e7


@numba.njit(nogil=True, cache=True)
def descend(
    samples: Float32,
    slots: Ints,
    bounds: tuple[float, float],
    rule: tuple[float, int, float],
    state: tuple[Float64, Float64],
    last: tuple[Float64, Float64],
) -> tuple[float, int, int]:
    """Lower the sum of squares from a state, in place: lobes (j, 4), C and log n, and albedos (3, 1 + j).

    `bounds` of log n; `rule`: share of the cost that is not worth a round, most rounds, and a cost that is none.
    Returns cost, rounds and whether it CONVERGED, STOPPED or DIVERGED. The last step, which is small, is taken on
    trust where it is short. `last` is left as it was: the Gram matrix, and the albedos whose residuals it is of.
    """
    (lobes, albedo), (gram, before) = state, last
    count = len(lobes)
    parameters = SHAPES * count + 1
    columns = np.empty(TILE * (1 + count) * BLOCK, np.float32)
    room, follow = np.empty((parameters + 1, parameters)), np.empty((3, 1 + count, parameters))
    step, stuck = np.zeros(parameters), np.zeros(parameters, np.bool_)
    free, held, shapes = np.empty((3, 1 + count), np.bool_), np.empty(count, np.int64), np.empty((count, 4))
    trial, found = lobes.copy(), albedo.copy()
    ahead = albedo.copy()
    diffuse_slot = slots[parameters - 1]
    best, damping, unknowns, rounds = np.inf, _FIRST_DAMPING, 0, 0
    for rounds in range(1, rule[1] + 1):
        for j in range(count):
            shapes[j], held[j] = trial[j], held_component(trial[j])
            shapes[j, 3] = math.exp(trial[j, 3])
        before[:] = ahead
        gram_of(samples, shapes, held, before, columns, gram)
        cost = solve_albedos(gram, before, diffuse_slot < 0, free, found)
        if cost < best:
            unknowns = equations((gram, before, found, free), slots, follow, room)
            best, damping = cost, max(damping * 0.1, _LEAST_DAMPING)
            lobes[:], albedo[:] = trial, found
        else:
            damping *= 10.0
        if not best < np.inf:
            return best, rounds, DIVERGED
        find_stuck(lobes, albedo, room[unknowns], bounds, slots, stuck)
        gain = step_of(room, unknowns, stuck, damping, step)
        trial[:], ahead[:] = lobes, albedo
        small = np.max(np.abs(step[:unknowns])) < _TRUSTED if unknowns > 0 else True
        shorten(step, slots, count)
        move(step, slots, bounds, follow, trial, ahead)
        if gain <= rule[0] * best + rule[2]:
            if small:
                lobes[:], albedo[:] = trial, ahead
            return best, rounds, CONVERGED
        if damping > _MOST_DAMPING:
            return best, rounds, CONVERGED
    return best, rounds, STOPPED


@numba.njit(nogil=True, cache=True)
def find_stuck(
    lobes: Float64, albedo: Float64, slope: Float64, bounds: tuple[float, float], slots: Ints, stuck: Bools
) -> None:
    """Unknowns that rest on their bound and are pushed against it."""
    count = len(lobes)
    stuck[:] = False
    for j in range(count):
        slot = slots[SHAPES * j]
        low, high = lobes[j, 3] <= bounds[0], lobes[j, 3] >= bounds[1]
        stuck[slot] = (low and slope[slot] < 0) or (high and slope[slot] > 0)
        held = held_component(lobes[j])
        if held != 2 and lobes[j, 2] <= 0:
            slot = slots[SHAPES * j + 2 - held]
            stuck[slot] = slope[slot] < 0
    slot = slots[SHAPES * count]
    if slot >= 0:
        stuck[slot] = albedo[0, 0] <= 0 and slope[slot] < 0


@numba.njit(nogil=True, cache=True)
def move(
    step: Float64, slots: Ints, bounds: tuple[float, float], follow: Float64, lobes: Float64, albedo: Float64
) -> None:
    """Go a step, the albedos as they follow to first order, all within their bounds."""
    count = len(lobes)
    parameters = SHAPES * count + 1
    change = np.zeros((3, 1 + count))
    for p in range(parameters):
        if slots[p] < 0:
            continue
        for channel in range(3):
            size = step[slots[p]] * (1.0 if p == parameters - 1 else albedo[channel, 1 + p // SHAPES])
            for q in range(1 + count):
                change[channel, q] -= follow[channel, q, p] * size
            if p == parameters - 1:
                change[channel, 0] += size
    for channel in range(3):
        change[channel] += albedo[channel]
    most = 2.0 * np.max(albedo)  # what is far off as a start of the next albedos would cost digits of the residuals
    for j in range(count):
        held = held_component(lobes[j])
        lobes[j, (held + 1) % 3] += step[slots[SHAPES * j + 1]]
        lobes[j, (held + 2) % 3] += step[slots[SHAPES * j + 2]]
        lobes[j, 3] = min(max(lobes[j, 3] + step[slots[SHAPES * j]], bounds[0]), bounds[1])
        change[:, 1 + j] *= normalise(lobes[j])
    for channel in range(3):
        for q in range(1 + count):
            albedo[channel, q] = np.float64(np.float32(min(max(change[channel, q], 0.0), most)))
