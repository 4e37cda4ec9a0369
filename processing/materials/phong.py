"""Blinn-Phong from reflectance samples, by variable projection over the exponent.

For a given exponent n the model k_d (N.L) + k_s (N.H)^n is linear in k_d and k_s, so only n is searched: first on a
grid over its whole range, then within the best cell. There is no start value and nothing to blow up. What depends on
n depends on N.H alone; one pass over the samples gathers sums over fine bins of the half angle, the search runs on
those, and the result is solved once more on the samples themselves.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from processing.errors import ConvergenceError
from processing.products import BlinnPhong
from processing.products.arrays import Float64

SMALLEST_EXPONENT = 1.0  # a broader lobe imitates the diffuse term
_LARGEST_EXPONENT = 1e5  # half maximum at 0.2 deg
_SMALLEST_COUNT_IN_LOBE = 8
_DISTINCT_ANGLES_RAD = 1e-3
_BINS = 8192  # 0.011 deg: (N.H)^n is off by less than n * 5e-9 between two of them
_LOG_COSINE = np.log(np.maximum(np.cos(np.linspace(0, np.pi / 2, _BINS)), 1e-300))
_GRID = 32
_BINS_IN_GRID = 4
_CHUNK = 4096  # samples that one thread takes at a time; sums are added in the chunks' order


class FitStatus(IntEnum):
    """How a fit ended."""

    CONVERGED = 0  # at a minimum within the bounds
    AT_BOUND = 1  # a parameter rests on its bound: the data does not determine it
    TOO_FEW_SAMPLES = 2  # fewer valid samples than parameters
    DIVERGED = 3  # no finite minimum, as for values at the end of the number range


@dataclass(frozen=True, eq=False)
class LobeSamples:
    """Reflectance samples of one lobe, cosine inside: `value` (m, 3) over `cos_light` N.L and `cos_half` N.H (m,).

    `variance` (m, 3) weighs them where it is known; one that is not finite and positive marks an invalid sample, as
    does a value or a cosine that is not finite, or light from under the horizon.
    """

    value: Float64
    cos_light: Float64
    cos_half: Float64
    variance: Float64 | None = None

    def weights(self) -> Float64:
        """Inverse variances (m, 3) over their largest; 1 where no variance is known, 0 for invalid samples."""
        lit = (self.cos_light > 0) & np.isfinite(self.cos_light) & np.isfinite(self.cos_half)
        valid = np.isfinite(self.value) & lit[:, None]
        if self.variance is None:
            return valid.astype(np.float64)
        valid &= self.variance > 0  # an infinite one leaves a weight of 0
        smallest = np.min(self.variance, where=valid, initial=np.inf)
        return np.where(valid, smallest / np.where(valid, self.variance, 1.0), 0.0)


@dataclass(frozen=True, eq=False)
class PhongFit:
    """A fitted lobe; `covariance` (7, 7) orders diffuse, specular, exponent; `mse` (3,) is over all valid samples.

    The covariance is that of the given variances, or, without them, of the residual's own size; parameters that
    rest on a bound have zeros.
    """

    phong: BlinnPhong
    covariance: Float64
    mse: Float64
    samples: int
    status: FitStatus

    def check(self) -> "PhongFit":
        """This fit, or ConvergenceError where it has no lobe to offer."""
        if self.status in (FitStatus.TOO_FEW_SAMPLES, FitStatus.DIVERGED):
            raise ConvergenceError(f"Blinn-Phong fit: {self.status.name.lower()} with {self.samples} valid samples")
        return self


def fit_blinn_phong(samples: LobeSamples) -> PhongFit:
    """Weighted least squares with k_d, k_s >= 0 per channel and one exponent n for all channels.

    The values are scaled to order one first, so any unit gives the same lobe; n stays within
    `sampled_exponents`. Never raises; see `PhongFit.status`.
    """
    weights = samples.weights()
    counts, any_channel = _counts(weights)
    count = int(any_channel.sum())
    if counts.min() < 3:
        return no_fit(FitStatus.TOO_FEW_SAMPLES, count)
    scale = _power_of_two(float(np.max(np.abs(samples.value), where=weights > 0, initial=0.0)))
    if not np.isfinite(1 / scale):
        return no_fit(FitStatus.DIVERGED, count)
    value = np.where(weights > 0, samples.value, 0.0) / scale
    cos_light = np.where(any_channel, samples.cos_light, 0.0)
    cos_half = np.clip(np.where(any_channel, samples.cos_half, 0.0), 0.0, 1.0)
    problem = _Problem(value, weights, cos_light, cos_half, counts)
    bounds = sampled_exponents(cos_half[any_channel])
    return _finish(problem, problem.exponent(bounds), samples, scale, bounds)


def no_fit(status: FitStatus, samples: int) -> PhongFit:
    """A fit without a lobe: all of it zero, and why."""
    lobe = BlinnPhong(np.zeros(3), np.zeros(3), SMALLEST_EXPONENT)
    return PhongFit(lobe, np.zeros((7, 7)), np.full(3, np.nan), samples, status)


def sampled_exponents(cos_half: Float64) -> tuple[float, float]:
    """Range of exponents that samples at these N.H (m,) can tell apart.

    The narrowest lobe still has eight samples and two distinct half angles above half of its maximum; beyond that
    nothing holds n.
    """
    count = min(_SMALLEST_COUNT_IN_LOBE, len(cos_half))
    nearest = np.partition(np.clip(cos_half, 0.0, 1.0), len(cos_half) - count)
    angle = np.arccos(nearest[len(cos_half) - count :])
    distinct = nearest[nearest < np.cos(angle.min() + _DISTINCT_ANGLES_RAD)]
    second = np.arccos(distinct.max()) if len(distinct) else angle.max()
    width = max(float(angle.max()), float(second))
    with np.errstate(divide="ignore"):
        largest = float(np.log(0.5) / np.log(np.cos(np.clip(width, 1e-4, np.pi / 2))))
    return SMALLEST_EXPONENT, min(max(largest, 2 * SMALLEST_EXPONENT), _LARGEST_EXPONENT)


def average_lobes(fits: Sequence[PhongFit]) -> BlinnPhong:
    """Mean of the parameter sets of fits to single directions; raises ConvergenceError where none is usable.

    Source: Ma et al. 2004, 4.1. A joint fit of all directions has the smaller error.
    """
    usable = [fit.phong for fit in fits if fit.status in (FitStatus.CONVERGED, FitStatus.AT_BOUND)]
    if not usable:
        raise ConvergenceError(f"none of {len(fits)} single-direction fits has a lobe to average")
    return BlinnPhong(
        np.mean([lobe.diffuse for lobe in usable], axis=0),
        np.mean([lobe.specular for lobe in usable], axis=0),
        float(np.mean([lobe.exponent for lobe in usable])),
    )


@dataclass(frozen=True, eq=False)
class _Sums:
    """Normal equations of the three channels, split by half angle: what the search over n needs."""

    light_light: Float64  # (3,)
    light_value: Float64  # (3,)
    value_value: Float64  # (3,)
    by_angle: Float64  # (bins, 3, 3): sums of w, w N.L, w value per channel
    log_cosine: Float64  # (bins,): of N.H

    def coarser(self, count: int) -> "_Sums":
        """The same with so many bins at a time as one."""
        by_angle = self.by_angle.reshape(-1, count, 3, 3).sum(axis=1)
        log_cosine = self.log_cosine.reshape(-1, count).mean(axis=1)
        return _Sums(self.light_light, self.light_value, self.value_value, by_angle, log_cosine)

    def cost(self, exponents: Float64) -> Float64:
        """Weighted squared residual at the best k_d, k_s of each of the exponents (n,)."""
        lobe = np.exp(exponents[:, None] * self.log_cosine)
        half_half = lobe**2 @ self.by_angle[:, 0]
        half_light, half_value = lobe @ self.by_angle[:, 1], lobe @ self.by_angle[:, 2]
        k = solve_bounded_pair(self.light_light, half_light, half_half, self.light_value, half_value)
        quadratic = k[0] ** 2 * self.light_light + 2 * k[0] * k[1] * half_light + k[1] ** 2 * half_half
        cost = self.value_value - 2 * (k[0] * self.light_value + k[1] * half_value) + quadratic
        return np.asarray(cost.sum(axis=1), np.float64)


def solve_bounded_pair(aa: Float64, ab: Float64, bb: Float64, ay: Float64, by: Float64) -> Float64:
    """Least squares over two non-negative coefficients from their normal equations, (2, ...)."""
    aa, ab, bb, ay, by = np.broadcast_arrays(aa, ab, bb, ay, by)
    determinant = aa * bb - ab * ab
    regular = determinant > 1e-12 * aa * bb
    safe = np.where(regular, determinant, 1.0)
    first, second = (bb * ay - ab * by) / safe, (aa * by - ab * ay) / safe
    inside = regular & (first >= 0) & (second >= 0)
    only_first = np.divide(np.maximum(ay, 0.0), aa, out=np.zeros_like(aa), where=aa > 0)
    only_second = np.divide(np.maximum(by, 0.0), bb, out=np.zeros_like(bb), where=bb > 0)
    take_first = only_first * ay >= only_second * by
    return np.stack(
        [
            np.where(inside, first, np.where(take_first, only_first, 0.0)),
            np.where(inside, second, np.where(take_first, 0.0, only_second)),
        ]
    )


@numba.njit(cache=True)
def _bins(value: Float64, weights: Float64, cos_light: Float64, cos_half: Float64, count: int) -> Float64:
    sums = np.zeros((count, 3, 3))
    step = (np.pi / 2) / (count - 1)
    for i in range(len(cos_half)):
        position = np.arccos(cos_half[i]) / step
        left = min(int(position), count - 2)
        part = position - left
        for channel in range(3):
            for side in range(2):
                w = weights[i, channel] * (part if side == 1 else 1.0 - part)
                sums[left + side, 0, channel] += w
                sums[left + side, 1, channel] += w * cos_light[i]
                sums[left + side, 2, channel] += w * value[i, channel]
    return sums


@numba.njit(cache=True)
def _counts(weights: Float64) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Valid samples of each channel (3,), and which are valid in any (m,)."""
    counts, any_channel = np.zeros(3, np.int64), np.zeros(len(weights), np.bool_)
    for i in range(len(weights)):
        for channel in range(3):
            if weights[i, channel] > 0:
                counts[channel] += 1
                any_channel[i] = True
    return counts, any_channel


