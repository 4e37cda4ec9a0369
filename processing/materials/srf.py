"""The spatially varying residual function of a material: one Blinn-Phong lobe plus s(P) . H per texel and channel.

The lights of one horizontal circle and a fixed camera put all half vectors of a texel into one plane: the system has
rank 2, and a plain solve returns noise of any size along its normal. `residual.fit_residual` returns the shortest
solution and says the rank.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.materials.measurements import Measurements, sphere_measurements
from processing.materials.phong import FitStatus, LobeSamples, PhongFit, average_lobes, fit_blinn_phong
from processing.materials.residual import (
    RANK_TOLERANCE,
    NormalEquations,
    ResidualFit,
    fit_residual,
    left_over,
    outer_products,
)
from processing.products import BlinnPhong, Btf, ReflectanceMaps, Srf, half_vectors, sphere_normals, tangent_frames
from processing.products.arrays import Float32, Float64


@dataclass(frozen=True, eq=False)
class SrfFit:
    """A fitted SRF and how well it holds.

    `rank` and `status` (a `FitStatus`) are uint8, `condition` float32, each (channel, y, x). The mean squared errors
    and the variance over the directions of a texel are taken over lit valid samples and all channels, in units of
    `peak` squared, the largest sample: linear values normalised to [0, 1].
    """

    srf: Srf
    rank: NDArray[np.uint8]
    condition: Float32
    status: NDArray[np.uint8]
    mse_phong: float
    mse_srf: float
    variance: float
    peak: float

    @property
    def psnr_phong_db(self) -> float:
        """Peak signal over the error of the lobe alone, in decibels."""
        return _psnr_db(self.mse_phong)

    @property
    def psnr_srf_db(self) -> float:
        """Peak signal over the error with the residual, in decibels."""
        return _psnr_db(self.mse_srf)

    @property
    def mse_over_phong(self) -> float:
        """Error with the residual over that of the lobe alone; 1 where the lobe leaves nothing over."""
        return self.mse_srf / self.mse_phong if self.mse_phong > 0 else 1.0

    @property
    def mse_over_variance(self) -> float:
        """Error with the residual over the variance per texel; 1 where nothing varies."""
        return self.mse_srf / self.variance if self.variance > 0 else 1.0


def fit_phong(measurements: Measurements) -> PhongFit:
    """One lobe for all directions and texels.

    Fitted twice: first with the noise alone, then with the misfit of the first added to every variance, so that a
    texel's own colour does not pass for a precise measurement of the lobe.
    """
    first = fit_blinn_phong(measurements.lobe_samples(np.zeros(3)))
    excess = measurements.excess_variance(measurements.delta(first.phong))
    return fit_blinn_phong(measurements.lobe_samples(excess))


def fit_phong_per_direction(measurements: Measurements) -> tuple[BlinnPhong, tuple[PhongFit, ...]]:
    """The mean of one lobe per direction, as in the paper, and these lobes.

    Raises ConvergenceError where no direction has one.
    """
    fits = tuple(fit_phong(measurements.direction(index)) for index in range(len(measurements.value)))
    return average_lobes(fits), fits


def fit_srf(maps: ReflectanceMaps, phong: BlinnPhong, rank_tolerance: float = RANK_TOLERANCE) -> SrfFit:
    """Fit the residual of a sphere to a given lobe and turn it into the tangent frame.

    Weighted twice as in `fit_phong`: least squares where the misfit rules, inverse variance where the noise does.
    """
    measurements = sphere_measurements(maps)
    valid, delta = measurements.valid, measurements.delta(phong)
    fit = fit_residual(delta, measurements.half, valid.astype(np.float64), rank_tolerance)
    excess = measurements.excess_variance(left_over(delta, measurements.half, fit))
    weights = np.divide(1.0, measurements.variance + excess, out=np.zeros(valid.shape), where=valid)
    fit = fit_residual(delta, measurements.half, weights, rank_tolerance)
    size = maps.reflectance_cos.shape[1]
    frames = tangent_frames(sphere_normals(size)).reshape(-1, 3, 3)
    turned = ResidualFit(np.einsum("tij,tcj->tci", frames, fit.vectors), fit.rank, fit.condition)
    srf = Srf(_as_maps(turned.vectors, size).astype(np.float32), phong, False, maps.provenance)
    errors = _Errors.of(measurements.value, valid, delta, left_over(delta, measurements.half, fit))
    return _result(srf, turned, errors)


def fit_phong_to_btf(btf: Btf) -> PhongFit:
    """The lobe of the mean over the texels of every light and view pair."""
    light, view = _pairs(btf)
    valid = np.isfinite(btf.reflectance)
    count = valid.sum(axis=(2, 3))
    total = np.sum(btf.reflectance, axis=(2, 3), where=valid, dtype=np.float64)
    mean = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    return fit_blinn_phong(
        LobeSamples(mean.reshape(-1, 3) * light[:, 2:], light[:, 2], half_vectors(light, view)[:, 2])
    )


def fit_srf_to_btf(btf: Btf, phong: BlinnPhong, rank_tolerance: float = RANK_TOLERANCE) -> SrfFit:
    """Fit the residual of a BTF to a given lobe: every texel over all light and view pairs, nothing turned.

    The samples count alike. Half vectors are those of the sample frame, one per pair, so a row of texels costs two
    matrix products.
    """
    light, view = _pairs(btf)
    half = half_vectors(light, view)
    lobe = phong.evaluate(light, view)
    fits, errors = [], []
    for row in range(btf.reflectance.shape[2]):
        radiance = btf.reflectance[:, :, row].reshape(len(light), -1, 3) * light[:, 2, None, None]
        valid = np.isfinite(radiance) & (light[:, 2] > 0)[:, None, None]
        delta = radiance - lobe[:, None]
        gram = np.einsum("dtc,dk->tck", valid.astype(np.float64), outer_products(half), optimize=True)
        right = np.einsum("dtc,dk->tck", np.where(valid, delta, 0.0), half, optimize=True)
        fits.append(NormalEquations(gram, right).solve(rank_tolerance))
        errors.append(_Errors.of(radiance, valid, delta, left_over(delta, half, fits[-1])))
    fit = ResidualFit(
        np.concatenate([one.vectors for one in fits]),
        np.concatenate([one.rank for one in fits]),
        np.concatenate([one.condition for one in fits]),
    )
    residual = _as_maps(fit.vectors, len(fits)).astype(np.float32)
    return _result(Srf(residual, phong, True, btf.provenance), fit, _Errors.sum(errors))


@dataclass(frozen=True, eq=False)
class _Errors:
    """Sums of squares over valid samples, and the samples of each texel and channel."""

    phong: float
    srf: float
    variance: float
    peak: float
    samples: NDArray[np.intp]

    @classmethod
    def of(cls, value: Float64, valid: NDArray[np.bool_], delta: Float64, left: Float64) -> "_Errors":
        """From arrays (direction, texel, channel)."""
        samples = valid.sum(axis=0)
        known = np.where(valid, value, 0.0)
        mean = known.sum(axis=0) / np.maximum(samples, 1)
        return cls(
            float(np.sum(delta**2, where=valid)),
            float(np.sum(left**2, where=valid)),
            float(np.sum((known - mean) ** 2, where=valid)),
            float(known.max(initial=0.0)),
            samples,
        )

    @classmethod
    def sum(cls, parts: "list[_Errors]") -> "_Errors":
        """The errors of all texels of the parts."""
        return cls(
            sum(part.phong for part in parts),
            sum(part.srf for part in parts),
            sum(part.variance for part in parts),
            max(part.peak for part in parts),
            np.concatenate([part.samples for part in parts]),
        )


def _result(srf: Srf, fit: ResidualFit, errors: _Errors) -> SrfFit:
    height = srf.residual.shape[1]
    status = np.where(errors.samples < 3, FitStatus.TOO_FEW_SAMPLES, FitStatus.CONVERGED).astype(np.uint8)
    unit = max(int(errors.samples.sum()), 1) * (errors.peak**2 if errors.peak > 0 else 1.0)
    return SrfFit(
        srf,
        _as_maps(fit.rank, height),
        _as_maps(fit.condition, height).astype(np.float32),
        _as_maps(status, height),
        errors.phong / unit,
        errors.srf / unit,
        errors.variance / unit,
        errors.peak,
    )


def _as_maps(texels: NDArray[Any], height: int) -> NDArray[Any]:
    """(texel, channel, ...) to (channel, y, x, ...)."""
    return np.ascontiguousarray(np.moveaxis(texels, 1, 0).reshape(texels.shape[1], height, -1, *texels.shape[2:]))


def _pairs(btf: Btf) -> tuple[Float64, Float64]:
    """Light and view (pair, 3) of every pair in the order of the BTF's axes."""
    lights, views = len(btf.light_directions), len(btf.view_directions)
    return np.repeat(btf.light_directions, views, axis=0), np.tile(btf.view_directions, (lights, 1))


def _psnr_db(mse: float) -> float:
    return float(-10 * np.log10(mse)) if mse > 0 else float("inf")
