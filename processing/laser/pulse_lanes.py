"""The matched Gaussian for many pixels at once, each in a lane of loops that the compiler vectorises.

The model, the priors and the Fisher scoring are those of `pulse`, in float32 and without its branches: every lane takes
steps until its own are small. Only what is clear is decided here; whatever is saturated, doubled, cut off, distorted or
near a limit is left to the careful fit, pixel by pixel.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.laser.block_maxima import AROUND, BLOCK
from processing.laser.lane_samples import (
    BACK,
    FAR,
    FAST,
    LANES,
    ONE,
    ROWS,
    TOP,
    WHOLE,
    ZERO,
    Floats,
    are_even,
    gather,
    gather_times,
    reach_of,
)
from processing.laser.pulse import (
    ASIDE,
    LEAST_TOLERANCE,
    OK,
    SCATTER,
    TOO_DARK,
    Limits,
    Settings,
    Sweep,
    half_span,
    log_growth,
)

TIME, VARIANCE, AMPLITUDE, WIDTH = range(4)  # rows of results
UNCLEAR = 255  # status of a pixel that is left to the careful fit

_STEPS = 6
_DIM = np.float32(3.5)  # sigmas of a matched filter at the brightest frame, below which there is nothing to fit
_CLEAR = 0.8  # of a limit, up to which a lane lies inside it beyond doubt

# float32 throughout: a single float64 constant would halve the lanes
_TWO, _HALF = np.float32(2.0), np.float32(0.5)
_TOLERANCE = np.float32(0.02)  # of chi square, gained by the last step: what remains after it is far less
_FIFTH, _MOST_X, _REACH = np.float32(0.2), np.float32(0.9), np.float32(1.5)
_6TH, _24TH, _120TH = np.float32(1.0 / 6.0), np.float32(1.0 / 24.0), np.float32(1.0 / 120.0)
_SIXTEEN, _SPREAD = np.float32(16.0), np.float32(0.02)
_RATE_OF_WIDTH, _WIDTH_SLOPE = np.float32(32.0**-0.5), np.float32(32.0)  # v = (t - t0) rate; u^2 = 32 v^2
_ASIDE_FROM, _FLANK = np.float32(ASIDE), np.float32(ASIDE**2 / 32.0)
_BEYOND = np.float32(2.0 * SCATTER**2)
_NARROW = np.float32(0.65)  # frames; in narrower pulses time and shape are told by the same samples
_WINDOW = np.float32(AROUND * BLOCK)  # frames from the peak to the end of its window
_MISFIT = np.float32(20.0)  # reduced chi square from which it takes care to say what the pulse is
_PEAK = np.float32(16.0)  # chi square below which no sample can stand out by five sigmas, with a margin
# exp(-x) on [0, 0.9] to 4e-7, by least squares of the relative error at Chebyshev's nodes
_E0, _E1, _E2 = np.float32(0.9999996303), np.float32(-0.9999739985), np.float32(0.4996889793)
_E3, _E4, _E5 = np.float32(-0.1652590637), np.float32(0.0386884652), np.float32(-0.0052688965)

(
    _T, _A, _B, _D, _W, _RATE, _START, _BACK_WEIGHT, _ACTIVE, _T_VAR, _A_VAR, _CHI, _WORST, _STATE,
    _G0, _GB, _GBX, _GBV, _S, _SB, _SBX, _SBB, _SBBX, _SBBXX, _SQUARES, _EXCESS, _ASIDE, _SCATTER,
) = range(ROWS * LANES, (ROWS + 28) * LANES, LANES)  # fmt: skip
_ROWS = ROWS + 28


@njit(nogil=True, cache=True, error_model="numpy")
def fit_lanes(
    chosen: NDArray[np.int32], sweep: Sweep, settings: Settings, results: Floats, status: NDArray[np.uint8]
) -> None:
    """Fit the chosen pixels: their columns of `results` (4, pixels): TIME, VARIANCE, AMPLITUDE, WIDTH; their status.

    The status is OK, TOO_DARK or UNCLEAR. Results are meant where it is OK, the amplitude where it is TOO_DARK too.
    """
    camera, width, limits = settings
    half = half_span(width)
    count, others = 2 * half + 1, sweep[6].size - 2 * half - 1
    if others < 4:
        for pixel in chosen:
            status[pixel] = UNCLEAR
        return
    samples, moments = np.empty((2 * reach_of(half) + 1) * LANES, np.float32), np.empty(count * LANES, np.float32)
    fitted = samples[(reach_of(half) - half) * LANES : (reach_of(half) + half + 1) * LANES]
    work = np.zeros(_ROWS * LANES, np.float32)
    shape = (camera[3], width[0], log_growth(width), camera[2], float(count - 4))
    even = are_even(sweep[6])
    for j in range(count):
        moments[j * LANES : (j + 1) * LANES] = j - half
    for first in range(0, chosen.size, LANES):
        group = chosen[first : first + LANES]
        gather(group, sweep, (camera[0], camera[1], half), samples, work)
        if not even:
            gather_times(group, sweep, moments)
        _begin(fitted, moments, (camera[2], width[0], others), work)
        _score(fitted, moments, (camera[2], width[1]), work)
        _decide(limits, shape, work)
        if sweep[5].size > 0:
            _widen(count, work)
        for lane in range(group.size):
            pixel = group[lane]
            status[pixel] = np.uint8(work[_STATE + lane])
            results[TIME, pixel] = sweep[6][sweep[2][pixel]] + work[_T + lane]
            results[VARIANCE, pixel], results[AMPLITUDE, pixel] = work[_T_VAR + lane], work[_A + lane]
            results[WIDTH, pixel] = work[_W + lane]


@njit(nogil=True, cache=True, error_model="numpy")
def _score(samples: Floats, moments: Floats, known: tuple[float, float], work: Floats) -> None:
    dark, tolerance = np.float32(known[0]), np.float32(max(known[1], LEAST_TOLERANCE))
    for _ in range(_STEPS):
        if not _any_active(work):
            break
        for k in range(_G0, _SCATTER):
            work[k] = ZERO
        for j in range(0, samples.size, LANES):
            _accumulate(samples[j : j + LANES], moments[j : j + LANES], dark, work)
        _step(tolerance, work)


@njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy", inline="always")
def _bell(x: np.float32) -> np.float32:
    """exp(-16 x), the sixteenth power of a polynomial; zero to six digits beyond x = 0.9."""
    x = x if x < _MOST_X else _MOST_X
    root = _E0 + x * (_E1 + x * (_E2 + x * (_E3 + x * (_E4 + x * _E5))))
    root *= root
    root *= root
    root *= root
    return root * root


@njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def _begin(samples: Floats, moments: Floats, known: tuple[float, float, int], work: Floats) -> None:
    """Start of time, amplitude and background by a matched filter at the brightest frame; the background's prior.

    The moments of two Gaussians' product give the time in closed form: it lies half way between their centres.
    """
    dark, width, others = np.float32(known[0]), np.float32(known[1]), np.float32(known[2])
    rate = _RATE_OF_WIDTH / width
    for lane in range(LANES):
        work[_G0 + lane], work[_GB + lane], work[_S + lane] = ZERO, ZERO, ZERO
    for j in range(0, samples.size, LANES):
        y, t = samples[j : j + LANES], moments[j : j + LANES]
        for lane in range(LANES):
            v = t[lane] * rate
            bell = _bell(v * v)
            light = bell * (y[lane] - work[BACK + lane])
            work[_G0 + lane] += light
            work[_GB + lane] += light * t[lane]
            work[_S + lane] += bell * bell
    for lane in range(LANES):
        light, back, norm = work[_G0 + lane], work[BACK + lane], work[_S + lane]
        light = light if light > norm else norm
        shift = _within(_TWO * work[_GB + lane] / light, _REACH * width)
        half = _HALF * shift * rate
        height = light / (norm * _bell(_TWO * half * half))
        variance = (back if back > ZERO else ZERO) + dark
        spread = _SPREAD * height
        work[_T + lane], work[_START + lane], work[_A + lane], work[_B + lane] = shift, shift, height, back
        work[_D + lane], work[_W + lane], work[_RATE + lane] = ZERO, width, rate
        work[_BACK_WEIGHT + lane] = ONE / (variance / others + spread * spread)
        work[_ACTIVE + lane] = ONE if height * height * norm > _DIM * _DIM * variance else ZERO
        work[_T_VAR + lane], work[_A_VAR + lane] = ZERO, variance / norm
        work[_CHI + lane], work[_WORST + lane] = ZERO, ZERO


@njit(nogil=True, cache=True)
def _any_active(work: Floats) -> bool:
    active = ZERO
    for lane in range(LANES):
        active += work[_ACTIVE + lane]
    return bool(active > ZERO)


@njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def _accumulate(y: Floats, t: Floats, dark: np.float32, work: Floats) -> None:
    """Add one sample of every lane to the sums of score and information, chi square and the worst residual.

    With v = (t - t0) / (sqrt(32) w), x = v^2 and the bell b, the model's derivatives by time, log width, amplitude and
    background are multiples of b v, b x, b and 1: a few sums of these serve all.
    """
    for lane in range(LANES):
        v = (t[lane] - work[_T + lane]) * work[_RATE + lane]
        x = v * v
        bell = _bell(x)
        mean = work[_A + lane] * bell + work[_B + lane]
        weight = ONE / ((mean if mean > ZERO else ZERO) + dark)
        residual, worst = y[lane] - mean, work[_EXCESS + lane]
        weighted, belled = residual * weight, bell * weight
        score, square = weighted * bell, residual * residual
        worst = square if square > worst else worst
        twice = belled * bell
        further = twice * x
        work[_G0 + lane] += weighted
        work[_GB + lane] += score
        work[_GBX + lane] += score * x
        work[_GBV + lane] += score * v
        work[_S + lane] += weight
        work[_SB + lane] += belled
        work[_SBX + lane] += belled * x
        work[_SBB + lane] += twice
        work[_SBBX + lane] += further
        work[_SBBXX + lane] += further * x
        square *= weight
        work[_SQUARES + lane] += square
        work[_ASIDE + lane] += square if x > _FLANK else ZERO
        work[_EXCESS + lane] = worst


@njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def _step(tolerance: np.float32, work: Floats) -> None:
    """One step of Fisher scoring in the lanes that still move.

    The time is odd about the pulse, background, width and amplitude are even: the two parts are solved apart, the
    second by Cholesky in this order, so that the variance of the last is the inverse square of the last element.
    """
    for lane in range(LANES):
        active, old, width, rate = work[_ACTIVE + lane], work[_A + lane], work[_W + lane], work[_RATE + lane]
        slope = old * _WIDTH_SLOPE  # derivative by log width over b x
        prior = ONE / (tolerance * slope)
        weight, prior = work[_BACK_WEIGHT + lane], prior * prior
        r0 = ONE / math.sqrt(work[_S + lane] + weight)
        l10, l20 = work[_SBX + lane] * r0, work[_SB + lane] * r0
        r1 = ONE / math.sqrt(work[_SBBXX + lane] + prior - l10 * l10)
        l21 = (work[_SBBX + lane] - l20 * l10) * r1
        r2 = ONE / math.sqrt(work[_SBB + lane] - l20 * l20 - l21 * l21)
        z0 = (work[_G0 + lane] + weight * (work[BACK + lane] - work[_B + lane])) * r0
        z1 = (work[_GBX + lane] - prior * slope * work[_D + lane] - l10 * z0) * r1
        z2 = (work[_GB + lane] - l20 * z0 - l21 * z1) * r2
        height = z2 * r2
        log_width = (z1 - l21 * height) * r1
        back = (z0 - l10 * log_width - l20 * height) * r0
        log_width /= slope
        information = work[_SBBX + lane]
        scale = ONE / (_TWO * _SIXTEEN * old * rate)  # the derivative by time is b v over it
        time = work[_GBV + lane] / information * scale
        variance = scale * scale / information
        settled = z0 * z0 + z1 * z1 + z2 * z2 + time * time / variance < _TOLERANCE
        moving, noise = active > ZERO, r2 * r2
        t_var, a_var, chi, worst = work[_T_VAR + lane], work[_A_VAR + lane], work[_CHI + lane], work[_WORST + lane]
        squares, excess, aside = work[_SQUARES + lane], work[_EXCESS + lane], work[_ASIDE + lane]
        scatter = work[_SCATTER + lane]  # all are loaded before the choice: a branch otherwise
        work[_T_VAR + lane] = variance if moving else t_var
        work[_A_VAR + lane] = noise if moving else a_var
        work[_CHI + lane] = squares if moving else chi
        work[_SCATTER + lane] = aside if moving else scatter
        work[_WORST + lane] = excess if moving else worst
        work[_T + lane] += _within(time, width) * active
        height = old + height * active
        work[_A + lane] = height if height > _FIFTH * old else _FIFTH * old
        work[_B + lane] += back * active
        log_width = _within(log_width, _HALF) * active
        width *= _growth(log_width)
        work[_D + lane] += log_width
        work[_W + lane], work[_RATE + lane] = width, _RATE_OF_WIDTH / width
        work[_ACTIVE + lane] = ZERO if settled else active


@njit(nogil=True, cache=True, inline="always")
def _within(x: np.float32, limit: np.float32) -> np.float32:
    x = x if x < limit else limit
    return x if x > -limit else -limit


@njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def _growth(x: np.float32) -> np.float32:
    """exp(x) for |x| <= 1/2, as a square of the first terms of its series, to 2e-6."""
    half = x * _HALF
    root = ONE + half * (ONE + half * (_HALF + half * (_6TH + half * (_24TH + half * _120TH))))
    return root * root


@njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def _decide(limits: Limits, shape: tuple[float, float, float, float, float], work: Floats) -> None:
    """TOO_DARK or OK where it is clear.

    `shape`: saturation (e), common width, allowed growth (log), dark variance, degrees of freedom.
    """
    saturation, floor, freedom = np.float32(shape[0]), np.float32(shape[3] / (shape[4] + 4.0)), np.float32(shape[4])
    significance, fraction = np.float32(limits[0]), np.float32(_CLEAR * limits[1])
    drift, growth = np.float32(_CLEAR * (1.0 + 1.5 * shape[1])), np.float32(_CLEAR * shape[2])
    clear = np.float32(_CLEAR)
    ok, dark, unclear = np.float32(OK), np.float32(TOO_DARK), np.float32(UNCLEAR)
    for lane in range(LANES):
        height, noise, chi = work[_A + lane], work[_A_VAR + lane], work[_CHI + lane]
        noise = significance * math.sqrt(noise if noise > floor else floor)
        sound = (work[TOP + lane] < saturation) & (work[_ACTIVE + lane] == ZERO) & (work[WHOLE + lane] > ZERO)
        limit = fraction * height
        edge = _WINDOW * work[_RATE + lane]
        edge = _bell(edge * edge)
        single = (work[_WORST + lane] < limit * limit) | (chi < _PEAK)
        back, fitted = work[BACK + lane], work[_B + lane]
        single &= work[FAR + lane] - (back if back < fitted else fitted) < limit + edge * height
        near = abs(work[_T + lane] - work[_START + lane]) < drift
        alike = (abs(work[_D + lane]) < growth) & (work[_W + lane] > _NARROW)
        good = single & near & alike & (height * clear > noise) & (chi < _MISFIT * freedom)
        state = ok if good else unclear
        state = dark if height < clear * noise else state
        work[_STATE + lane] = state if sound else unclear


@njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def _widen(count: int, work: Floats) -> None:
    """Scale variances where the background scatters more than its noise: the light moves, and not alike everywhere."""
    samples = np.float32(count)
    for lane in range(LANES):
        aside, variance = samples - _ASIDE_FROM * _TWO * work[_W + lane], work[_T_VAR + lane]
        aside = aside if aside > _TWO else _TWO
        ratio = work[_SCATTER + lane] / aside
        excess = ratio - ONE
        work[_T_VAR + lane] = variance * ratio if excess * abs(excess) * aside > _BEYOND else variance
