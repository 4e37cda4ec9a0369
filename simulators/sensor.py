"""The Bayer sensor: electrons become counts, with the noise that photons and electronics add."""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from simulators.chance import Key, generator

GAUSSIAN_ABOVE_E = 50.0  # shot noise is exactly Poisson below, Gaussian of the same variance above


@dataclass(frozen=True, slots=True)
class Sensor:
    """Numbers of one sensor; the full well lies above the white level, so saturation is the converter's."""

    black_dn: int = 256
    white_dn: int = 4095
    gain_e_per_dn: float = 4.0
    read_noise_e: float = 4.0
    dark_e_s: float = 0.5
    hot_share: float = 1e-4  # share of hot pixels
    hot_e_s: tuple[float, float] = (500.0, 20000.0)  # their dark current, log-uniform

    def noise_profile(self) -> tuple[float, float]:
        """S and O of DNG's NoiseProfile: variance = S x + O for x = (dn - black) / (white - black)."""
        full_e = self.gain_e_per_dn * (self.white_dn - self.black_dn)
        return 1.0 / full_e, (self.read_noise_e / full_e) ** 2

    def dark_current(self, shape: tuple[int, int], key: Key) -> NDArray[np.float32]:
        """Dark current (h, w), electrons per second: even but for a few hot pixels, the same for the same key."""
        rng = generator(key)
        dark = np.full(shape, self.dark_e_s, np.float32)
        hot = rng.random(shape) < self.hot_share
        low, high = np.log(self.hot_e_s)
        dark[hot] = np.exp(rng.uniform(low, high, int(hot.sum())))
        return dark

    def expose(self, rate_e_s: NDArray[np.float32], exposure_s: float, key: Key) -> NDArray[np.uint16]:
        """Counts (h, w) of one exposure of a mosaic of electron rates (h, w).

        The same key gives the same bits, whatever was exposed before.
        """
        rng = generator(key)
        normal = rng.standard_normal(rate_e_s.shape, dtype=np.float32)
        uniform = rng.random(rate_e_s.shape, dtype=np.float32)
        counts = np.empty(rate_e_s.shape, np.uint16)
        levels = (self.gain_e_per_dn, self.read_noise_e, float(self.black_dn), float(self.white_dn))
        _expose(rate_e_s.ravel(), exposure_s, normal.ravel(), uniform.ravel(), levels, counts.ravel())
        return counts


@numba.njit(cache=True)
def _expose(
    rate_e_s: NDArray[np.float32],
    exposure_s: float,
    normal: NDArray[np.float32],
    uniform: NDArray[np.float32],
    levels: tuple[float, float, float, float],
    counts: NDArray[np.uint16],
) -> None:
    gain, read_e, black, white = levels
    for i in range(rate_e_s.size):
        mean_e = rate_e_s[i] * exposure_s
        if mean_e > GAUSSIAN_ABOVE_E:
            electrons = mean_e + np.sqrt(mean_e + read_e * read_e) * normal[i]
        else:
            electrons = _poisson(mean_e, uniform[i]) + read_e * normal[i]
        level = np.floor(black + electrons / gain + 0.5)
        counts[i] = np.uint16(min(max(level, 0.0), white))


@numba.njit(cache=True)
def _poisson(mean: float, uniform: float) -> float:
    """Inverse of the Poisson distribution function, by summing from zero."""
    probability = np.exp(-mean)
    total = probability
    count = 0
    while uniform > total and count < 200:
        count += 1
        probability *= mean / count
        total += probability
    return float(count)
