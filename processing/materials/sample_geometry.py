"""What the light and the view of each sample are to the functions of a basis and to the lobe."""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from processing.materials.measurements import Measurements
from processing.products import BlinnPhong, Lobe, ResidualBasis
from processing.products.arrays import Float64

_SMALLEST_COSINE = 1e-300  # of N.H, in place of all below: its powers are 0, its logarithm a number
_CODES = {basis: code for code, basis in enumerate(ResidualBasis)}
_ABOUT = 1 / np.sqrt(2 * np.pi)
_HALF, _HALF_LIGHT, _BIQUADRATIC, _BILINEAR = (
    _CODES[basis]
    for basis in (ResidualBasis.HALF, ResidualBasis.HALF_LIGHT, ResidualBasis.BIQUADRATIC, ResidualBasis.BILINEAR)
)


@dataclass(frozen=True, eq=False)
class SampleGeometry:
    """Texel by texel, the directions last; one texel stands for all where they share their directions.

    `basis` (texel or 1, k, direction) has the values of the residual's functions, `cos_light` (texel or 1, direction)
    N.L, `log_half` of the same shape the logarithm of N.H, and `twice` (texel or 1, 2, direction) cosine and sine of
    twice the azimuth of H, 1 and 0 where H = N. Unlit samples have zeros for their basis.
    """

    basis: Float64
    cos_light: Float64
    log_half: Float64
    twice: Float64

    @classmethod
    def of(cls, measurements: Measurements, basis: ResidualBasis) -> "SampleGeometry":
        """Of all samples of the measurements."""
        light, view = np.ascontiguousarray(measurements.light), np.ascontiguousarray(measurements.view)
        return cls(*_tabulate(light, view, _CODES[basis], basis.size))

    def some(self, texels: NDArray[np.intp] | slice) -> "SampleGeometry":
        """Of some texels."""
        if len(self.cos_light) == 1:
            return self
        return SampleGeometry(self.basis[texels], self.cos_light[texels], self.log_half[texels], self.twice[texels])

    def power(self, lobe: Lobe) -> Float64:
        """(N.H)^n of the lobe, (texel or 1, direction)."""
        if isinstance(lobe, BlinnPhong):
            return np.asarray(np.exp(lobe.exponent * self.log_half), np.float64)
        mean, half_range = lobe.exponents.sum() / 2, (lobe.exponents[0] - lobe.exponents[1]) / 2
        turn = np.array([np.cos(2 * lobe.turn_rad), np.sin(2 * lobe.turn_rad)])
        exponent = mean + half_range * np.einsum("k,tkd->td", turn, self.twice)
        return np.asarray(np.exp(exponent * self.log_half), np.float64)


@numba.njit(inline="always")
def at(index: int, length: int) -> np.int64:
    """Where to look along an axis whose length may be 1 for all."""
    return np.int64(0 if length == 1 else index)


@numba.njit(cache=True, parallel=True)
def _tabulate(light: Float64, view: Float64, code: int, size: int) -> tuple[Float64, Float64, Float64, Float64]:
    directions, texels = len(light), max(light.shape[1], view.shape[1])
    basis, cos_light = np.zeros((texels, size, directions)), np.zeros((texels, directions))
    log_half, twice = np.zeros((texels, directions)), np.zeros((texels, 2, directions))
    for t in numba.prange(texels):
        for d in range(directions):
            one = light[d, at(t, light.shape[1])]
            other = view[at(d, len(view)), at(t, view.shape[1])]
            x, y, z = one[0] + other[0], one[1] + other[1], one[2] + other[2]
            length = np.sqrt(x * x + y * y + z * z)
            if length > 0:
                x, y, z = x / length, y / length, z / length
            cos_light[t, d] = one[2]
            log_half[t, d] = np.log(min(max(z, _SMALLEST_COSINE), 1.0))
            level = x * x + y * y
            twice[t, 0, d] = (x * x - y * y) / level if level > 0 else 1.0
            twice[t, 1, d] = 2 * x * y / level if level > 0 else 0.0
            if one[2] > 0:
                _evaluate(code, (one, other), (x, y, z), basis[t, :, d])
    return basis, cos_light, log_half, twice


@numba.njit(cache=True)
def _evaluate(code: int, ways: tuple[Float64, Float64], half: tuple[float, float, float], out: Float64) -> None:
    """`ResidualBasis.evaluate` of one sample, whose `ways` lead to the light and to the eye."""
    light, view = ways
    x, y, z = light
    if code == _HALF or code == _HALF_LIGHT:
        out[0], out[1], out[2] = half
        if code == _HALF_LIGHT:
            out[3], out[4] = z, 1.0
    elif code == _BIQUADRATIC:
        out[0], out[1], out[2] = 1.0, x, y
        out[3], out[4], out[5] = x * x, x * y, y * y
    elif code == _BILINEAR:
        for i in range(9):
            out[i] = light[i // 3] * view[i % 3]
    else:
        _hemispherical(x, y, z, out)


@numba.njit(cache=True)
def _hemispherical(x: float, y: float, z: float, out: Float64) -> None:
    cosine = min(max(z, 0.0), 1.0)
    level = np.hypot(x, y)
    c, s = (x / level, y / level) if level > 0 else (0.0, 0.0)
    shifted = 2 * cosine - 1
    root = 2 * np.sqrt(cosine * (1 - cosine))
    first, second = np.sqrt(3.0) * _ABOUT, np.sqrt(15.0) * _ABOUT
    out[0], out[1], out[2], out[3] = _ABOUT, first * root * s, first * shifted, first * root * c
    out[4], out[5] = second * root * root * c * s, second * shifted * root * s
    out[6] = np.sqrt(5.0) * _ABOUT * (1.5 * shifted * shifted - 0.5)
    out[7], out[8] = second * shifted * root * c, 0.5 * second * root * root * (c * c - s * s)
