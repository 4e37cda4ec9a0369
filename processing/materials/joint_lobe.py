"""The lobe of a material whose every texel also has a residual: all of it in one least-squares problem.

A lobe fitted to the reflectance alone takes for its own what the residuals of the texels have in common. Here the
residual is projected out: per texel and channel nothing counts that the residual could say. What is left is linear in
k_d and k_s, so that only the shape of the lobe is searched, by Gauss and Newton's steps with Levenberg and Marquardt's
damping (variable projection, Golub and Pereyra 1973, in Kaufman's form).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from processing.materials.measurements import Measurements
from processing.materials.phong import FitStatus, PhongFit, no_fit, sampled_exponents, solve_bounded_pair
from processing.materials.residual import ALIKE, RANK_TOLERANCE, ResidualEquations, Weighting
from processing.materials.sample_geometry import SampleGeometry
from processing.products import BlinnPhong, ResidualBasis
from processing.products.arrays import Float64

_GRID = 32
_TEXELS_IN_GRID = 4096  # the misfit, a mean of squares over them, is good to a percent
_STEPS = 30
# Of N.L or of the lobe, what the residual cannot say as well; less is none, as singular values under RANK_TOLERANCE.
# On spheres and arms N.L has 0.002 to 0.05 beside s . H and polynomials, 3e-6 where a basis contains it.
_SMALLEST_SHARE = RANK_TOLERANCE**2


class Shapes(Protocol):
    """A family of lobes by the parameters of their shape."""

    @property
    def bounds(self) -> Sequence[tuple[float, float]]:
        """Lowest and highest value of each parameter."""
        ...

    def columns(self, geometry: SampleGeometry, shape: Float64) -> Float64:
        """N.L, the lobe with k_s = 1, and its derivatives by each parameter, (texel or 1, 2 + p, direction)."""
        ...


@dataclass(frozen=True, eq=False)
class RoundShapes:
    """Blinn-Phong lobes by the logarithm of their exponent."""

    bounds: Sequence[tuple[float, float]]

    def columns(self, geometry: SampleGeometry, shape: Float64) -> Float64:
        """See `Shapes`."""
        exponent = np.exp(shape[0])
        power = np.exp(exponent * geometry.log_half)
        return np.stack([geometry.cos_light, power, exponent * geometry.log_half * power], axis=1)


@dataclass(frozen=True, eq=False)
class Solution:
    """The best k_d and k_s, `coefficients` (2, 3), of lobes of one `shape` (p,).

    `cost` is the weighted sum of squares with the residuals, per channel; `free` (2, 3) says which coefficients rest on
    no bound. `raw` and `projected` are `ResidualEquations.products`.
    """

    shape: Float64
    coefficients: Float64
    cost: Float64
    free: NDArray[np.bool_]
    projected: Float64

    @classmethod
    def of(cls, equations: ResidualEquations, shapes: Shapes, shape: Float64) -> "Solution":
        """Solve for the coefficients."""
        raw, projected = equations.products(shapes.columns(equations.geometry, shape))
        return cls._of_products(shape, raw, projected)

    @classmethod
    def _of_products(cls, shape: Float64, raw: Float64, projected: Float64) -> "Solution":
        k, determined = _coefficients(raw, projected)
        signed = np.concatenate([-k, np.zeros((len(shape), 3)), np.ones((1, 3))]).T
        cost = np.einsum("ci,cij,cj->c", signed, projected, signed)
        return cls(shape, k, np.maximum(cost, 0.0), determined & (k > 0), projected)

    def normal_equations(self) -> tuple[Float64, Float64]:
        """Gauss and Newton's matrix (p, p) and right side (p,) of the shape, the free coefficients projected out."""
        count = len(self.shape)
        matrix, right = np.zeros((count, count)), np.zeros(count)
        for c, projected in enumerate(self.projected):
            slopes, free = slice(2, 2 + count), np.flatnonzero(self.free[:, c])
            across = projected[slopes][:, free]
            inside = projected[np.ix_(free, free)]
            taken = across @ np.linalg.pinv(inside, hermitian=True) if len(free) else np.zeros((count, 0))
            k_s = self.coefficients[1, c]
            matrix += k_s**2 * (projected[slopes, slopes] - taken @ across.T)
            right += k_s * (projected[slopes, -1] - projected[slopes, :2] @ self.coefficients[:, c])
        return matrix, right

    def information(self) -> Float64:
        """J^T W J (6 + p, 6 + p) with the parameters k_d, k_s, shape."""
        count = 6 + len(self.shape)
        matrix = np.zeros((count, count))
        for c, projected in enumerate(self.projected):
            scale = np.array([1.0, 1.0, *[self.coefficients[1, c]] * len(self.shape)])
            index = np.array([c, 3 + c, *range(6, count)])
            matrix[np.ix_(index, index)] += projected[:-1, :-1] * scale * scale[:, None]
        return matrix


