"""Smooth response curves of three channels by maximum evidence, and the noise of their codes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.linalg import block_diag, cho_solve, cholesky, solve_triangular
from scipy.optimize import nnls

from processing.radiometry.response_kernel import CODES, PER_SIGMA

Array = NDArray[np.float64]
MIDDLE = 128  # the code whose log exposure is 0
ROUNDING_DN2 = 1 / 12
_INTERVALS = 20
_SHARED, _OWN = (3, 3.0, 8.0), (2, 2.0, 9.0)  # order of the penalised difference, range of its decimal logarithm
_TILT = 0.03  # share of the first differences in the penalty on the channels' own deviations
_TIME_SIGMA = 0.002, 0.5  # how well a stated exposure is believed, at best and at worst
JUDGED_FRAMES = 4  # fewer cannot tell a wrong exposure from a bent curve
# Of a stated exposure that cannot be judged: rounded labels alone (1/60 for 1/64) are off by as much.
_UNJUDGED_SIGMA = 0.04
_RIDGE = 1e-3  # for what neither data nor penalty determine: against 1 in log exposure
_TRUNCATED = 0.9733  # variance of a normal distribution within three standard deviations


def spline_basis() -> Array:
    """Cubic B-splines (256, n) over the codes, 0 at the middle one.

    Even on the axis ln((code + 8) / (263 - code)): curves bend most at both ends, where film and eye compress.
    """
    code = np.arange(CODES)
    axis = np.log((code + 8) / (CODES + 7 - code))
    step = (axis[-1] - axis[0]) / _INTERVALS
    knots = axis[0] + step * np.arange(-3, _INTERVALS + 4)
    basis = BSpline.design_matrix(np.clip(axis, knots[3], knots[-4] - 1e-9), knots, 3).toarray()
    return np.asarray(basis - basis[MIDDLE], np.float64)


@dataclass(frozen=True, slots=True)
class Equations:
    """Normal equations of one channel by image tile: `matrix` (tiles, m, m), `right` (tiles, m) of a change.

    m = n + k: coefficients of the curve, then log exposures of the frames.
    """

    matrix: Array
    right: Array


@dataclass(frozen=True, slots=True)
class Smooth:
    """A fit: `coefficients` (channels, n) of the curves and their `covariance` (channels, n, n).

    `log_time` (k,): by how much each frame was exposed longer than stated, and `time_sigma` (k,), how far each stated
    exposure is believed. `smoothness`: decimal logarithm of the penalty on the shared curve and on the channels' own.
    """

    coefficients: Array
    covariance: Array
    log_time: Array
    time_sigma: Array
    smoothness: tuple[float, float] = (4.0, 4.0)


def design_effect(equations: list[Equations]) -> float:
    """How many pixels count as one, by the scatter of the score between image tiles; 1 or more.

    Neighbours share the errors of JPEG blocks, and a part of the scene that moved is wrong as a whole.
    """
    scatter, freedom = 0.0, 0
    for channel in equations:
        values, vectors = np.linalg.eigh(channel.matrix.sum(axis=0))
        known = values > 1e-6 * max(values[-1], 1e-300)
        score = (channel.right - channel.right.mean(axis=0)) @ vectors[:, known]
        tiles = len(channel.right)
        scatter += float((score**2 / values[known]).sum()) * tiles / (tiles - 1)
        freedom += int(known.sum())
    return max(scatter / max(freedom, 1), 1.0)


def smooth_curves(equations: list[Equations], present: Smooth, *, climb: bool) -> Smooth:
    """Curves of the channels at the greatest evidence: one shared curve and each channel's own deviation from it.

    The equations were taken at `present`. The shared curve's third differences, the deviations' first ones and the
    frames' log times are Gaussian a priori; the evidence (marginal likelihood, MacKay 1992) weighs each against the
    data: channels that agree share one curve, and a stated exposure is believed until the pictures contradict it.
    `climb`: whether the smoothness may still change.
    """
    effect = design_effect(equations)
    channels, size = present.coefficients.shape
    frames = len(present.log_time)
    takes = [_take(c, channels, size, frames) for c in range(channels)]
    joint, right = np.zeros((takes[0].shape[1],) * 2), np.zeros(takes[0].shape[1])
    for channel, take, coefficients in zip(equations, takes, present.coefficients, strict=True):
        matrix = channel.matrix.sum(axis=0) / effect
        joint += take.T @ matrix @ take
        at = np.concatenate([coefficients, present.log_time])
        right += take.T @ (channel.right.sum(axis=0) / effect + matrix @ at)
    times = np.arange(len(joint) - frames, len(joint))
    joint[times, times] += 1 / present.time_sigma**2
    penalties = _penalties(channels, size, frames)
    smoothness = _climb(joint, right, penalties, present.smoothness) if climb else present.smoothness
    factor = cholesky(_precision(joint, penalties, smoothness), lower=True)
    solution = cho_solve((factor, True), right)
    spread = cho_solve((factor, True), np.eye(len(joint)))
    log_time = solution[times]
    time_sigma = present.time_sigma
    if frames >= JUDGED_FRAMES:
        time_sigma = _believed(log_time, np.diag(spread)[times], time_sigma)
    else:
        spread = _with_unjudged_times(spread, times)
    covariance = np.stack([take @ spread @ take.T for take in takes])[:, :size, :size]
    curves = np.stack([(take @ solution)[:size] for take in takes])
    return Smooth(curves, covariance, log_time, time_sigma, smoothness)


def _with_unjudged_times(covariance: Array, times: NDArray[np.intp]) -> Array:
    """The covariance, where log times may be off by more than the fit believed: what follows them moves with them."""
    follows = np.linalg.solve(covariance[np.ix_(times, times)], covariance[times])
    return np.asarray(covariance + _UNJUDGED_SIGMA**2 * follows.T @ follows, np.float64)


def believed_times(equations: list[Equations], log_time: Array, time_sigma: Array) -> tuple[Array, Array]:
    """The same for the frames' log times (k,) alone, under known curves; returns them and how far each is believed."""
    effect = design_effect(equations)
    matrix = sum((channel.matrix.sum(axis=0) for channel in equations), np.zeros((len(log_time),) * 2)) / effect
    right = sum((channel.right.sum(axis=0) for channel in equations), np.zeros(len(log_time))) / effect
    covariance = np.linalg.inv(matrix + np.diag(1 / time_sigma**2))
    found = covariance @ (right + matrix @ log_time)
    return found, _believed(found, np.diag(covariance), time_sigma)


