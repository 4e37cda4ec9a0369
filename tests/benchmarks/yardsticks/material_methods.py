"""Representations of a material, each fitted to the same noisy samples and asked for any direction's values."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator

from processing.materials.measurements import mean_over_texels
from processing.materials.phong import LobeSamples, fit_blinn_phong
from processing.materials.srf import SrfFit, fit_phong_per_direction, fit_srf, fit_srf_to_btf
from processing.products import Btf, Lobe, ReflectanceMaps, ResidualBasis
from tests.benchmarks.yardsticks.material_samples import Samples

Array = NDArray[Any]
Predict = Callable[[Samples], Array]
Fit = Callable[[Samples], tuple[Predict, int]]
_BYTES = 4  # of a value as stored
_LOBE = 7  # values of a round lobe
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
    return partial(_lobe_values, lobe), _LOBE


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


METHODS: Mapping[str, Fit] = {
    "constant": constant,
    "Phong": phong,
    "mean per texel": texel_mean,
    "PTM": partial(polynomial, ResidualBasis.BIQUADRATIC),
    "SRF, averaged lobes": srf_averaged,
    "SRF, joint lobe": partial(srf_joint, ResidualBasis.HALF),
    "SVD": partial(svd, 3),  # 9 values a texel, as s . H
}


@dataclass(frozen=True)
class _NoLobe:
    pass


def _fit(samples: Samples, lobe: Lobe | None, basis: ResidualBasis) -> SrfFit:
    if isinstance(samples.source, Btf):
        return fit_srf_to_btf(samples.source, lobe, basis)
    return fit_srf(samples.source, lobe, basis)