@dataclass(frozen=True, eq=False)
class JointFit:
    """A `lobe` fitted beside the residuals, and the `equations` of the texels and the `weighting` that told it.

    `bounds` are those of the logarithm of the exponent; None where there were too few samples for a search.
    """

    lobe: PhongFit
    equations: ResidualEquations
    weighting: Weighting
    bounds: tuple[float, float] | None


def fit_phong_beside_residual(
    measurements: Measurements, basis: ResidualBasis = ResidualBasis.HALF, rank_tolerance: float = RANK_TOLERANCE
) -> JointFit:
    """The lobe (k_d, k_s >= 0, one n) of least error together with the best residual of every texel and channel.

    Weighted twice: first alike, on some of the texels, which tells what lobe and residual cannot follow; then by the
    noise and this misfit. What the residual can say as well as the lobe is the lobe's: where N.L is one of the basis,
    k_d is the best without a residual. `PhongFit.mse` is that with the residuals. Never raises, see `PhongFit.status`.
    """
    geometry = SampleGeometry.of(measurements, basis)
    valid = measurements.valid
    count = int(valid.any(axis=2).sum())
    if valid.sum(axis=(0, 1)).min() < 3:
        equations = ResidualEquations.of(measurements, geometry, ALIKE, rank_tolerance)
        return JointFit(no_fit(FitStatus.TOO_FEW_SAMPLES, count), equations, ALIKE, None)
    bounds = _exponent_bounds(geometry, valid)
    shapes = RoundShapes([bounds])
    chosen = spread(geometry)
    few = measurements.texels(chosen)
    alike = ResidualEquations.of(few, geometry.some(chosen), ALIKE, rank_tolerance)
    first = refined(alike, shapes, coarse(alike, shapes, np.linspace(*bounds, _GRID)[:, None]))
    power = shapes.columns(alike.geometry, first.shape)[:, 1]
    weighting = Weighting(True, alike.misfit(few, power, first.coefficients))
    equations = ResidualEquations.of(measurements, geometry, weighting, rank_tolerance)
    found = refined(equations, shapes, refined(equations.some(chosen), shapes, first.shape).shape)
    return JointFit(_result(found, shapes, equations, count), equations, weighting, bounds)


def _exponent_bounds(geometry: SampleGeometry, valid: NDArray[np.bool_]) -> tuple[float, float]:
    """Of the logarithm of n."""
    log_half = np.broadcast_to(geometry.log_half, valid.shape[1::-1])
    low, high = np.log(sampled_exponents(np.exp(log_half[valid.any(axis=2).T])))
    return float(low), float(high)


def coarse(equations: ResidualEquations, shapes: Shapes, candidates: Float64) -> Float64:
    """The candidate (of n, p) of least cost."""
    costs = [Solution.of(equations, shapes, shape).cost.sum() for shape in candidates]
    return np.asarray(candidates[int(np.argmin(costs))], np.float64)