def _believed(log_time: Array, variance: Array, time_sigma: Array) -> Array:
    """MacKay's update of each prior: by the share that the data determine, 1 - variance over that of the prior."""
    determined = np.maximum(1 - variance / time_sigma**2, 1e-6)
    return np.asarray(np.clip(np.abs(log_time) / np.sqrt(determined), *_TIME_SIGMA), np.float64)


def _take(channel: int, channels: int, size: int, frames: int) -> Array:
    """The channel's unknowns from the joint ones, (size + frames, joint): shared plus own curve; the frames' times."""
    curve = np.zeros((size, 1 + channels, size))
    curve[:, 0], curve[:, 1 + channel] = np.eye(size), np.eye(size)
    return block_diag(curve.reshape(size, -1), np.eye(frames))


@dataclass(frozen=True, slots=True)
class _Penalty:
    matrix: Array
    rank: int


def _penalties(channels: int, size: int, frames: int) -> tuple[_Penalty, _Penalty]:
    """Of the shared curve, and of all the channels' own deviations."""

    def differences(order: int) -> Array:
        rows = np.diff(np.eye(size), order, axis=0)
        return np.asarray(rows.T @ rows, np.float64)

    shared, own = np.zeros(1 + channels), np.ones(1 + channels)
    shared[0], own[0] = 1, 0
    bent = differences(_OWN[0]) + _TILT * differences(1)
    none = np.zeros((frames, frames))
    return (
        _Penalty(block_diag(np.kron(np.diag(shared), differences(_SHARED[0])), none), size - _SHARED[0]),
        _Penalty(block_diag(np.kron(np.diag(own), bent), none), channels * (size - 1)),
    )


