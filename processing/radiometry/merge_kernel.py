"""The loops of the HDR merge, compiled by numba; their plain NumPy twin is in tests/reference.

All quantities are in raw counts, and rates are counts per longest exposure: gains and times of any magnitude then
stay within float32. With x the rate, tau an exposure's share of the longest, d the variance of a sample without
light and eps the counts per electron, a sample y has mean x tau and variance eps x tau + d. Its score about x is
w (y - x tau) and its information w tau, with w = 1 / (eps x + d / tau). Fisher scoring is therefore a re-weighted
mean, x <- sum w y / sum w tau: one reciprocal and two multiply-adds per sample, in all lanes of the processor.

The frames are read once, in blocks of pixels that stay in the cache. Nothing in the vector loops branches; the few
pixels about which a saturated sample still says something are solved one by one at the end of their block.
"""

import math
from collections.abc import Callable
from typing import NamedTuple, TypeVar, cast

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy.special import erfcx

OK, SATURATED, DARK, MISSING, HOT = 0, 1, 2, 3, 4

BLOCK_PX = 512
STEPS = 12
# Largest relative change of a sample's variance in the last step. It changes the weights of the residuals by as
# much, so the step that would follow moves no pixel by more than about this share of its standard deviation.
TOLERANCE = np.float32(0.01)
CENSORED_STEPS = 60
CENSORED_TOLERANCE = 1e-3  # in standard deviations: near saturation the information varies fast

# In place of samples that give no count, beyond all that do.
_CLIPPED = np.float32(1e30)
_ABSENT = np.float32(2e30)
_NO_COUNT = np.float32(5e29)
_TINY = np.float32(1e-30)
_ZERO, _ONE = np.float32(0), np.float32(1)

# Hazard of the normal distribution, density over upper tail: the pull of 'at least this much'.
_HAZARD_FROM, _HAZARD_TO, _HAZARD_PER_SIGMA = -5.0, 10.0, 64
_HAZARD = math.sqrt(2 / math.pi) / erfcx(
    np.linspace(_HAZARD_FROM, _HAZARD_TO, int((_HAZARD_TO - _HAZARD_FROM) * _HAZARD_PER_SIGMA) + 1) / math.sqrt(2)
)
_AFTERGLOW = np.float32(_HAZARD_FROM**2)

# Sums may be reordered everywhere; only loops whose numbers are all finite may be told so.
_REORDER = {"contract", "arcp", "reassoc", "nsz", "afn"}

Float32 = NDArray[np.float32]
_Loop = TypeVar("_Loop", bound=Callable[..., object])


def _vector(loop: _Loop) -> _Loop:
    """Compile for all lanes; no branches, no exceptions, no calls of the mathematics library."""
    return cast(_Loop, njit(loop, fastmath=_REORDER, error_model="numpy"))


def _vector_finite(loop: _Loop) -> _Loop:
    """The same where all numbers are finite, which makes a division a reciprocal estimate and a Newton step."""
    return cast(_Loop, njit(loop, fastmath=_REORDER | {"nnan", "ninf"}, error_model="numpy"))


class Exposures(NamedTuple):
    """Frames from the longest to the shortest: place in the stack, share of the longest time, d / tau in counts."""

    place: NDArray[np.int64]
    share: Float32
    floor: Float32


class Levels(NamedTuple):
    """The sensor in counts: black, white, the least that rounds to white, eps, d; and e-/s of a count per longest."""

    black: np.float32
    white: np.float32
    ceiling: np.float32
    per_electron: np.float32
    dark_variance: np.float32
    scale: np.float32


class PixelMaps(NamedTuple):
    """What differs from pixel to pixel, each (n,), the variances perhaps of one block; see `sensor.PixelCorrection`."""

    offset_dn: Float32
    dark_e_s: Float32
    flat: Float32
    hot: NDArray[np.bool_]
    dark_variance: Float32
    flat_variance: Float32


class Block(NamedTuple):
    """What the loops hand to each other about the pixels of a block, each (n,).

    Rate and information, the weighted sum of counts, the share of the shortest saturated exposure (0: none), black.
    """

    rate: Float32
    information: Float32
    counts: Float32
    clipped: Float32
    black: Float32


class Merged(NamedTuple):
    """Outputs (n,): radiance in electrons per second, its variance, its status."""

    value: Float32
    variance: Float32
    status: NDArray[np.uint8]


@_vector
def _black_levels(levels: Levels, maps: PixelMaps, black: Float32) -> None:
    """Black level with the fixed pattern; the pattern of hot pixels, which may not be finite, is left out."""
    for x in range(black.size):
        black[x] = levels.black + (_ZERO if maps.hot[x] else maps.offset_dn[x])