def refined(equations: ResidualEquations, shapes: Shapes, start: Float64) -> Solution:
    """The minimum near the start; ends where a step is a hundredth of the shape's own deviation or 1e-7 of it."""
    low, high = np.transpose(shapes.bounds)
    best, damping = Solution.of(equations, shapes, start), 1e-4
    for _ in range(_STEPS):
        matrix, right = best.normal_equations()
        scale = np.diag(matrix)
        if not (scale > 0).all():
            break
        step = np.linalg.lstsq(matrix + damping * np.diag(scale), right, rcond=None)[0]
        moved = np.clip(best.shape + np.clip(step, -1.0, 1.0), low, high)
        step = moved - best.shape
        if step @ matrix @ step < 1e-4 or np.abs(step).max() < 1e-7:
            break
        trial = Solution.of(equations, shapes, moved)
        if trial.cost.sum() < best.cost.sum():
            best, damping = trial, damping / 10
        else:
            damping = max(damping, 1e-3) * 10
    return best


def spread(geometry: SampleGeometry, count: int = _TEXELS_IN_GRID) -> NDArray[np.intp]:
    """Indices of texels: half of them evenly spread, half those that come nearest to a highlight."""
    texels = len(geometry.log_half)
    if texels <= count:
        return np.arange(texels)
    nearest = np.argpartition(-geometry.log_half.max(axis=1), count // 2)[: count // 2]
    return np.union1d(nearest, np.arange(0, texels, -(-2 * texels // count)))


def _coefficients(raw: Float64, projected: Float64) -> tuple[Float64, NDArray[np.bool_]]:
    """k_d and k_s (2, 3), and whether the data beside the residual determines each."""
    share = (
        np.diagonal(projected, axis1=1, axis2=2)[:, :2] > _SMALLEST_SHARE * np.diagonal(raw, axis1=1, axis2=2)[:, :2]
    )
    own = np.where(share[:, :, None] & np.append(share, np.ones((3, 1), bool), axis=1)[:, None, :],
                   projected[:, [0, 1]][:, :, [0, 1, -1]], 0.0)  # fmt: skip
    k = solve_bounded_pair(own[:, 0, 0], own[:, 0, 1], own[:, 1, 1], own[:, 0, 2], own[:, 1, 2])
    alone = (raw[:, 0, -1] - k[1] * raw[:, 0, 1]) / np.where(raw[:, 0, 0] > 0, raw[:, 0, 0], 1.0)
    k[0] = np.where(share[:, 0], k[0], np.maximum(alone, 0.0))
    return k, share.T


def parameters(found: Solution, shapes: Shapes) -> tuple[Float64, FitStatus]:
    """Covariance (6 + p, 6 + p) of k_d, k_s and the shape, zeros for what rests on a bound, and whether any does."""
    free = np.concatenate([found.free.ravel(), np.full(len(found.shape), found.free[1].any())])
    covariance, index = np.zeros((len(free), len(free))), np.ix_(free, free)
    covariance[index] = np.linalg.pinv(found.information()[index], hermitian=True)
    low, high = np.transpose(shapes.bounds)
    inside = bool(((found.shape > low + 1e-3) & (found.shape < high - 1e-3)).all())
    return covariance, FitStatus.CONVERGED if free.all() and inside else FitStatus.AT_BOUND


def _result(found: Solution, shapes: Shapes, equations: ResidualEquations, count: int) -> PhongFit:
    k, exponent = found.coefficients, float(np.exp(found.shape[0]))
    covariance, status = parameters(found, shapes)
    if not np.isfinite([*k.ravel(), exponent, *covariance.ravel()]).all():
        return no_fit(FitStatus.DIVERGED, count)
    by_exponent = np.array([1.0] * 6 + [exponent])
    fit = equations.fit(np.exp(exponent * equations.geometry.log_half), k)
    mse = fit.after / np.maximum(fit.samples.sum(axis=0), 1)
    lobe = BlinnPhong(k[0], k[1], exponent)
    return PhongFit(lobe, covariance * by_exponent * by_exponent[:, None], mse, count, status)
