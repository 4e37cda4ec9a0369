"""The lobe of a material whose every texel also has a residual s . H: all of it in one least-squares problem.

A lobe fitted to the reflectance alone takes for its own what the residuals of the texels have in common. Here the
residual is projected out: per texel and channel nothing counts that some s . H could explain. What is left is linear
in k_d and k_s for a given exponent, so that again only the exponent is searched (variable projection, Golub and
Pereyra 1973, twice over).
"""

from dataclasses import dataclass

import numba
import numpy as np
from scipy.optimize import minimize_scalar

from processing.measurements import Measurements
from processing.phong import FitStatus, PhongFit, no_fit, sampled_exponents, solve_bounded_pair
from processing.products import BlinnPhong
from processing.products.arrays import Float64
from processing.residual import RANK_TOLERANCE, NormalEquations, fit_residual, gram_matrices, left_over

_GRID = 48
_TEXELS_IN_GRID = 4096


def fit_phong_beside_residual(measurements: Measurements, rank_tolerance: float = RANK_TOLERANCE) -> PhongFit:
    """The lobe (k_d, k_s >= 0, one n) of least error together with the best s . H of every texel and channel.

    Weighted twice as in `srf.fit_srf`: first alike, then by the noise and the misfit. `PhongFit.mse` is that with the
    residuals. Costs some thirty passes over the samples; never raises, see `PhongFit.status`.
    """
    valid = measurements.valid
    if valid.sum(axis=(0, 1)).min() < 3:
        return no_fit(FitStatus.TOO_FEW_SAMPLES, int(valid.any(axis=2).sum()))
    peak = float(np.max(np.abs(measurements.value), where=valid, initial=0.0)) or 1.0
    bounds = sampled_exponents(measurements.cos_half[valid.any(axis=2)])
    first = _Projected.of(measurements, valid / peak**2, rank_tolerance)
    exponent = _refined(first, _coarse(first, bounds), bounds)
    excess = measurements.excess_variance(first.error(exponent))
    weights = np.divide(1.0, measurements.variance + excess, out=np.zeros(valid.shape), where=valid)
    second = _Projected.of(measurements, weights, rank_tolerance)
    return _result(measurements, second, _refined(second, exponent, bounds), bounds)


@dataclass(frozen=True, eq=False)
class _Projected:
    """The problem with s . H taken out of it.

    `weights`, `value` and `light` are (direction, texel, 3), the latter two less their best s . H; `cos_half` is
    (direction, texel), `half` (direction, texel, 3), `inverse` (texel, 3, 3, 3) the pseudo-inverse of sum w H H^T.
    """

    weights: Float64
    value: Float64
    light: Float64
    cos_half: Float64
    half: Float64
    inverse: Float64

    @classmethod
    def of(cls, measurements: Measurements, weights: Float64, rank_tolerance: float) -> "_Projected":
        half, valid = measurements.half, weights > 0
        gram = gram_matrices(half, weights)
        units = [np.broadcast_to(unit, (*gram.shape[:2], 3)) for unit in np.eye(3)]
        inverse = np.stack([NormalEquations(gram, unit).solve(rank_tolerance).vectors for unit in units], axis=-1)
        light = np.broadcast_to(measurements.cos_light[..., None], weights.shape)

        def less_residual(values: Float64) -> Float64:
            fit = fit_residual(values, half, weights, rank_tolerance)
            return np.where(valid, left_over(values, half, fit), 0.0)

        cos_half = np.where(valid.any(axis=2), np.clip(measurements.cos_half, 0, 1), 0.0)
        return cls(
            weights, less_residual(measurements.value), less_residual(light), cos_half, half, np.nan_to_num(inverse)
        )

    def every(self, step: int) -> "_Projected":
        """The same of every step-th texel."""
        by_direction = (self.weights, self.value, self.light, self.cos_half, self.half)
        weights, value, light, cos_half, half = (np.ascontiguousarray(array[:, ::step]) for array in by_direction)
        return _Projected(weights, value, light, cos_half, half, self.inverse[::step])

    def sums(self, exponent: float) -> tuple[Float64, Float64, Float64, Float64, Float64, Float64]:
        """Per channel: light light, light lobe, lobe lobe, light value, lobe value, value value."""
        weighted = self.weights * self.light
        samples = (self.cos_half, self.half, self.weights, self.light, self.value)
        lobe = _lobe_sums(exponent, samples, self.inverse)
        return (
            (weighted * self.light).sum(axis=(0, 1)),
            lobe[0],
            lobe[1],
            (weighted * self.value).sum(axis=(0, 1)),
            lobe[2],
            (self.weights * self.value**2).sum(axis=(0, 1)),
        )

    def error(self, exponent: float) -> Float64:
        """What lobe and residual leave over at the best k_d, k_s, (direction, texel, 3)."""
        k = solve_bounded_pair(*self.sums(exponent)[:5])
        lobe = self.less_residual(np.asarray(self.cos_half**exponent, np.float64))
        return np.asarray(self.value - k[0] * self.light - k[1] * lobe, np.float64)

    def less_residual(self, values: Float64) -> Float64:
        """Values (direction, texel) that all channels share, less their best s . H, (direction, texel, 3)."""
        moment = np.einsum("dtc,dt,dtk->tck", self.weights, values, self.half, optimize=True)
        vectors = np.einsum("tckj,tcj->tck", self.inverse, moment)
        return np.where(
            self.weights > 0, values[..., None] - np.einsum("dtk,tck->dtc", self.half, vectors, optimize=True), 0.0
        )


