"""Lafortune lobes without a start: one after another from a set of candidates, and lobes that are worth little moved.

A descent ends in the valley that it starts in, and with three lobes one start in four lies in a wrong one: two lobes
share the work of one, or one has nothing to do, while what another should tell stays in the residual. There the
candidates find it. All of it runs on a part of the samples, at the cost of a few rounds over all.
"""

import numba
import numpy as np

from processing.products.arrays import Float32, Float64
from processing.sbrdf.lafortune_descent import descend
from processing.sbrdf.lafortune_equations import (
    SHAPES,
    Ints,
    back_substitute,
    column_of,
    cost_with,
    factorise,
)
from processing.sbrdf.lafortune_kernel import TILE, candidate_products, candidate_values

_ROUGHLY, _ROUNDS, _FLOOR = 2e-4, 15, 1e-13
_MOVES = 4
_CLEAR, _HINT = 25.0, 14.0  # residuals' squares, in variances, that a candidate explains: for any lobe, for a spare one
SPARE = 40.0  # of the same, that a lobe explains beside the others
_ALONE = 1e-3  # of a candidate's square, at least, is taken for what the lobes there are do not span


@numba.njit(nogil=True, cache=True)
def slots_of(lobes: int, shared: bool) -> Ints:
    """Which unknown each parameter stands for; shared, all lobes have one C and the diffuse is grey."""
    slots = np.empty(SHAPES * lobes + 1, np.int64)
    for j in range(lobes):
        for k in range(SHAPES):
            slots[SHAPES * j + k] = SHAPES * j + k if not shared else (j if k == 0 else lobes + k - 1)
    slots[SHAPES * lobes] = -1 if not shared else (lobes + SHAPES - 1 if lobes > 0 else 0)
    return slots


@numba.njit(nogil=True, cache=True)
def best_of(
    samples: Float32, settings: tuple[bool, float, float], starts: Float64
) -> tuple[Float64, Float64, float, int]:
    """Lobes, albedos and cost of the lowest descent from the starts (k, j, 4), and the rounds of all."""
    shared, low, high = settings
    lobes, albedo, best, rounds = starts[0].copy(), np.zeros((3, 1 + starts.shape[1])), np.inf, 0
    size = TILE * (1 + starts.shape[1])
    last, rule = (np.empty((size, size)), albedo.copy()), (_ROUGHLY, _ROUNDS, _FLOOR * samples.size)
    for start in starts:
        trial, found = start.copy(), np.zeros_like(albedo)
        slots = slots_of(len(start), shared)
        cost, taken, _ = descend(samples, slots, (low, high), rule, (trial, found), last)
        rounds += taken
        if cost < best:
            lobes, albedo, best = trial, found, cost
    return lobes, albedo, best, rounds


@numba.njit(nogil=True, cache=True)
def _values(samples: Float32, candidates: Float64) -> Float32:
    shapes = candidates.copy()
    shapes[:, 3] = np.exp(candidates[:, 3])
    return candidate_values(samples, shapes)


@numba.njit(nogil=True, cache=True)
def _products(samples: Float32, values: Float32, lobes: Float64, albedo: Float64) -> tuple[Float64, Float64]:
    shapes = lobes.copy()
    shapes[:, 3] = np.exp(lobes[:, 3])
    return candidate_products(samples, values, shapes, albedo)


@numba.njit(nogil=True, cache=True)
def explained(products: Float64, squares: Float64, lobes: int) -> Float64:
    """By how much each candidate (k,), besides the lobes there are, lowers the sum of squares: albedos above 0."""
    matrix, x, gains = np.empty((4, 4)), np.empty(4), np.empty(len(squares))
    for p in range(1 + lobes):
        for q in range(1 + lobes):
            matrix[p, q] = products[3 + p, 3 + q]
    factorise(matrix, 1 + lobes)
    for k in range(len(squares)):
        alone = squares[k]
        for p in range(1 + lobes):
            x[p] = products[3 + p, 2 * TILE + k]
        back_substitute(matrix, 1 + lobes, x)
        for p in range(1 + lobes):
            alone -= x[p] * products[3 + p, 2 * TILE + k]
        gains[k] = 0.0
        for channel in range(3):
            gains[k] += max(products[channel, 2 * TILE + k], 0.0) ** 2
        gains[k] /= max(alone, _ALONE * squares[k], 1e-300)
    return gains