@dataclass(frozen=True, eq=False)
class _Problem:
    """The scaled samples, zero where they are not valid, and their `counts` (3,)."""

    value: Float64
    weights: Float64
    cos_light: Float64
    cos_half: Float64
    counts: NDArray[np.int64]

    def exponent(self, bounds: tuple[float, float]) -> float:
        """The n of least cost: the best of a grid, then within its cell."""
        products = self.products(1.0)
        by_angle = _bins(self.value, self.weights, self.cos_light, self.cos_half, _BINS)
        sums = _Sums(products[:, 0, 0], products[:, 0, 3], products[:, 3, 3], by_angle, _LOG_COSINE)
        grid = np.linspace(np.log(bounds[0]), np.log(bounds[1]), _GRID)
        best = int(np.argmin(sums.coarser(_BINS_IN_GRID).cost(np.exp(grid))))
        around = (grid[max(best - 1, 0)], grid[min(best + 1, _GRID - 1)])

        def cost(log_exponent: float) -> float:
            return float(sums.cost(np.exp([log_exponent]))[0])

        refined = minimize_scalar(cost, bounds=around, method="bounded", options={"xatol": 1e-7})
        return float(np.exp(refined.x if refined.fun <= cost(grid[best]) else grid[best]))

    def products(self, exponent: float) -> Float64:
        """Weighted inner products (3, 4, 4) of N.L, the lobe, its slope by n, and the values."""
        lower = _column_products(self.value, self.weights, self.cos_light, self.cos_half, exponent).sum(axis=0)
        return np.asarray(lower + np.tril(lower, -1).transpose(0, 2, 1), np.float64)


