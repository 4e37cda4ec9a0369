"""The spatially varying residual function of a material: one lobe plus a weighted sum of a basis per texel and channel.

The lights of one horizontal circle and a fixed camera put all half vectors of a texel into one plane: the system has
rank 2, and a plain solve returns noise of any size along its normal. `residual.ResidualEquations` gives the shortest
solution and says the rank.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.materials.measurements import (
    Measurements,
    btf_measurements,
    mean_over_texels,
    sphere_measurements,
    stack_measurements,
)
from processing.materials.phong import FitStatus, LobeSamples, PhongFit, average_lobes, fit_blinn_phong
from processing.materials.residual import RANK_TOLERANCE
from processing.materials.texel_fits import MOST_SAMPLES, Model, Samples, fit_texels
from processing.products import (
    BlinnPhong,
    Btf,
    LightStack,
    Lobe,
    NormalMap,
    Provenance,
    ReflectanceMaps,
    ResidualBasis,
    Srf,
)
from processing.products.arrays import Float32


@dataclass(frozen=True, eq=False)
class SrfFit:
    """A fitted SRF and how well it holds.

    `rank` and `status` (a `FitStatus`) are uint8, `condition` float32, each (channel, y, x); `lobe` is the fit of the
    lobe beside the residuals, None where the lobe was given. `mse_lobe` is what the SRF's own lobe leaves over without
    its residual: more than the best single lobe (`fit_phong`) would. Mean squared errors and the variance over the
    directions of a texel are taken over lit valid samples and all channels, in units of `peak` squared, the largest
    sample: linear values normalised to [0, 1].
    """

    srf: Srf
    rank: NDArray[np.uint8]
    condition: Float32
    status: NDArray[np.uint8]
    mse_lobe: float
    mse_srf: float
    variance: float
    peak: float
    lobe: PhongFit | None = None

    @property
    def psnr_lobe_db(self) -> float:
        """Peak signal over the error of the SRF's lobe without its residual, in decibels."""
        return _psnr_db(self.mse_lobe)

    @property
    def psnr_srf_db(self) -> float:
        """Peak signal over the error with the residual, in decibels."""
        return _psnr_db(self.mse_srf)

    @property
    def mse_over_lobe(self) -> float:
        """Error with the residual over `mse_lobe`; 1 where the lobe leaves nothing over."""
        return self.mse_srf / self.mse_lobe if self.mse_lobe > 0 else 1.0

    @property
    def mse_over_variance(self) -> float:
        """Error with the residual over the variance per texel; 1 where nothing varies."""
        return self.mse_srf / self.variance if self.variance > 0 else 1.0


def fit_srf(
    maps: ReflectanceMaps,
    lobe: Lobe | None = None,
    basis: ResidualBasis = ResidualBasis.HALF,
    rank_tolerance: float = RANK_TOLERANCE,
) -> SrfFit:
    """Fit a round lobe and the residual to what is measured of a sphere, or the residual to a given lobe.

    Weighted twice as in `fit_phong`: least squares where the misfit rules, inverse variance where the noise does.
    Raises ImageError where the maps have not three channels.
    """
    measurements = sphere_measurements(maps)
    size = maps.reflectance_cos.shape[1]
    samples = Samples(measurements.texels, np.arange(size * size), measurements)
    return _result(samples, Model(lobe, basis, rank_tolerance), _Texture((size, size), False, maps.provenance))


def fit_srf_to_btf(
    btf: Btf,
    lobe: Lobe | None = None,
    basis: ResidualBasis = ResidualBasis.HALF,
    rank_tolerance: float = RANK_TOLERANCE,
) -> SrfFit:
    """Fit a round lobe and the residual to a BTF, or the residual to a given lobe.

    Every texel is fitted over all light and view pairs; the samples of a channel count alike. Where all texels have the
    same pairs, the lobe beside their residuals is that beside the residual of their mean: that is what it is fitted to.
    """
    shape = (btf.shape[2], btf.shape[3])
    take = partial(btf_measurements, btf)
    samples = Samples(take, np.arange(shape[0] * shape[1]), mean_over_texels(btf))
    return _result(samples, Model(lobe, basis, rank_tolerance), _Texture(shape, True, btf.provenance))


