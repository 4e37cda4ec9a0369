"""The Gaussian pulse that a passing stripe leaves in one pixel: its maximum-likelihood fit as a compiled loop.

Model in electrons: m(t) = A exp(-(t - t0)^2 / 2 w^2) + B with variance m + dark variance. Fisher scoring on t0, A, B
and log w; B and log w carry priors (the pixel's other frames; the stripe's common width). A saturated sample pulls only
where the model stays below saturation, and carries no information. The NumPy twin is tests/reference/space_time.py.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.laser.block_maxima import AROUND, BLOCK, WINDOW

TIME, VARIANCE, AMPLITUDE, AMPLITUDE_VARIANCE, BACKGROUND, WIDTH, STATUS, COST = range(8)
FIELDS = 8
UNWANTED = -2  # in place of the brightest frame of a pixel outside the mask
OK, TOO_DARK, CUT_OFF, DOUBLE, SATURATED, DISTORTED, NOT_WANTED = range(7)
LEAST_TOLERANCE = 1e-6  # of the width's logarithm: a fixed width

_ITERATIONS = 25
_TOLERANCE = 1e-3  # of the time's own sigma; the same share of amplitude and width, times ten
_LEAST_PIVOT = 1e-10  # of a diagonal element; what is left of less is rounding (1e-16), and the samples do not tell it
_GROWTH = 2.0  # a pulse wider than this many common widths (or e^3 tolerance), or as much narrower, is none
SCATTER = 5.0  # sigmas of chi square beyond which the samples beside a pulse scatter more than their noise
ASIDE = 2.8  # widths from the peak where these begin

_Vector = NDArray[np.float64]
# frames (t, pixels), number of their first row (pixels,), brightest frame, highest samples (3, pixels: of all, outside
# the window, outside the short one), sum of frames, change of the ambient light relative to its mean (n,) or empty,
# times (n,)
Sweep = tuple[
    NDArray[np.uint16],
    NDArray[np.int32],
    NDArray[np.int32],
    NDArray[np.uint16],
    NDArray[np.uint64],
    NDArray[np.float32],
    _Vector,
]
Camera = tuple[float, float, float, float]  # black_dn, gain_e_per_dn, dark variance (e2), saturation (e)
Width = tuple[float, float, float]  # common width in frames, one sigma of its logarithm, half of the fitted span
Limits = tuple[float, float]  # significance of the amplitude, height of another peak that spoils, relative
Settings = tuple[Camera, Width, Limits]
_About = tuple[float, float, float, float, float, float]  # peak, B, frames behind B, far peak (e), first, last time
_Model = tuple[float, float, float, float, float, float]  # dark, saturation, B, its weight, log w, its weight


@njit(nogil=True, cache=True)
def fit_pixel(pixel: int, sweep: Sweep, settings: Settings, row: _Vector) -> None:
    """Fit one pixel into `row` (FIELDS,): TIME, VARIANCE, ... ; without a pulse the numbers are NaN or mean nothing."""
    _, _, brightest, maxima, total, ambient, times = sweep
    camera, width, limits = settings
    row[:] = np.nan
    row[AMPLITUDE], row[STATUS] = 0.0, TOO_DARK
    samples, moments = np.empty(WINDOW), np.empty(WINDOW)
    half = half_span(width)
    count, fitted, summed_dn = _gather(pixel, sweep, half, samples, moments)
    if count < 4:
        row[STATUS] = CUT_OFF
        return
    peak, others = brightest[pixel], times.size - fitted
    samples = (samples[:count] - camera[0]) * camera[1]
    moments = moments[:count]
    background = samples.min()
    if others >= 4:
        background = ((total[pixel] - summed_dn) / others - camera[0]) * camera[1]
        if ambient.size > 0:
            start = max(first_of_window(peak), 0)
            samples -= background * (ambient[start : start + count] - ambient[peak])
            background *= 1.0 + ambient[peak]
    far_e = (maxima[1, pixel] - camera[0]) * camera[1]
    about = (times[peak], background, float(others), far_e, times[0], times[-1])
    _fit(samples, moments, about, camera, width, row)
    if ambient.size > 0:
        row[VARIANCE] *= _scatter(samples, moments, row, camera, width[2])
    row[STATUS] = _status(samples, moments, about, camera, (width[0], log_growth(width), *limits), row)


@njit(nogil=True, cache=True)
def first_of_window(brightest: int) -> int:
    """Number of the first frame of a pixel's window; negative where the sweep begins inside it."""
    return (brightest // BLOCK - AROUND) * BLOCK


def first_frames(brightest: NDArray[np.int32]) -> NDArray[np.int32]:
    """The same of many pixels."""
    return ((brightest // BLOCK - AROUND) * BLOCK).astype(np.int32)


@njit(nogil=True, cache=True)
def log_growth(width: Width) -> float:
    """How far the logarithm of a pulse's width may be from the common one."""
    return max(math.log(_GROWTH), 3.0 * width[1])


@njit(nogil=True, cache=True)
def window_edge(width: float) -> float:
    """What is left of a pulse, relative, where its window ends: much of one that is wider than was expected."""
    edge = AROUND * BLOCK / width
    return math.exp(-0.5 * edge * edge)


@njit(nogil=True, cache=True)
def half_span(width: Width) -> int:
    """Frames on either side of the brightest that the pulse is fitted to; the background is the mean of all others."""
    return min(int(width[2]), WINDOW // 2 - 2)


@njit(nogil=True, cache=True)
def _gather(pixel: int, sweep: Sweep, half: int, samples: _Vector, moments: _Vector) -> tuple[int, int, float]:
    """Fill samples (counts) and their times; return the number of all, of those to be fitted, and the sum of these."""
    frames, origin, brightest, _, _, _, times = sweep
    start = first_of_window(brightest[pixel])
    count, fitted, summed_dn = 0, 0, 0.0
    for frame in range(max(start, 0), min(start + WINDOW, times.size)):
        samples[count] = frames[frame - origin[pixel], pixel]
        moments[count] = times[frame]
        if abs(frame - brightest[pixel]) <= half:
            summed_dn += samples[count]
            fitted += 1
        count += 1
    return count, fitted, summed_dn


@njit(nogil=True, cache=True)
def _fit(samples: _Vector, moments: _Vector, about: _About, camera: Camera, width: Width, row: _Vector) -> None:
    """Fill `row` but for the status, which is DISTORTED where the fit did not come to rest: the start then stands."""
    peak, background, others, _, _, _ = about
    dark, saturation = camera[2], camera[3]
    theta = _start(samples, moments, peak, background, width[0], saturation)
    noise = (max(background, 0.0) + dark) / max(others, 1.0)
    spread = (0.02 if others >= 4 else 0.1) * theta[1]
    tolerance = max(width[1], LEAST_TOLERANCE)
    model = (dark, saturation, background, 1.0 / (noise + spread**2), math.log(width[0]), tolerance**-2)
    centre = theta[0] if samples.max() >= saturation else peak  # of a clipped top the brightest is but the first
    first, last = _span(moments, centre, width[2])
    start, height = theta[0], theta[1]
    converged = _score(samples[first:last], moments[first:last], theta, model)
    system = np.empty((5, 4))
    row[COST] = _normal(samples[first:last], moments[first:last], theta, model, True, system)
    row[TIME] = theta[0]
    row[VARIANCE] = _variance(system, 0)
    row[AMPLITUDE], row[AMPLITUDE_VARIANCE] = theta[1], _variance(system, 1)
    row[BACKGROUND], row[WIDTH] = theta[2], math.exp(theta[3])
    if not converged or row[VARIANCE] <= 0.0 or abs(theta[0] - start) > 1.0 + 1.5 * width[0]:
        row[STATUS] = DISTORTED
        row[TIME], row[WIDTH], row[BACKGROUND] = start, width[0], background
        row[AMPLITUDE], row[AMPLITUDE_VARIANCE] = height, max(background, 0.0) + height + dark


@njit(nogil=True, cache=True)
def _status(
    samples: _Vector,
    moments: _Vector,
    about: _About,
    camera: Camera,
    limits: tuple[float, float, float, float],
    row: _Vector,
) -> int:
    """What the fit in `row` amounts to, the first that applies."""
    peak, background, _, second_e, first_time, last_time = about
    common_width, growth, significance, fraction = limits
    noise = math.sqrt(max(row[AMPLITUDE_VARIANCE], camera[2] / samples.size))
    cut = peak <= first_time or peak >= last_time
    status = OK
    if not row[AMPLITUDE] > significance * noise:
        status = TOO_DARK
    elif cut or min(row[TIME] - first_time, last_time - row[TIME]) < row[WIDTH]:
        status = CUT_OFF
    elif row[STATUS] == DISTORTED or abs(math.log(row[WIDTH] / common_width)) > growth:
        status = DISTORTED
    elif not _flanked(samples, moments, camera, row):
        status = SATURATED
    elif second_e - background > (fraction + window_edge(row[WIDTH])) * row[AMPLITUDE] or _second_peak(
        samples, moments, camera, fraction, row
    ):
        status = DOUBLE
    return status


@njit(nogil=True, cache=True)
def _start(
    samples: _Vector, moments: _Vector, peak: float, background: float, width: float, saturation: float
) -> _Vector:
    """Starting t0, A, B, log w: the best of a matched filter around the peak, or the middle of the clipped samples."""
    theta = np.array([peak, 0.0, background, math.log(width)])
    clipped, middle = 0, 0.0
    for k in range(samples.size):
        if samples[k] >= saturation:
            clipped += 1
            middle += moments[k]
    if clipped > 0:
        theta[0], theta[1] = middle / clipped, 1.2 * (saturation - background)
        return theta
    best = -np.inf
    for centre in moments:
        if abs(centre - peak) > 3.0:
            continue
        norm, product = 0.0, 0.0
        for k in range(samples.size):
            bell = math.exp(-0.5 * ((moments[k] - centre) / width) ** 2)
            norm += bell * bell
            product += bell * (samples[k] - background)
        if product / math.sqrt(norm) > best:
            best = product / math.sqrt(norm)
            theta[0], theta[1] = centre, max(product / norm, 1.0)
    return theta


@njit(nogil=True, cache=True)
def _span(moments: _Vector, centre: float, half: float) -> tuple[int, int]:
    first, last = 0, moments.size
    while first < last - 4 and centre - moments[first] > half:
        first += 1
    while last > first + 4 and moments[last - 1] - centre > half:
        last -= 1
    return first, last


@njit(nogil=True, cache=True)
def _score(samples: _Vector, moments: _Vector, theta: _Vector, model: _Model) -> bool:
    """Fisher scoring of `theta` in place; whether it came to rest."""
    system = np.empty((5, 4))
    step = system[4]
    for _ in range(_ITERATIONS):
        _normal(samples, moments, theta, model, False, system)
        time_weight = system[0, 0]
        if not _solve(system, step):
            return False
        width = math.exp(theta[3])
        theta[0] += min(max(step[0], -width), width)
        theta[1] = min(max(theta[1] + step[1], 0.2 * theta[1]), 20.0 * model[1])
        theta[2] += step[2]
        theta[3] += min(max(step[3], -0.5), 0.5)
        settled = abs(step[0]) * math.sqrt(time_weight) < _TOLERANCE
        if settled and abs(step[1]) < 10.0 * _TOLERANCE * theta[1] and abs(step[3]) < 10.0 * _TOLERANCE:
            return True
    return False


@njit(nogil=True, cache=True)
def _normal(
    samples: _Vector, moments: _Vector, theta: _Vector, model: _Model, informative: bool, system: _Vector
) -> float:
    """Fisher information (rows 0 to 3) and score (row 4) at `theta`; returns -2 log likelihood up to a constant.

    Where `informative`, saturated samples are left out of the information, as the reported variance must be.
    """
    dark, saturation, background, background_weight, log_width, width_weight = model
    width = math.exp(theta[3])
    jacobian, gradient = np.empty(4), system[4]
    system[:] = 0.0
    system[2, 2], system[3, 3] = background_weight, width_weight
    gradient[2] = background_weight * (background - theta[2])
    gradient[3] = width_weight * (log_width - theta[3])
    cost: float = gradient[2] ** 2 / background_weight + gradient[3] ** 2 / width_weight
    for k in range(samples.size):
        u = (moments[k] - theta[0]) / width
        bell = math.exp(-0.5 * u * u)
        mean = theta[1] * bell + theta[2]
        variance = max(mean, 0.0) + dark
        residual = samples[k] - mean
        if samples[k] >= saturation and (informative or residual <= 0.0):
            continue
        jacobian[0], jacobian[1] = theta[1] * bell * u / width, bell
        jacobian[2], jacobian[3] = 1.0, theta[1] * bell * u * u
        cost += residual * residual / variance + math.log(variance)
        for i in range(4):
            gradient[i] += jacobian[i] * residual / variance
            for j in range(i + 1):
                system[i, j] += jacobian[i] * jacobian[j] / variance
    return cost


@njit(nogil=True, cache=True)
def _solve(matrix: _Vector, vector: _Vector) -> bool:
    """Solve in place by Cholesky; the first four rows of `matrix` hold its lower half. False where not positive."""
    for i in range(4):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i > j:
                matrix[i, j] = total / matrix[j, j]
            elif total > _LEAST_PIVOT * matrix[i, i]:
                matrix[i, i] = math.sqrt(total)
            else:
                return False
    for i in range(4):
        for k in range(i):
            vector[i] -= matrix[i, k] * vector[k]
        vector[i] /= matrix[i, i]
    for i in range(3, -1, -1):
        for k in range(i + 1, 4):
            vector[i] -= matrix[k, i] * vector[k]
        vector[i] /= matrix[i, i]
    return True


@njit(nogil=True, cache=True)
def _variance(information: _Vector, index: int) -> float:
    """Diagonal element of the inverse, or -1 where there is none."""
    unit = np.zeros(4)
    unit[index] = 1.0
    solved = _solve(information.copy(), unit)
    variance: float = unit[index] if solved else -1.0
    return variance


@njit(nogil=True, cache=True)
def _scatter(samples: _Vector, moments: _Vector, row: _Vector, camera: Camera, half: float) -> float:
    """Factor of the variance where the background scatters more than its noise beyond doubt: its reduced chi square."""
    chi_square, count = 0.0, 0
    for k in range(samples.size):
        u = (moments[k] - row[TIME]) / row[WIDTH]
        count += abs(moments[k] - row[TIME]) <= half
        if ASIDE < abs(u) <= half / row[WIDTH] and samples[k] < camera[3]:
            mean = row[AMPLITUDE] * math.exp(-0.5 * u * u) + row[BACKGROUND]
            chi_square += (samples[k] - mean) ** 2 / (max(mean, 0.0) + camera[2])
    aside = max(count - 2.0 * ASIDE * row[WIDTH], 2.0)
    ratio = chi_square / aside
    return ratio if ratio > 1.0 + SCATTER * math.sqrt(2.0 / aside) else 1.0


@njit(nogil=True, cache=True)
def _flanked(samples: _Vector, moments: _Vector, camera: Camera, row: _Vector) -> bool:
    """Whether the pulse is unclipped, or unclipped samples show it on both sides."""
    clipped, before, after = False, False, False
    for k in range(samples.size):
        u = (moments[k] - row[TIME]) / row[WIDTH]
        light = row[AMPLITUDE] * math.exp(-0.5 * u * u)
        if samples[k] >= camera[3]:
            clipped = True
        elif light > 3.0 * math.sqrt(light + max(row[BACKGROUND], 0.0) + camera[2]):
            before, after = before or u < 0.0, after or u > 0.0
    return not clipped or (before and after)


@njit(nogil=True, cache=True)
def _second_peak(samples: _Vector, moments: _Vector, camera: Camera, fraction: float, row: _Vector) -> bool:
    """Whether any sample exceeds the fitted pulse by a fraction of its height, beyond noise."""
    for k in range(samples.size):
        u = (moments[k] - row[TIME]) / row[WIDTH]
        mean = row[AMPLITUDE] * math.exp(-0.5 * u * u) + row[BACKGROUND]
        excess = samples[k] - mean
        noise = math.sqrt(max(mean, 0.0) + camera[2])
        if samples[k] < camera[3] and excess > fraction * row[AMPLITUDE] and excess > 5.0 * noise:
            return True
    return False