@numba.njit(cache=True)
def _lobe_sums(exponent: float, samples: tuple[Float64, ...], inverse: Float64) -> Float64:
    """Sums (3, channel) of light lobe, lobe lobe and lobe value, with s . H projected out of the lobe.

    `samples` are the arrays of `_Projected` in this order: cos_half, half, weights, light, value.
    """
    cos_half, half, weights, light, value = samples
    directions, texels = cos_half.shape
    sums, lobe, moment = np.zeros((3, 3)), np.empty(directions), np.empty(3)
    for t in range(texels):
        for d in range(directions):
            lobe[d] = cos_half[d, t] ** exponent
        for c in range(3):
            square = 0.0
            moment[:] = 0.0
            for d in range(directions):
                weighted = weights[d, t, c] * lobe[d]
                sums[0, c] += weighted * light[d, t, c]
                sums[2, c] += weighted * value[d, t, c]
                square += weighted * lobe[d]
                for k in range(3):
                    moment[k] += weighted * half[d, t, k]
            for j in range(3):
                for k in range(3):
                    square -= moment[j] * inverse[t, c, j, k] * moment[k]
            sums[1, c] += max(square, 0.0)
    return sums


def _cost(problem: _Projected, log_exponent: float) -> float:
    aa, ab, bb, ay, by, yy = problem.sums(float(np.exp(log_exponent)))
    k = solve_bounded_pair(aa, ab, bb, ay, by)
    return float((yy - 2 * (k[0] * ay + k[1] * by) + k[0] ** 2 * aa + 2 * k[0] * k[1] * ab + k[1] ** 2 * bb).sum())


def _coarse(problem: _Projected, bounds: tuple[float, float]) -> float:
    """The best exponent of a grid, over a few thousand texels."""
    few = problem.every(max(problem.cos_half.shape[1] // _TEXELS_IN_GRID, 1))
    grid = np.linspace(np.log(bounds[0]), np.log(bounds[1]), _GRID)
    return float(np.exp(grid[int(np.argmin([_cost(few, float(x)) for x in grid]))]))


def _refined(problem: _Projected, exponent: float, bounds: tuple[float, float]) -> float:
    step = 1.5 * float(np.log(bounds[1] / bounds[0])) / (_GRID - 1)
    low, high = (max(np.log(exponent) - step, np.log(bounds[0])), min(np.log(exponent) + step, np.log(bounds[1])))
    found = minimize_scalar(lambda x: _cost(problem, x), bounds=(low, high), method="bounded", options={"xatol": 1e-5})
    return float(np.exp(found.x))


def _result(measurements: Measurements, problem: _Projected, exponent: float, bounds: tuple[float, float]) -> PhongFit:
    k = solve_bounded_pair(*problem.sums(exponent)[:5])
    count = int(measurements.valid.any(axis=2).sum())
    if not (np.isfinite(k).all() and np.isfinite(exponent)):
        return no_fit(FitStatus.DIVERGED, count)
    free = np.concatenate([k.ravel() > 0, [bool((k[1] > 0).any())]])
    covariance, index = np.zeros((7, 7)), np.ix_(free, free)
    covariance[index] = np.linalg.pinv(_information(problem, k, exponent)[index], hermitian=True)
    mse = (problem.error(exponent) ** 2).sum(axis=(0, 1)) / measurements.valid.sum(axis=(0, 1))
    resting = not free.all() or not bounds[0] * 1.001 < exponent < bounds[1] * 0.999
    status = FitStatus.AT_BOUND if resting else FitStatus.CONVERGED
    return PhongFit(BlinnPhong(k[0], k[1], exponent), covariance, mse, count, status)


def _information(problem: _Projected, k: Float64, exponent: float) -> Float64:
    """J^T W J (7, 7) with the parameters k_d, k_s, n, the residuals projected out."""
    power = problem.cos_half**exponent
    lobe = problem.less_residual(power)
    slope = problem.less_residual(power * np.log(np.maximum(problem.cos_half, 1e-12)))
    matrix = np.zeros((7, 7))
    for channel in range(3):
        columns = (problem.light[..., channel], lobe[..., channel], k[1, channel] * slope[..., channel])
        jacobian = np.stack([column.ravel() for column in columns])
        index = np.array([channel, 3 + channel, 6])
        matrix[np.ix_(index, index)] += (jacobian * problem.weights[..., channel].ravel()) @ jacobian.T
    return matrix
