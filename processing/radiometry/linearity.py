"""The linearity of a sensor: what its counts would be if they grew evenly with the light."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

SIGNIFICANT = 20.0  # fall of chi-squared by the two coefficients; 1 in 20 000 by chance
NEGLIGIBLE = 1e-4  # of the signal at its highest level
FORM = 5e-5  # of the signal: what two coefficients leave of a smooth curve that loses 1 % at its end


@dataclass(frozen=True, slots=True)
class Linearity:
    """Linear counts of counts y over black: L(y) = y + span (quadratic v^2 + cubic v^3), v = y / span.

    The slope at zero is 1, so that the gain is that of small signals. Both coefficients are 0 for a linear sensor.
    """

    span_dn: float
    quadratic: float = 0.0
    cubic: float = 0.0

    def linear_dn(self, counted_dn: ArrayLike) -> Array:
        """L of counts over black; below black it is the line."""
        counted = np.asarray(counted_dn, np.float64)
        share = np.maximum(counted / self.span_dn, 0.0)
        return np.asarray(counted + self.span_dn * share**2 * (self.quadratic + self.cubic * share), np.float64)

    def slope(self, counted_dn: ArrayLike) -> Array:
        """dL/dy."""
        share = np.maximum(np.asarray(counted_dn, np.float64) / self.span_dn, 0.0)
        return np.asarray(1 + share * (2 * self.quadratic + 3 * self.cubic * share), np.float64)

    def counted_dn(self, linear_dn: ArrayLike) -> Array:
        """The inverse of L, by Newton; L is close to the line, so that few steps reach rounding."""
        linear = np.asarray(linear_dn, np.float64)
        counted = linear.copy()
        for _ in range(6):
            counted = counted - (self.linear_dn(counted) - linear) / self.slope(counted)
        return counted

    @property
    def significant(self) -> bool:
        """Whether it differs from the line at all."""
        return self.quadratic != 0.0 or self.cubic != 0.0


@dataclass(frozen=True, eq=False)
class LinearityFit:
    """A linearity and what it rests on: `rate_dn_s` (channels,), `residual` (n,) of each level relative to its fit.

    `chi2` per degree of freedom of the fit, `deviation` the standard deviation of L(span) / span.
    """

    linearity: Linearity
    rate_dn_s: Array
    residual: Array
    chi2: float
    deviation: float


def fit_linearity(
    level_dn: Array, variance_dn2: Array, light_s: Array, channel: NDArray[np.int_], span_dn: float
) -> LinearityFit:
    """The curve that makes every channel's levels over black grow evenly with exposure.

    Levels, their variances, exposure times (corrected for the light's drift) and channels are (n,). Weighted linear
    least squares of L(level) = rate t over the two coefficients and each channel's rate. The line is kept where the
    curve is not significant.
    """
    names = np.unique(channel)
    times = np.where(channel[:, None] == names, light_s[:, None], 0.0)
    share = level_dn / span_dn
    curve = span_dn * np.stack([share**2, share**3], axis=1)
    weight = 1 / np.sqrt(variance_dn2)
    straight = _solve(times, level_dn, weight)
    bent = _solve(np.hstack([times, -curve]), level_dn, weight)
    freedom = max(len(level_dn) - times.shape[1] - 2, 1)
    bend = bent.solution[len(names) :]
    worth = (straight.chi2 - bent.chi2) / max(bent.chi2 / freedom, 1.0)
    if worth < SIGNIFICANT or abs(bend.sum()) < NEGLIGIBLE:
        linearity, best, spread = Linearity(span_dn), straight, 0.0
    else:
        linearity, best = Linearity(span_dn, float(bend[0]), float(bend[1])), bent
        spread = float(np.sqrt(bent.covariance[-2:, -2:].sum() * max(bent.chi2 / freedom, 1.0) + FORM**2))
    rate = best.solution[: len(names)]
    fitted = times @ rate
    residual = linearity.linear_dn(level_dn) / fitted - 1
    return LinearityFit(linearity, rate, residual, best.chi2 / freedom, spread)


@dataclass(frozen=True, eq=False)
class _Solution:
    solution: Array
    covariance: Array
    chi2: float


def _solve(rows: Array, values: Array, weight: Array) -> _Solution:
    """Weighted least squares, columns scaled to one size first."""
    scale = np.linalg.norm(rows * weight[:, None], axis=0)
    whitened = rows * weight[:, None] / scale
    solution, *_ = np.linalg.lstsq(whitened, values * weight, rcond=None)
    left = values * weight - whitened @ solution
    covariance = np.linalg.pinv(whitened.T @ whitened) / np.outer(scale, scale)
    return _Solution(solution / scale, covariance, float(left @ left))