@_vector
def _read(dn: NDArray[np.generic], share: np.float32, white: np.float32, block: Block, sample: Float32) -> None:
    """Counts above black of one exposure; notes its share of time where it is saturated, the shortest coming last."""
    for x in range(sample.size):
        count = np.float32(dn[x])
        below = count < white
        saturated = count >= white  # not the contrary for NaN
        number = count - block.black[x] if below and count > -np.inf else _ABSENT
        sample[x] = _CLIPPED if saturated else number
        block.clipped[x] = share if saturated else block.clipped[x]


@_vector_finite
def _weigh(sample: Float32, share: np.float32, floor: np.float32, shot: Float32, block: Block) -> None:
    """Add one exposure to the weighted sums, at a shot noise of `shot` per share of time."""
    for x in range(sample.size):
        weight = _ONE / (shot[x] + floor)
        weight = weight if sample[x] < _NO_COUNT else _ZERO
        block.counts[x] += weight * sample[x]
        block.information[x] += weight * share


@_vector_finite
def _advance(shot: Float32, block: Block, levels: Levels) -> bool:
    """Take the weighted means as rates; says whether the variance of any sample changed by over the tolerance.

    Weights that have settled stay, so that a pixel's result depends on none of its block's other pixels.
    """
    unsettled = False
    for x in range(shot.size):
        block.rate[x] = block.counts[x] / max(block.information[x], _TINY)
        noise = levels.per_electron * max(block.rate[x], _ZERO)
        moves = abs(noise - shot[x]) > TOLERANCE * (noise + levels.dark_variance)
        shot[x] = noise if moves else shot[x]
        unsettled |= moves
    return unsettled


@njit(error_model="numpy")
def _solve(sample: Float32, exposures: Exposures, levels: Levels, block: Block) -> None:
    """Maximum-likelihood rates of samples (k, n), those that are numbers; starts in the dark."""
    shot = np.zeros(sample.shape[1], np.float32)
    for _ in range(STEPS):
        block.counts[:] = _ZERO
        block.information[:] = _ZERO
        for i in range(len(sample)):
            _weigh(sample[i], exposures.share[i], exposures.floor[i], shot, block)
        if not _advance(shot, block, levels):
            break


@_vector_finite
def _afterglow(block: Block, levels: Levels, pulled: NDArray[np.bool_]) -> bool:
    """Mark the pixels whose shortest saturated exposure does not lie clearly above saturation, and so has a say."""
    some = False
    for x in range(pulled.size):
        mean = block.rate[x] * block.clipped[x]
        above = mean + block.black[x] - levels.ceiling
        variance = levels.per_electron * max(mean, _ZERO) + levels.dark_variance
        unsure = (above < _ZERO) | (above * above < _AFTERGLOW * variance)
        pulled[x] = unsure & (block.clipped[x] > _ZERO) & (block.information[x] > _ZERO)
        some |= pulled[x]
    return some


@njit(error_model="numpy", inline="always")
def _hazard(a: float) -> float:
    """Density over upper tail of the normal distribution at `a` standard deviations, to 1e-5."""
    position = (a - _HAZARD_FROM) * _HAZARD_PER_SIGMA
    if position < 0:
        return 0.0
    i = int(position)
    if i >= _HAZARD.size - 1:
        return a + 1 / a - 2 / a**3
    return float(_HAZARD[i] + (position - i) * (_HAZARD[i + 1] - _HAZARD[i]))


@njit(error_model="numpy")
def _solve_censored(
    sample: Float32, exposures: Exposures, levels: Levels, ceiling: float, start: float
) -> tuple[float, float]:
    """Rate and information of one pixel's samples (k,) where a saturated one counts as 'at least `ceiling`'.

    With a the distance from mean to ceiling in standard deviations and l the hazard at a, the score about the mean is
    l (1 / sigma + eps a / 2 variance), the second part because the variance grows with the mean; the information is
    l (l - a) / variance (Tobin 1958). The score falls with the rate: steps that leave the bracket are halved into it.
    """
    per_electron, dark_variance = float(levels.per_electron), float(levels.dark_variance)
    rate, information = start, 0.0
    low, high = -np.inf, np.inf
    for _ in range(CENSORED_STEPS):
        score, information = 0.0, 0.0
        shot = per_electron * max(rate, 0.0)
        for i in range(sample.size):
            share = float(exposures.share[i])
            if sample[i] < _NO_COUNT:
                weight = 1.0 / (shot + float(exposures.floor[i]))
                score += weight * (float(sample[i]) - rate * share)
                information += weight * share
            elif sample[i] == _CLIPPED:
                variance = shot * share + dark_variance
                sigma = math.sqrt(variance)
                a = (ceiling - rate * share) / sigma
                hazard = _hazard(a)
                score += share * hazard * (1.0 / sigma + 0.5 * per_electron * a / variance)
                information += share * share * hazard * (hazard - a) / variance
        step = score / information
        if step > 0:
            low = rate
        else:
            high = rate
        rate = rate + step if low < rate + step < high else 0.5 * (low + high)
        if step * step * information < CENSORED_TOLERANCE**2:
            break
    return rate, information


