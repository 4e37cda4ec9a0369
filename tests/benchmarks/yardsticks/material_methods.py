"""Representations of a material, each fitted to the same noisy samples and asked for any direction's values."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator

from processing.materials.basis_choice import choose_basis
from processing.materials.phong import LobeSamples, fit_blinn_phong
from processing.materials.srf import SrfFit, fit_phong_per_direction, fit_phong_to_btf, fit_srf, fit_srf_to_btf
from processing.products import BlinnPhong, Btf, Lobe, ResidualBasis
from tests.benchmarks.yardsticks.material_samples import Samples

Array = NDArray[Any]
Predict = Callable[[Samples], Array]
Fit = Callable[[Samples], tuple[Predict, int]]
_BYTES = 4  # of a value as stored
_LOBE = 7  # values of a round lobe
_NO_LOBE = BlinnPhong(np.zeros(3), np.zeros(3), 1.0)
_NEAR = 24  # pairs of light and view that a vector of the SVD is interpolated from


@dataclass(frozen=True, eq=False)
class Fitted:
    """A method's answer for any directions of the same texels, its size with four bytes to a value, its fit's time."""

    method: str
    predict: Predict
    size_bytes: int
    seconds: float


def fitted(name: str, fit: Fit, samples: Samples) -> Fitted:
    """A method on these samples."""
    begun_s = time.perf_counter()
    predict, values = fit(samples)
    return Fitted(name, predict, _BYTES * values, time.perf_counter() - begun_s)


def constant(samples: Samples) -> tuple[Predict, int]:
    """One colour."""
    mean = np.nanmean(samples.measured, axis=(0, 1))
    return lambda asked: np.broadcast_to(mean, asked.true.shape), 3


def phong(samples: Samples) -> tuple[Predict, int]:
    """The single lobe of least squared error: all samples count alike, as in the error that is reported."""
    lobe = _least_squares_lobe(samples)
    return lambda asked: np.broadcast_to(_lobe_values(lobe, asked), asked.true.shape), _LOBE


def texel_mean(samples: Samples) -> tuple[Predict, int]:
    """A colour for each texel."""
    mean = np.nan_to_num(np.nanmean(samples.measured, axis=0))
    return lambda asked: np.broadcast_to(mean, asked.true.shape), mean.size


def polynomial(basis: ResidualBasis, samples: Samples) -> tuple[Predict, int]:
    """A sum of a basis' functions for each texel, without a lobe; a PTM with the biquadratic one."""
    return _of_srf(_fit(samples, _NO_LOBE, basis))


def srf_averaged(samples: Samples) -> tuple[Predict, int]:
    """The paper's: the mean of the lobes of single directions, and s . H."""
    return _of_srf(_fit(samples, _averaged_lobe(samples), ResidualBasis.HALF))


def srf_joint(basis: ResidualBasis, samples: Samples) -> tuple[Predict, int]:
    """One lobe found together with the residuals of a basis."""
    return _of_srf(_fit(samples, None, basis))


def svd(rank: int, samples: Samples) -> tuple[Predict, int]:
    """The strongest terms of the matrix of samples; between directions their vectors are interpolated."""
    filled = np.nan_to_num(samples.measured).reshape(len(samples.measured), -1)
    eigenvalues, left = np.linalg.eigh(filled @ filled.T)
    left = left[:, np.argsort(eigenvalues)[::-1][:rank]]
    maps = left.T @ filled
    places = _places(samples)
    between = RBFInterpolator(places, left, neighbors=min(_NEAR, len(places)), kernel="linear", degree=0)
    return lambda asked: (between(_places(asked)) @ maps).reshape(asked.true.shape), rank * sum(filled.shape)