def fit_srf_to_stack(
    stack: LightStack,
    normals: NormalMap,
    lobe: Lobe | None = None,
    basis: ResidualBasis = ResidualBasis.HALF,
    rank_tolerance: float = RANK_TOLERANCE,
) -> SrfFit:
    """Fit a round lobe and the residual to an object of any shape, or the residual to a given lobe, pixel by pixel.

    Pixels without a normal stay NaN. The lobe is fitted to at most `MOST_SAMPLES`, spread over the object.
    Raises ImageError where stack and normals are not of one picture.
    """
    shape = stack.reflectance_cos.shape[1:3]
    if normals.status.shape != shape:
        raise ImageError(f"normals of {normals.status.shape} pixels do not belong to pictures of {shape}")
    texels = np.flatnonzero(normals.measured)
    spread = texels[:: max(-(-len(texels) * len(stack.reflectance_cos) // MOST_SAMPLES), 1)]
    take = partial(stack_measurements, stack, normals)
    samples = Samples(take, texels, take(spread))
    return _result(samples, Model(lobe, basis, rank_tolerance), _Texture((shape[0], shape[1]), False, stack.provenance))


def fit_phong(measurements: Measurements) -> PhongFit:
    """One lobe for all directions and texels, without residuals.

    Fitted twice: first with the noise alone, then with the misfit of the first added to every variance, so that a
    texel's own colour does not pass for a precise measurement of the lobe.
    """
    first = fit_blinn_phong(measurements.lobe_samples(np.zeros(3)))
    excess = measurements.misfit_variance(measurements.delta(first.phong))
    return fit_blinn_phong(measurements.lobe_samples(excess))


def fit_phong_per_direction(measurements: Measurements) -> tuple[BlinnPhong, tuple[PhongFit, ...]]:
    """The mean of one lobe per direction, as in the paper, and these lobes.

    Raises ConvergenceError where no direction has one.
    """
    fits = tuple(fit_phong(measurements.directions(slice(d, d + 1))) for d in range(len(measurements.value)))
    return average_lobes(fits), fits


def fit_phong_to_btf(btf: Btf) -> PhongFit:
    """The lobe of the mean over the texels of every light and view pair, without residuals."""
    mean = mean_over_texels(btf)
    samples = mean.lobe_samples(np.zeros(3))
    return fit_blinn_phong(LobeSamples(samples.value, samples.cos_light, samples.cos_half))


@dataclass(frozen=True, slots=True, eq=False)
class _Texture:
    """What the texels are of: rows and columns, whether it repeats, and where it is from."""

    shape: tuple[int, int]
    wrap: bool
    provenance: Provenance

    def maps(self, values: NDArray[Any], texels: NDArray[np.intp], empty: float) -> NDArray[Any]:
        """Values (texel, channel, ...) as (channel, y, x, ...), `empty` elsewhere."""
        out = np.full((values.shape[1], self.shape[0] * self.shape[1], *values.shape[2:]), empty, values.dtype)
        out[:, texels] = np.moveaxis(values, 1, 0)
        return out.reshape(values.shape[1], *self.shape, *values.shape[2:])


def _result(samples: Samples, model: Model, texture: _Texture) -> SrfFit:
    fits = fit_texels(samples, model)
    fit, texels = fits.residual, samples.texels
    status = np.where(fit.samples < model.basis.size, FitStatus.TOO_FEW_SAMPLES, FitStatus.CONVERGED).astype(np.uint8)
    residual = texture.maps(fit.coefficients, texels, np.nan)
    unit = max(int(fit.samples.sum()), 1) * (fit.peak**2 if fit.peak > 0 else 1.0)
    return SrfFit(
        Srf(residual, fits.lobe, texture.wrap, texture.provenance, model.basis),
        texture.maps(fit.rank, texels, 0),
        texture.maps(fit.condition, texels, np.inf),
        texture.maps(status, texels, FitStatus.TOO_FEW_SAMPLES),
        float(fit.before.sum()) / unit,
        float(fit.after.sum()) / unit,
        float(fit.spread.sum()) / unit,
        fit.peak,
        fits.joint,
    )


def _psnr_db(mse: float) -> float:
    return float(-10 * np.log10(mse)) if mse > 0 else float("inf")