@numba.njit(cache=True, parallel=True)
def _column_products(
    value: Float64, weights: Float64, cos_light: Float64, cos_half: Float64, exponent: float
) -> Float64:
    """Lower triangles (chunk, 3, 4, 4) of `_Problem.products`."""
    chunks = (len(value) + _CHUNK - 1) // _CHUNK
    sums = np.zeros((chunks, 3, 4, 4))
    for chunk in numba.prange(chunks):
        row = np.empty(4)
        for i in range(chunk * _CHUNK, min((chunk + 1) * _CHUNK, len(value))):
            row[0], row[1] = cos_light[i], cos_half[i] ** exponent
            row[2] = row[1] * np.log(max(cos_half[i], 1e-12))
            for channel in range(3):
                row[3] = value[i, channel]
                for p in range(4):
                    weighted = weights[i, channel] * row[p]
                    for q in range(p + 1):
                        sums[chunk, channel, p, q] += weighted * row[q]
    return sums


@numba.njit(cache=True)
def _squares(problem: tuple[Float64, ...], k: Float64, exponent: float) -> Float64:
    """Sums (2, 3) of squared errors of valid samples, weighted and alike; `problem` has the arrays of `_Problem`."""
    value, weights, cos_light, cos_half = problem
    sums = np.zeros((2, 3))
    for i in range(len(value)):
        lobe = cos_half[i] ** exponent
        for channel in range(3):
            if weights[i, channel] > 0:
                error = value[i, channel] - k[0, channel] * cos_light[i] - k[1, channel] * lobe
                sums[0, channel] += weights[i, channel] * error * error
                sums[1, channel] += error * error
    return sums