@numba.njit(nogil=True, cache=True)
def _beside(products: Float64, squares: Float64, candidate: int, lobes: int) -> Float64:
    """Inner products as `gram_of` orders them, of the lobes and one candidate more, without slopes."""
    size = 2 + lobes
    gram = np.zeros((TILE * size, TILE * size))
    for p in range(size):
        row = 2 * TILE + candidate if p == size - 1 else 3 + p
        for channel in range(3):
            gram[channel, channel] = products[channel, channel]
            gram[channel, column_of(p)] = products[channel, row]
        for q in range(size - 1):
            one = products[3 + q, row]
            gram[column_of(p), column_of(q)] = gram[column_of(q), column_of(p)] = one
    gram[column_of(size - 1), column_of(size - 1)] = squares[candidate]
    return gram


@numba.njit(nogil=True, cache=True)
def _replaced(gram: Float64, albedo: Float64) -> tuple[int, float]:
    """Which lobe gives way to the candidate, that `gram` has last, at least cost; least that a lobe is worth now."""
    lobes = albedo.shape[1] - 1
    before, allowed = np.zeros((3, 2 + lobes)), np.ones(2 + lobes, np.bool_)
    before[:, : 1 + lobes] = albedo
    allowed[1 + lobes] = False
    cost = cost_with(gram, before, True, allowed)
    gives_way, lowest, worth = 0, np.inf, np.inf
    for j in range(lobes):
        allowed[1 + j] = False
        worth = min(worth, cost_with(gram, before, True, allowed) - cost)
        allowed[1 + lobes] = True
        moved = cost_with(gram, before, True, allowed)
        allowed[1 + lobes], allowed[1 + j] = False, True
        if moved < lowest:
            gives_way, lowest = j, moved
    return gives_way, worth


@numba.njit(nogil=True, cache=True)
def search(
    samples: Float32, count: int, bounds: tuple[float, float], candidates: Float64, wanted: int
) -> tuple[Float64, Float64, int]:
    """As many lobes as are `wanted` among `candidates` (k, 4), C and log n; their albedos, and the rounds it took.

    `count` of the samples are not padding.
    """
    settings = (False, bounds[0], bounds[1])
    values = _values(samples, candidates)
    lobes, albedo, cost, rounds = best_of(samples, settings, np.empty((1, 0, 4)))
    for present in range(wanted):
        products, squares = _products(samples, values, lobes, albedo)
        trial = np.empty((1, present + 1, 4))
        trial[0, :present] = lobes
        trial[0, present] = candidates[np.argmax(explained(products, squares, present))]
        lobes, albedo, cost, more = best_of(samples, settings, trial)
        rounds += more
    return improve(samples, (count, cost, rounds), bounds, (candidates, values), (lobes, albedo))


@numba.njit(nogil=True, cache=True)
def improve(
    samples: Float32,
    known: tuple[int, float, int],
    bounds: tuple[float, float],
    choice: tuple[Float64, Float32],
    state: tuple[Float64, Float64],
) -> tuple[Float64, Float64, int]:
    """Lobes and albedos after moves of one lobe each to where a candidate explains what they leave, and the rounds.

    `known`: samples that are not padding, cost, rounds until now; `choice`: candidates (k, 4) and their values.
    """
    (count, cost, rounds), (candidates, values), (lobes, albedo) = known, choice, state
    tried = np.zeros(len(candidates), np.bool_)
    for _ in range(_MOVES):
        variance = cost / (3 * count)
        products, squares = _products(samples, values, lobes, albedo)
        gains = explained(products, squares, len(lobes))
        gains[tried] = 0.0
        found = int(np.argmax(gains))
        gives_way, worth = _replaced(_beside(products, squares, found, len(lobes)), albedo)
        spare = worth < SPARE * variance and gains[found] > _HINT * variance
        if not (spare or gains[found] > _CLEAR * variance):
            break
        trial = lobes.copy().reshape(1, len(lobes), 4)
        trial[0, gives_way], tried[found] = candidates[found], True
        moved, its_albedo, its_cost, more = best_of(samples, (False, bounds[0], bounds[1]), trial)
        rounds += more
        if its_cost < cost:
            lobes, albedo, cost = moved, its_albedo, its_cost
    return lobes, albedo, rounds


@numba.njit(nogil=True, cache=True)
def improve_anew(
    samples: Float32,
    known: tuple[int, float, int],
    bounds: tuple[float, float],
    candidates: Float64,
    state: tuple[Float64, Float64],
) -> tuple[Float64, Float64, int]:
    """`improve` on other samples than those of the search."""
    return improve(samples, known, bounds, (candidates, _values(samples, candidates)), state)
