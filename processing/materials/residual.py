"""Least squares over the functions of a residual basis, per texel and channel, and what it leaves of a lobe.

All of it rests on one matrix per texel and channel, the pseudo-inverse of the sum of w B B^T over the directions:
applied to the samples it gives the residual, applied to the columns of a lobe it takes out of them what a residual
could say as well (variable projection, Golub and Pereyra 1973).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.materials.measurements import Measurements, misfit_variance
from processing.materials.residual_kernels import arrange, fit, inner_products, invert
from processing.materials.sample_geometry import SampleGeometry
from processing.products.arrays import Float32, Float64

# A light at arm's length leaves the plane of the half vectors by about 1 % over a sphere; that is no third
# measurement, and its solution would carry 30 times the noise of the others.
RANK_TOLERANCE = 0.03


@dataclass(frozen=True, slots=True, eq=False)
class Weighting:
    """Weights 1 / (noise variance + misfit), `misfit` (3,) per channel; without `noise` all valid samples count 1."""

    noise: bool
    misfit: Float64


ALIKE = Weighting(False, np.ones(3))


@dataclass(frozen=True, eq=False)
class ResidualFit:
    """`coefficients` (texel, 3, k) of the basis, NaN where there is no sample, and what is left over.

    `rank`, `condition` (as in `ResidualEquations`) and the number of `samples` are (texel, 3). Sums of squares (3,)
    over all valid samples alike: `before` and `after` are what the lobe alone, and lobe and residual leave over,
    `spread` is about the mean of each texel. `peak` is the largest sample.
    """

    coefficients: Float32
    rank: NDArray[np.uint8]
    condition: Float32
    samples: NDArray[np.int64]
    before: Float64
    after: Float64
    spread: Float64
    peak: float

    @classmethod
    def joined(cls, parts: "Sequence[ResidualFit]") -> "ResidualFit":
        """Of the texels of all parts, one after another."""
        return cls(
            np.concatenate([part.coefficients for part in parts]),
            np.concatenate([part.rank for part in parts]),
            np.concatenate([part.condition for part in parts]),
            np.concatenate([part.samples for part in parts]),
            np.sum([part.before for part in parts], axis=0),
            np.sum([part.after for part in parts], axis=0),
            np.sum([part.spread for part in parts], axis=0),
            max(part.peak for part in parts),
        )


@dataclass(frozen=True, eq=False)
class ResidualEquations:
    """The normal equations of the residual of every texel and channel, solved for any right side.

    `value` and `weights` are (texel, 3, direction), zero where there is no sample, `inverse` (texel, 3, k, k) is the
    pseudo-inverse of the weighted sums of B B^T: singular values of the weighted samples under the tolerance times the
    largest count as zero, which gives the shortest coefficients. `rank` and `condition` (largest singular value over
    the smallest that was kept; infinite without a sample) are (texel, 3).
    """

    geometry: SampleGeometry
    value: Float64
    weights: Float64
    inverse: Float64
    rank: NDArray[np.uint8]
    condition: Float32

    @classmethod
    def of(
        cls,
        measurements: Measurements,
        geometry: SampleGeometry,
        weighting: Weighting = ALIKE,
        rank_tolerance: float = RANK_TOLERANCE,
    ) -> "ResidualEquations":
        """The equations of all texels; `geometry` is that of the measurements."""
        value, weights = arrange(
            np.asarray(measurements.value, np.float32),
            np.asarray(measurements.variance, np.float32),
            geometry.cos_light,
            float(weighting.noise),
            np.asarray(weighting.misfit, np.float64),
        )
        return cls(geometry, value, weights, *invert(geometry.basis, weights, rank_tolerance**2))

    def some(self, texels: NDArray[np.intp] | slice) -> "ResidualEquations":
        """Those of some texels."""
        return ResidualEquations(
            self.geometry.some(texels),
            self.value[texels],
            self.weights[texels],
            self.inverse[texels],
            self.rank[texels],
            self.condition[texels],
        )

    def products(self, columns: Float64) -> tuple[Float64, Float64]:
        """Weighted inner products (3, c + 1, c + 1) of c columns and, last, the samples: as they are, and projected.

        `columns` are (texel or 1, c, direction). Projected means less their best residual.
        """
        raw, projected = inner_products(self.geometry.basis, columns, self.value, self.weights, self.inverse)
        return raw.sum(axis=0), projected.sum(axis=0)

    def fit(self, power: Float64, coefficients: Float64) -> ResidualFit:
        """The residual over k_d (N.L) + k_s `power`; `coefficients` (2, 3) are k_d and k_s."""
        lobe = np.stack([np.broadcast_to(power, self.geometry.cos_light.shape), self.geometry.cos_light], axis=1)
        found, samples, sums = fit(
            self.geometry.basis, lobe, coefficients[::-1], self.value, self.weights, self.inverse
        )
        before, after, spread = sums[:, :3].sum(axis=0)
        peak = float(sums[:, 3].max(initial=0.0))
        return ResidualFit(found, self.rank, self.condition, samples, before, after, spread, peak)

    def misfit(self, measurements: Measurements, power: Float64, coefficients: Float64) -> Float64:
        """`misfit_variance` (3,) of lobe and residual, for equations of these measurements that count all alike.

        A sample's noise shows in its error less what the fit followed: its share of the unknowns is taken off.
        """
        fit = self.fit(power, coefficients)
        lobe = np.stack([self.geometry.cos_light, np.broadcast_to(power, self.geometry.cos_light.shape)])
        error = self.value - np.einsum("ktd,kc->tcd", lobe, coefficients)
        error -= np.einsum("tck,tkd->tcd", np.nan_to_num(fit.coefficients), self._functions())
        taken = np.einsum("tkd,tckl,tld->tcd", self._functions(), self.inverse, self._functions(), optimize=True)
        variance = np.where(self.weights > 0, np.moveaxis(measurements.variance, 0, 2) * (1 - taken), 0.0)
        error = np.where(self.weights > 0, error, 0.0)
        return misfit_variance(*(np.moveaxis(one, 1, 0).reshape(3, -1) for one in (error, variance)))

    def _functions(self) -> Float64:
        """The basis of every texel, (texel, k, direction)."""
        return np.broadcast_to(self.geometry.basis, (len(self.value), *self.geometry.basis.shape[1:]))
