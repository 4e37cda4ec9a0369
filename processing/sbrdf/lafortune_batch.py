"""Lafortune fits of many texels, one after another: samples gathered, starts tried on a few, the best one finished.

The samples come in a mixed order, so that the first blocks are a fair choice of all of them: they tell starts apart and
bring the best near the minimum; two or three rounds over all samples end it.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32, Float64
from processing.sbrdf.lafortune_descent import AT_BOUND, DIVERGED, TOO_FEW_SAMPLES, descend
from processing.sbrdf.lafortune_equations import Ints, cost_with, normalise
from processing.sbrdf.lafortune_kernel import BLOCK, FACTOR, ROWS, TILE, VALUES
from processing.sbrdf.lafortune_search import SPARE, best_of, improve_anew, search, slots_of

_LARGEST = 3e38  # that float32 holds
_LEAST_PER_FUNCTION = 2  # samples, of three channels each
_COARSE = 2  # blocks
_FINELY = (1e-5, 40)
_NOTHING, _FLOOR = 1e-10, 1e-13  # of the values' squares: what no lobe is worth, and no round


@numba.njit(nogil=True, cache=True)
def weigh(values: Float32, variance: Float32, cosine: Float32, weights: Float64) -> tuple[int, float, float]:
    """One over the noise of each sample, 0 for one that is not valid; how many are, and units of values and noise.

    `values` (s, 3); `variance` (s,), or (0,) for all alike; `cosine` (s,) to the light. In the units the weights and
    the weighted values are 1 in the root mean square.
    """
    count, noise, squares = 0, 0.0, 0.0
    for i in range(len(values)):
        total = np.float64(values[i, 0]) + np.float64(values[i, 1]) + np.float64(values[i, 2])
        weights[i] = 0.0
        if not (math.isfinite(total) and cosine[i] > 0):
            continue
        weight = 1.0
        if variance.size > 0:
            if not 0.0 < variance[i] < np.inf:
                continue
            weight = 1.0 / math.sqrt(np.float64(variance[i]))
        weights[i] = weight
        count += 1
        noise += weight * weight
        for k in range(3):
            squares += (weight * values[i, k]) ** 2
    if count == 0:
        return 0, 0.0, 1.0
    noise = math.sqrt(noise / count)
    return count, math.sqrt(squares / (3 * count)) / noise, noise


@numba.njit(nogil=True, cache=True)
def gather(
    values: Float32,
    weights: Float64,
    units: tuple[float, float],
    known: tuple[Float32, Ints],
    room: Float32,
) -> Float32:
    """The samples whose weight is not 0, as blocks in `room`, in units of value and of one over noise.

    `known`: products and the cosine to the light (4, s), and the order to take samples in.
    """
    products, order = known
    of_factor, of_value = 1.0 / units[1], 1.0 / (units[0] * units[1])
    at, last = 0, -1
    for i in order:
        if weights[i] > 0:
            if at // (ROWS * BLOCK) > last:
                last = at // (ROWS * BLOCK)
                room[at : at + ROWS * BLOCK] = 0.0
            room[at] = products[0, i]
            room[at + BLOCK] = products[1, i]
            room[at + 2 * BLOCK] = products[2, i]
            room[at + FACTOR] = products[3, i] * (weights[i] * of_factor)
            weight = weights[i] * of_value
            room[at + VALUES] = values[i, 0] * weight
            room[at + VALUES + BLOCK] = values[i, 1] * weight
            room[at + VALUES + 2 * BLOCK] = values[i, 2] * weight
            at += 1
            if at % BLOCK == 0:
                at += (ROWS - 1) * BLOCK
    return room[: (last + 1) * ROWS * BLOCK]


@numba.njit(nogil=True, cache=True)
def _least_worth(gram: Float64, before: Float64, shared: bool) -> tuple[int, float, float]:
    """The lobe without which the cost grows least, by albedos alone; the cost with it and without."""
    lobes = before.shape[1] - 1
    allowed = np.ones(1 + lobes, np.bool_)
    least, lowest, cost = -1, np.inf, cost_with(gram, before, not shared, allowed)
    for j in range(lobes):
        allowed[1 + j] = False
        without = cost_with(gram, before, not shared, allowed)
        allowed[1 + j] = True
        if without < lowest:
            least, lowest = j, without
    return least, cost, lowest


@numba.njit(nogil=True, cache=True)
def _without(lobe: int, lobes: Float64, albedo: Float64) -> tuple[Float64, Float64]:
    fewer, left = np.empty((len(lobes) - 1, 4)), np.empty((3, len(lobes)))
    left[:, 0] = albedo[:, 0]
    for j in range(len(fewer)):
        source = j if j < lobe else j + 1
        fewer[j], left[:, 1 + j] = lobes[source], albedo[:, 1 + source]
    return fewer, left


@numba.njit(nogil=True, cache=True)
def finish(
    samples: Float32,
    settings: tuple[bool, float, float],
    count: int,
    candidates: Float64,
    state: tuple[Float64, Float64],
) -> tuple[Float64, Float64, float, int, int]:
    """Descend over all samples; leave out lobes whose gain is not worth their parameters (Akaike 1974).

    A lobe that is worth little is first tried elsewhere, if there are `candidates`.
    Returns the lobes and albedos that are left, the sum of squares, rounds and status.
    """
    (shared, low, high), (lobes, albedo) = settings, state
    total, squares = 0, 3.0 * count
    rule = (_FINELY[0], _FINELY[1], _FLOOR * squares)
    while True:
        size = TILE * (1 + len(lobes))
        gram, before = np.empty((size, size)), np.empty_like(albedo)
        slots = slots_of(len(lobes), shared)
        cost, rounds, status = descend(samples, slots, (low, high), rule, (lobes, albedo), (gram, before))
        total += rounds
        if len(lobes) == 0 or status == DIVERGED:
            break
        least, present, without = _least_worth(gram, before, shared)
        gain = 3 * count * math.log((without + _NOTHING * squares) / (present + _NOTHING * squares))
        if gain < SPARE and len(candidates) > 0:
            lobes, albedo, total = improve_anew(samples, (count, cost, total), (low, high), candidates, (lobes, albedo))
            candidates = candidates[:0]
            continue
        if gain > 2 * (4 if shared else 6):
            break
        lobes, albedo = _without(least, lobes, albedo)
    for j in range(len(lobes)):
        if lobes[j, 3] <= low or lobes[j, 3] >= high:
            status = max(status, AT_BOUND) if status == 0 else status
    return lobes, albedo, cost, total, status


@numba.njit(nogil=True, cache=True)
def _present(start: Float64) -> Float64:
    """The lobes of a start that are not absent."""
    count = 0
    kept = np.empty_like(start)
    for lobe in start:
        kept[count] = lobe
        if np.isfinite(lobe.sum()) and normalise(kept[count]) > 0 and np.abs(kept[count, :3]).sum() > 0:
            count += 1
    return kept[:count].copy()


@numba.njit(nogil=True, cache=True)
def _begun(
    samples: Float32, settings: tuple[bool, float, float], count: int, begin: tuple[Float64, Float64], wanted: int
) -> tuple[Float64, Float64, Float64, int]:
    """Lobes and albedos to finish, candidates for what will be worth little, and the rounds it took.

    `begin`: starts for all (k, j, 4), and the texel's own lobes, which save the search.
    """
    starts, own = begin
    some, few = samples[: _COARSE * ROWS * BLOCK], min(count, _COARSE * BLOCK)
    if len(own) > 0 or wanted == 0:
        return own, np.zeros((3, 1 + len(own))), starts[:0, 0].copy(), 0
    if settings[0]:
        lobes, albedo, _, rounds = best_of(some, settings, starts)
        return lobes, albedo, starts[:0, 0].copy(), rounds
    candidates = starts[:, 0].copy()
    lobes, albedo, rounds = search(some, few, settings[1:], candidates, wanted)
    return lobes, albedo, candidates, rounds


@numba.njit(nogil=True, cache=True)
def fit_texels(
    values: Float32,
    variance: Float32,
    known: tuple[Float32, Ints],
    settings: tuple[bool, float, float],
    begin: tuple[Float64, Float64],
    results: tuple[Float64, Float64, Float64, NDArray[np.int8], NDArray[np.int32]],
) -> None:
    """Fit texels (t, s, 3) into `results`: lobes (t, j, 4), albedos (t, 3, 1 + j), cost, status, rounds.

    `variance` (t or 1, s or 0); `known`: products and cosine (4, s), and the order to take samples in; `settings`:
    whether C and the diffuse are shared, bounds of log n; `begin`: starts for all (k, j, 4), and for each texel
    (t or 0, j, 4).
    """
    starts, warm = begin
    products, order = known
    lobes, albedos, costs, status, rounds = results
    blocks = (len(order) + BLOCK - 1) // BLOCK
    room, weights = np.empty(blocks * ROWS * BLOCK, np.float32), np.empty(values.shape[1])
    for t in range(len(values)):
        lobes[t], albedos[t], costs[t], rounds[t], status[t] = 0.0, 0.0, 0.0, 0, TOO_FEW_SAMPLES
        count, value, noise = weigh(values[t], variance[min(t, len(variance) - 1)], products[3], weights)
        if count == 0:
            continue
        enough = count >= _LEAST_PER_FUNCTION * (1 + 4 * lobes.shape[1])
        if not (value > 0 and math.isfinite(value)):
            status[t] = (DIVERGED if value > 0 else 0) if enough else TOO_FEW_SAMPLES
            continue
        samples = gather(values[t], weights, (value, noise), known, room)
        own = _present(warm[t]) if enough and len(warm) > 0 else starts[0, :0].copy()
        wanted = lobes.shape[1] if enough else 0
        here, found, candidates, taken = _begun(samples, settings, count, (starts, own), wanted)
        here, found, cost, more, how = finish(samples, settings, count, candidates, (here, found))
        if not np.max(found) * value < _LARGEST:
            status[t] = DIVERGED
            continue
        for j in range(len(here)):
            lobes[t, j] = here[j]
        for channel in range(3):
            for p in range(1 + len(here)):
                albedos[t, channel, p] = found[channel, p] * value
        costs[t], rounds[t] = cost * value * value * noise * noise / (3 * count), taken + more
        status[t] = how if enough else TOO_FEW_SAMPLES
