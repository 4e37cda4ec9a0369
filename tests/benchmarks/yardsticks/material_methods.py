"""Representations of a material, each fitted to the same noisy samples and asked for any direction's values."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator

from processing.materials.measurements import sphere_measurements
from processing.materials.srf import fit_phong, fit_phong_per_direction, fit_srf
from processing.products import BlinnPhong, ResidualBasis, Srf
from tests.benchmarks.yardsticks.material_samples import Samples

Array = NDArray[Any]
Predict = Callable[[Samples], Array]
FLOAT = 4  # bytes of a value as stored


@dataclass(frozen=True, eq=False)
class Fitted:
    """A method's answer for any directions of the same texels, its stored size and the time of its fit."""

    method: str
    predict: Predict
    values: int
    seconds: float

    @property
    def bytes(self) -> int:
        """Size with four bytes to a value."""
        return self.values * FLOAT


def fit_all(samples: Samples) -> list[Fitted]:
    """Every method on these samples."""
    return [_timed(name, fit, samples) for name, fit in METHODS.items()]


def _timed(name: str, fit: Callable[[Samples], tuple[Predict, int]], samples: Samples) -> Fitted:
    begun_s = time.perf_counter()
    predict, values = fit(samples)
    return Fitted(name, predict, values, time.perf_counter() - begun_s)


def _constant(samples: Samples) -> tuple[Predict, int]:
    mean = np.nanmean(samples.measured, axis=(0, 1))
    return lambda asked: np.broadcast_to(mean, asked.true.shape), 3


def _phong(samples: Samples) -> tuple[Predict, int]:
    lobe = fit_phong(sphere_measurements(samples.source)).phong
    return lambda asked: _lobe(lobe, asked), 7


def _texel_mean(samples: Samples) -> tuple[Predict, int]:
    mean = np.nanmean(samples.measured, axis=0)
    return lambda asked: np.broadcast_to(mean, asked.true.shape), mean.size


def _ptm(samples: Samples) -> tuple[Predict, int]:
    basis = ResidualBasis.BIQUADRATIC
    coefficients = _least_squares(samples, basis)
    return lambda asked: np.einsum("dtk,tck->dtc", _functions(basis, asked), coefficients), coefficients.size


def _least_squares(samples: Samples, basis: ResidualBasis) -> Array:
    """Shortest coefficients (texel, channel, k) of the values themselves over the functions of a basis."""
    functions = _functions(basis, samples)
    valid = np.isfinite(samples.measured)
    gram = np.einsum("dtc,dti,dtj->tcij", valid.astype(float), functions, functions, optimize=True)
    right = np.einsum("dtc,dti->tci", np.where(valid, samples.measured, 0.0), functions, optimize=True)
    return np.einsum("tcij,tcj->tci", np.linalg.pinv(gram, rcond=1e-6, hermitian=True), right)


def _srf_averaged(samples: Samples) -> tuple[Predict, int]:
    lobe, _ = fit_phong_per_direction(sphere_measurements(samples.source))
    return _of_srf(fit_srf(samples.source, lobe).srf)


def _srf_joint(samples: Samples) -> tuple[Predict, int]:
    lobe = fit_phong(sphere_measurements(samples.source)).phong
    return _of_srf(fit_srf(samples.source, lobe).srf)


def _of_srf(srf: Srf) -> tuple[Predict, int]:
    channels, height, width, size = srf.residual.shape
    texels = np.nan_to_num(srf.residual.astype(np.float64)).reshape(channels, height * width, size)

    def predict(asked: Samples) -> Array:
        residual = np.einsum("dtk,ctk->dtc", _functions(srf.basis, asked), texels, optimize=True)
        return _lobe(srf.phong, asked) + residual

    return predict, srf.residual.size + 7


def _svd(samples: Samples) -> tuple[Predict, int]:
    """Rank 3 over the directions, as large as s . H; between directions its vectors are interpolated."""
    rank = 3
    known = np.isfinite(samples.measured)
    filled = np.where(known, samples.measured, 0.0).reshape(len(known), -1)
    left, singular, right = np.linalg.svd(filled, full_matrices=False)
    weights = left[:, :rank] * singular[:rank]
    between = RBFInterpolator(_places(samples), weights, kernel="linear", degree=0)

    def predict(asked: Samples) -> Array:
        return (between(_places(asked)) @ right[:rank]).reshape(asked.true.shape)

    return predict, rank * (filled.shape[1] + len(filled))


def _places(samples: Samples) -> Array:
    """One point for each direction: the light of the middle texel."""
    return np.asarray(samples.source.light_directions)


def _lobe(lobe: BlinnPhong, asked: Samples) -> Array:
    light, view = np.broadcast_arrays(asked.light, asked.view)
    return lobe.evaluate(light.reshape(-1, 3), view.reshape(-1, 3)).reshape(*light.shape[:2], 3)


def _functions(basis: ResidualBasis, asked: Samples) -> Array:
    light, view = np.broadcast_arrays(asked.light, asked.view)
    return basis.evaluate(light.reshape(-1, 3), view.reshape(-1, 3)).reshape(*light.shape[:2], basis.size)


METHODS: dict[str, Callable[[Samples], tuple[Predict, int]]] = {
    "constant": _constant,
    "Phong": _phong,
    "mean per texel": _texel_mean,
    "PTM": _ptm,
    "SRF, averaged lobes": _srf_averaged,
    "SRF, joint lobe": _srf_joint,
    "SVD": _svd,
}