def _information(products: Float64, k: Float64) -> Float64:
    """J^T W J (7, 7) with the parameters k_d, k_s, n."""
    matrix = np.zeros((7, 7))
    for channel in range(3):
        scale = np.array([1.0, 1.0, k[1, channel]])
        index = np.array([channel, 3 + channel, 6])
        matrix[np.ix_(index, index)] += products[channel, :3, :3] * scale * scale[:, None]
    return matrix


def _finish(
    problem: _Problem, exponent: float, samples: LobeSamples, scale: float, bounds: tuple[float, float]
) -> PhongFit:
    products = problem.products(exponent)
    k = solve_bounded_pair(*products[:, [0, 0, 1, 0, 1], [0, 1, 1, 3, 3]].T)
    arrays = (problem.value, problem.weights, problem.cos_light, problem.cos_half)
    weighted, squared = _squares(arrays, k, exponent)
    mse = squared / problem.counts
    # One unit of weight is one over the smallest variance; without variances the residual tells its own.
    unit = weighted.sum() / max(int(problem.counts.sum()) - 7, 1)
    if samples.variance is not None:
        unit = float(np.min(samples.variance, where=problem.weights > 0, initial=np.inf)) / scale / scale
    free = np.concatenate([k.ravel() > 0, [bool((k[1] > 0).any())]])
    with np.errstate(over="ignore", invalid="ignore"):  # squares beyond the range of numbers: told below
        lobe, mse = BlinnPhong(k[0] * scale, k[1] * scale, exponent), mse * scale * scale
        covariance = _covariance(_information(products, k), free, unit, scale)
    count = int(_counts(problem.weights)[1].sum())
    found = np.concatenate([lobe.diffuse, lobe.specular, [lobe.exponent], mse, covariance.ravel()])
    if not np.isfinite(found).all():
        return no_fit(FitStatus.DIVERGED, count)
    resting = not free.all() or not bounds[0] * 1.001 < exponent < bounds[1] * 0.999
    return PhongFit(lobe, covariance, mse, count, FitStatus.AT_BOUND if resting else FitStatus.CONVERGED)


def _covariance(information: Float64, free: NDArray[np.bool_], unit: float, scale: float) -> Float64:
    """Covariance (7, 7) of the parameters that are free, the others' zero, in the values' own unit."""
    covariance = np.zeros((7, 7))
    index = np.ix_(free, free)
    covariance[index] = np.linalg.pinv(information[index], hermitian=True) * unit
    units = np.array([scale] * 6 + [1.0])
    return np.asarray(covariance * units * units[:, None], np.float64)


def _power_of_two(value: float) -> float:
    """The power of two just above `value`, so that dividing by it rounds nothing; 1 for 0."""
    return float(np.ldexp(1.0, int(np.frexp(value)[1]))) if value > 0 else 1.0