@_vector
def _finish(block: Block, scale: np.float32, out: Merged) -> None:
    """From counts per longest exposure to electrons per second, with the reason where nothing is known."""
    for x in range(out.value.size):
        known = block.information[x] > _ZERO
        value = block.rate[x] * scale
        variance = scale * scale / block.information[x]
        out.value[x] = value if known else np.float32(np.nan)
        out.variance[x] = variance if known else np.float32(np.nan)
        measured = np.uint8(DARK) if value < np.float32(3) * np.sqrt(variance) else np.uint8(OK)
        blind = np.uint8(SATURATED) if block.clipped[x] > _ZERO else np.uint8(MISSING)
        out.status[x] = measured if known else blind


@_vector
def _correct(maps: PixelMaps, out: Merged) -> None:
    """Radiance of the nominal pixel from the rate of the real one: r = (rate - dark) / flat."""
    for x in range(out.value.size):
        value = (out.value[x] - maps.dark_e_s[x]) / maps.flat[x]
        variance = out.variance[x] + maps.dark_variance[x] + value * value * maps.flat_variance[x]
        variance /= maps.flat[x] * maps.flat[x]
        measured = np.uint8(DARK) if value < np.float32(3) * np.sqrt(variance) else np.uint8(OK)
        status = measured if out.status[x] == OK or out.status[x] == DARK else out.status[x]
        out.value[x] = np.float32(np.nan) if maps.hot[x] else value
        out.variance[x] = np.float32(np.nan) if maps.hot[x] else variance
        out.status[x] = np.uint8(HOT) if maps.hot[x] else status


@njit(error_model="numpy")
def _part(maps: PixelMaps, first: int, last: int) -> PixelMaps:
    return PixelMaps(
        maps.offset_dn[first:last],
        maps.dark_e_s[first:last],
        maps.flat[first:last],
        maps.hot[first:last],
        _repeated(maps.dark_variance, first, last),
        _repeated(maps.flat_variance, first, last),
    )


@njit(error_model="numpy")
def _repeated(numbers: Float32, first: int, last: int) -> Float32:
    """A map's part; a map of one block only holds for every block."""
    return numbers[first:last] if numbers.size >= last else numbers[: last - first]


@njit(error_model="numpy")
def _solve_pulled(
    sample: Float32, exposures: Exposures, levels: Levels, block: Block, pulled: NDArray[np.bool_]
) -> None:
    """Solve the marked pixels again, with what their saturated samples say."""
    for x in np.flatnonzero(pulled):
        ceiling = levels.ceiling - block.black[x]
        solution = _solve_censored(sample[:, x], exposures, levels, ceiling, block.rate[x])
        block.rate[x], block.information[x] = solution


@njit(error_model="numpy")
def _merge_block(
    raw_dn: NDArray[np.generic],
    first: int,
    exposures: Exposures,
    levels: Levels,
    maps: PixelMaps | None,
    out: Merged,
) -> None:
    """Merge the pixels from `first` on, as many as `out` takes; `maps` are theirs.

    Not written into the parallel loop: there numba takes what is stored in a tuple's arrays for unused, and drops it.
    """
    frames, n = len(raw_dn), out.value.size
    sample = np.empty((frames, n), np.float32)
    pulled = np.empty(n, np.bool_)
    work = np.zeros((5, n), np.float32)
    block = Block(work[0], work[1], work[2], work[3], work[4])
    if maps is None:
        block.black[:] = levels.black
    else:
        _black_levels(levels, maps, block.black)
    for i in range(frames):
        dn = raw_dn[exposures.place[i], first : first + n]
        _read(dn, exposures.share[i], levels.white, block, sample[i])
    _solve(sample, exposures, levels, block)
    if _afterglow(block, levels, pulled):
        _solve_pulled(sample, exposures, levels, block, pulled)
    _finish(block, levels.scale, out)
    if maps is not None:
        _correct(maps, out)


@njit(parallel=True, cache=True, error_model="numpy")
def merge_pixels(
    raw_dn: NDArray[np.generic], exposures: Exposures, levels: Levels, maps: PixelMaps | None, out: Merged
) -> None:
    """Merge the pixels of a stack (k, n) into `out`, each frame read once; see `hdr.merge_exposures`."""
    pixels = raw_dn.shape[1]
    for number in prange((pixels + BLOCK_PX - 1) // BLOCK_PX):
        first = number * BLOCK_PX
        last = min(first + BLOCK_PX, pixels)
        part = Merged(out.value[first:last], out.variance[first:last], out.status[first:last])
        if maps is None:
            _merge_block(raw_dn, first, exposures, levels, None, part)
        else:
            _merge_block(raw_dn, first, exposures, levels, _part(maps, first, last), part)