def _precision(joint: Array, penalties: tuple[_Penalty, _Penalty], smoothness: tuple[float, float]) -> Array:
    shared, own = (10.0**s * p.matrix for s, p in zip(smoothness, penalties, strict=True))
    return np.asarray(joint + shared + own + _RIDGE * np.eye(len(joint)), np.float64)


def _evidence(
    joint: Array, right: Array, penalties: tuple[_Penalty, _Penalty], smoothness: tuple[float, float]
) -> float:
    factor = cholesky(_precision(joint, penalties, smoothness), lower=True)
    whitened = solve_triangular(factor, right, lower=True)
    prior = 0.5 * np.log(10) * sum(penalty.rank * s for penalty, s in zip(penalties, smoothness, strict=True))
    return float(prior - np.log(np.diag(factor)).sum() + 0.5 * whitened @ whitened)


def _climb(
    joint: Array, right: Array, penalties: tuple[_Penalty, _Penalty], smoothness: tuple[float, float]
) -> tuple[float, float]:
    """Greatest evidence over both smoothnesses by coordinate steps of two decades, one, a half."""
    best, height = smoothness, _evidence(joint, right, penalties, smoothness)
    step = 2.0
    while step >= 0.5:
        moved = False
        for d_shared, d_own in ((step, 0.0), (-step, 0.0), (0.0, step), (0.0, -step)):
            shared = min(max(best[0] + d_shared, _SHARED[1]), _SHARED[2])
            own = min(max(best[1] + d_own, _OWN[1]), _OWN[2])
            if (shared, own) != best and (found := _evidence(joint, right, penalties, (shared, own))) > height:
                best, height, moved = (shared, own), found, True
        step = step if moved else step / 2
    return best


def code_noise(histogram: Array, sigma_dn: Array, light: Array) -> tuple[Array, float]:
    """Noise of every code (256,) from residuals in units of `sigma_dn`, and its part after the curve; both in codes.

    Variance = coding + (read + shot light) / slope of the light by code squared, each part not negative: rounding and
    JPEG come after the curve, the sensor's noise before it. The residuals' bulk counts, within three deviations.
    """
    count = histogram.sum(axis=1)
    measured = count >= 50
    if not measured.any():
        return sigma_dn, float(sigma_dn.min())
    observed = (_bulk_sigma(histogram[measured]) * sigma_dn[measured]) ** 2
    slope2 = np.maximum(np.gradient(light), 1e-9) ** 2
    parts = np.stack([np.ones(CODES), 1 / slope2, light / slope2], axis=1)
    scale = parts[measured].max(axis=0)
    variance = np.full(CODES, np.median(observed))
    for _ in range(4):
        trust = np.sqrt(count[measured]) / np.maximum(variance[measured], ROUNDING_DN2)
        found, _ = nnls(parts[measured] / scale * trust[:, None], observed * trust)
        variance = parts @ (found / scale)
    return np.sqrt(np.maximum(variance, ROUNDING_DN2)), float(np.sqrt(max(found[0] / scale[0], ROUNDING_DN2)))


def _bulk_sigma(histogram: Array) -> Array:
    """Standard deviation of each row of a histogram of absolute values, by its part within three of them."""
    centre = (np.arange(histogram.shape[1]) + 0.5) / PER_SIGMA
    total = histogram.cumsum(axis=1)
    sigma = 1.4826 * centre[np.argmax(total >= 0.5 * total[:, -1:], axis=1)]
    for _ in range(6):
        inside = histogram * (centre < 3 * sigma[:, None])
        sigma = np.sqrt(inside @ centre**2 / np.maximum(inside.sum(axis=1), 1) / _TRUNCATED)
    return np.asarray(sigma, np.float64)
