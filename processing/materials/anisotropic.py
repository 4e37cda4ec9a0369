"""A lobe that is narrower along one direction of the surface than across it, found beside the residuals.

The exponent over the azimuth of H is searched as e^m (cosh r + sinh r cos 2 (azimuth - turn)), whose r and turn are the
length and half the angle of a vector (p, q): round lobes are the origin, a point like any other, where neither axis nor
sign has to be chosen.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from processing.materials.joint_lobe import Solution, fit_phong_beside_residual, parameters, refined, spread
from processing.materials.measurements import Measurements
from processing.materials.phong import FitStatus
from processing.materials.residual import RANK_TOLERANCE, ResidualEquations
from processing.materials.sample_geometry import SampleGeometry
from processing.products import AnisotropicPhong, BlinnPhong, Lobe, ResidualBasis
from processing.products.arrays import Float64

# Of two further parameters chance alone lowers the sum of squares by this much in one of a thousand round materials.
_CHANCE = 13.8
_SMALLEST_RATIO = (
    1.1  # of exponents: less changes the lobe's width by under 5 %, which a pattern of the texels can feign
)
_STARTS_TURN_RAD = np.arange(4) * np.pi / 4
_START_LOG_RATIO = 0.7  # exponents of 4 to 1


@dataclass(frozen=True, eq=False)
class AnisotropicFit:
    """A `lobe` beside the residuals: `AnisotropicPhong`, or `BlinnPhong` where the data shows no anisotropy.
    `round_lobe` is the best that is round.

    `covariance` (9, 9) orders diffuse, specular, the two exponents and the turn, (7, 7) that of a round lobe; `gain` is
    how much less, in units of noise and misfit, the drawn-out lobe leaves over than the round one.
    """

    lobe: Lobe
    round_lobe: BlinnPhong
    covariance: Float64
    gain: float
    status: FitStatus


@dataclass(frozen=True, eq=False)
class DrawnShapes:
    """Anisotropic lobes by m, p, q (see the module)."""

    bounds: Sequence[tuple[float, float]]

    def columns(self, geometry: SampleGeometry, shape: Float64) -> Float64:
        """See `joint_lobe.Shapes`."""
        m, p, q = shape
        r = float(np.hypot(p, q))
        ratio = np.sinh(r) / r if r > 0 else 1.0
        growth = (np.cosh(r) - ratio) / r**2 if r > 1e-4 else 1 / 3  # d ratio / d r, over r
        cosine, sine = geometry.twice[:, 0], geometry.twice[:, 1]
        along = p * cosine + q * sine
        exponent = np.exp(m) * (np.cosh(r) + ratio * along)
        slopes = [exponent]
        for own, function in ((p, cosine), (q, sine)):
            slopes.append(np.exp(m) * (own * (ratio + growth * along) + ratio * function))
        power = np.exp(exponent * geometry.log_half)
        slope = geometry.log_half * power
        return np.stack([geometry.cos_light, power, *(one * slope for one in slopes)], axis=1)


def fit_anisotropic_beside_residual(
    measurements: Measurements, basis: ResidualBasis = ResidualBasis.HALF, rank_tolerance: float = RANK_TOLERANCE
) -> AnisotropicFit:
    """The anisotropic lobe of least error together with the best residual of every texel and channel.

    Starts from the round lobe and from four that are drawn out; weights and bounds are those of the round lobe. That
    one is the answer where the other leaves no less over than chance would explain, or its exponents lie within 10 %.
    Never raises, see `status`.
    """
    joint = fit_phong_beside_residual(measurements, basis, rank_tolerance)
    without = AnisotropicFit(joint.lobe.phong, joint.lobe.phong, joint.lobe.covariance, 0.0, joint.lobe.status)
    if joint.bounds is None or not joint.lobe.phong.specular.any():
        return without
    low, high = joint.bounds
    reach = (high - low) / 2
    shapes = DrawnShapes([(low, high), (-reach, reach), (-reach, reach)])
    start = np.array([np.log(joint.lobe.phong.exponent), 0.0, 0.0])
    best = _best_of_starts(joint.equations, shapes, start)
    gain = float((Solution.of(joint.equations, shapes, start).cost - best.cost).sum())
    ratio = float(np.exp(2 * np.hypot(best.shape[1], best.shape[2])))
    if gain < _CHANCE or ratio < _SMALLEST_RATIO:
        return replace(without, gain=gain)
    return _result(best, shapes, joint.lobe.phong, gain)


def _best_of_starts(equations: ResidualEquations, shapes: DrawnShapes, start: Float64) -> Solution:
    drawn = [
        start + _START_LOG_RATIO * np.array([0.0, np.cos(2 * turn), np.sin(2 * turn)]) for turn in _STARTS_TURN_RAD
    ]
    few = equations.some(spread(equations.geometry))
    found = [refined(few, shapes, np.clip(one, *np.transpose(shapes.bounds))) for one in (start, *drawn)]
    return refined(equations, shapes, min(found, key=lambda one: float(one.cost.sum())).shape)


def _result(best: Solution, shapes: DrawnShapes, round_lobe: BlinnPhong, gain: float) -> AnisotropicFit:
    m, p, q = best.shape
    r = float(np.hypot(p, q))
    exponents, turn_rad = np.exp(m + r * np.array([1.0, -1.0])), float(np.arctan2(q, p) / 2)
    by_shape = np.eye(9)
    along, across = np.array([p, q]) / r, np.array([-q, p]) / (2 * r * r)
    by_shape[6] = [0, 0, 0, 0, 0, 0, exponents[0], *(exponents[0] * along)]
    by_shape[7] = [0, 0, 0, 0, 0, 0, exponents[1], *(-exponents[1] * along)]
    by_shape[8, 6:] = [0, *across]
    covariance, status = parameters(best, shapes)
    k = best.coefficients
    lobe = AnisotropicPhong(k[0], k[1], exponents, turn_rad)
    return AnisotropicFit(lobe, round_lobe, by_shape @ covariance @ by_shape.T, gain, status)