def eight_methods(best: ResidualBasis) -> Mapping[str, Fit]:
    """All by name, simple ones first; `best` is the basis of the last SRF."""
    return {
        "constant": constant,
        "Phong": phong,
        "mean per texel": texel_mean,
        "PTM": partial(polynomial, ResidualBasis.BIQUADRATIC),
        "SRF, averaged lobes": srf_averaged,
        "SRF, joint lobe": partial(srf_joint, ResidualBasis.HALF),
        "SRF, best basis": partial(srf_joint, best),
        "SVD, as large": partial(svd, ResidualBasis.HALF.size),
    }


def of_each_size() -> Mapping[str, Mapping[int, list[Fit]]]:
    """Families of methods by their values per texel."""
    bases = [(3 * basis.size, basis) for basis in ResidualBasis]
    sizes = sorted({size for size, _ in bases})
    return {
        "SRF": {size: [partial(srf_joint, basis) for own, basis in bases if own == size] for size in sizes},
        "no lobe": {size: [partial(polynomial, basis) for own, basis in bases if own == size] for size in sizes},
        "SVD": {size: [partial(svd, size // 3)] for size in sizes},
    }


def nearest_basis(samples: Samples) -> ResidualBasis:
    """That whose SRF comes nearest to the samples it is fitted to."""
    return min(ResidualBasis, key=lambda basis: _fit(samples, None, basis).mse_srf)


def foretelling_basis(samples: Samples) -> ResidualBasis:
    """That of cross-validation over the directions of the samples."""
    return choose_basis(samples.measurements).basis


def _fit(samples: Samples, lobe: Lobe | None, basis: ResidualBasis) -> SrfFit:
    fit = fit_srf_to_btf if isinstance(samples.source, Btf) else fit_srf
    return fit(samples.source, lobe, basis)


def _averaged_lobe(samples: Samples) -> Lobe:
    """Of a BTF the lobe of the mean over its texels."""
    if isinstance(samples.source, Btf):
        return fit_phong_to_btf(samples.source).phong
    return fit_phong_per_direction(samples.measurements)[0]


def _least_squares_lobe(samples: Samples) -> Lobe:
    """Where all texels have the same directions that of their mean is that of all."""
    if isinstance(samples.source, Btf):
        return fit_phong_to_btf(samples.source).phong
    found = samples.measurements.lobe_samples(np.zeros(3))
    return fit_blinn_phong(LobeSamples(found.value, found.cos_light, found.cos_half)).phong


def _of_srf(fit: SrfFit) -> tuple[Predict, int]:
    srf = fit.srf
    channels, height, width, size = srf.residual.shape
    texels = np.nan_to_num(srf.residual).reshape(channels, height * width, size)

    def predict(asked: Samples) -> Array:
        functions = _functions(srf.basis, asked)
        if functions.shape[1] == 1:
            residual = np.einsum("dk,ctk->dtc", functions[:, 0], texels, optimize=True)
        else:
            residual = np.einsum("dtk,ctk->dtc", functions, texels)
        return np.where(asked.light[..., 2:] > 0, _lobe_values(srf.phong, asked) + residual, 0.0)

    return predict, srf.residual.size + (0 if srf.phong is _NO_LOBE else _LOBE)


def _places(samples: Samples) -> Array:
    """A point for each direction: the light's, of a BTF also the view's, on the disc below."""
    if isinstance(samples.source, Btf):
        return np.concatenate([samples.light[:, 0, :2], samples.view[:, 0, :2]], axis=1)
    return samples.source.light_directions


def _lobe_values(lobe: Lobe, asked: Samples) -> Array:
    """Values (direction, texel or 1, 3)."""
    light, view = np.broadcast_arrays(asked.light, asked.view)
    return lobe.evaluate(light.reshape(-1, 3), view.reshape(-1, 3)).reshape(light.shape)


def _functions(basis: ResidualBasis, asked: Samples) -> Array:
    """Values (direction, texel or 1, k)."""
    light, view = np.broadcast_arrays(asked.light, asked.view)
    return basis.evaluate(light.reshape(-1, 3), view.reshape(-1, 3)).reshape(*light.shape[:2], basis.size)
