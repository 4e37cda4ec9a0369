"""The Bayer sensor: electrons become counts, with the noise that photons and electronics add.

`Sensor` holds the numbers of a model; `Unit` is one camera's own: its numbers differ a little from the model's, which
its files state, and its pixels differ from one another.
"""

from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

from simulators.chance import Key, generator

Floats = NDArray[np.float32]

GAUSSIAN_ABOVE_E = 50.0  # shot noise is exactly Poisson below, Gaussian of the same variance above
GAIN_SPREAD, READ_NOISE_SPREAD = 0.015, 0.05  # largest relative difference of a unit from its model
COMPRESSION = (0.004, 0.010)  # range of the share that is lost at the white level
OFFSET_PIXEL_DN, OFFSET_COLUMN_DN = 0.45, 0.22  # standard deviations; 0.5 dn together
RESPONSE_SPREAD = (0.005, 0.010)  # range of the standard deviation of the pixels' response
DARK_SPREAD = 0.3  # standard deviation of the logarithm of the dark current


@dataclass(frozen=True, slots=True)
class Sensor:
    """Numbers of one sensor; the full well lies above the white level, so saturation is the converter's.

    `compression` is the share of the counts over black that is lost at the white level: a signal of x dn over black is
    counted as x (1 - compression (x / span)^2), span being white - black.
    """

    black_dn: int = 256
    white_dn: int = 4095
    gain_e_per_dn: float = 4.0
    read_noise_e: float = 4.0
    dark_e_s: float = 0.5
    hot_share: float = 1e-4  # share of hot pixels
    hot_e_s: tuple[float, float] = (500.0, 20000.0)  # their dark current, log-uniform
    compression: float = 0.0

    def noise_profile(self) -> tuple[float, float]:
        """S and O of DNG's NoiseProfile: variance = S x + O for x = (dn - black) / (white - black)."""
        full_e = self.gain_e_per_dn * (self.white_dn - self.black_dn)
        return 1.0 / full_e, (self.read_noise_e / full_e) ** 2

    def dark_current(self, shape: tuple[int, int], key: Key) -> Floats:
        """Dark current (h, w), electrons per second: uneven, and a few hot pixels; the same for the same key."""
        rng = generator(key)
        hot = rng.random(shape) < self.hot_share
        low, high = np.log(self.hot_e_s)
        uneven = DARK_SPREAD * rng.standard_normal(shape, dtype=np.float32) - DARK_SPREAD**2 / 2
        dark = np.asarray(self.dark_e_s * np.exp(uneven), np.float32)
        dark[hot] = np.exp(rng.uniform(low, high, int(hot.sum())))
        return dark

    def expose(
        self, rate_e_s: Floats, exposure_s: float, key: Key, offset_dn: Floats | None = None
    ) -> NDArray[np.uint16]:
        """Counts (h, w) of one exposure of a mosaic of electron rates (h, w), `offset_dn` (h, w) above black.

        The same key gives the same bits, whatever was exposed before.
        """
        rng = generator(key)
        normal = rng.standard_normal(rate_e_s.shape, dtype=np.float32)
        uniform = rng.random(rate_e_s.shape, dtype=np.float32)
        counts = np.empty(rate_e_s.shape, np.uint16)
        offset = np.zeros(rate_e_s.shape, np.float32) if offset_dn is None else offset_dn
        white, black = float(self.white_dn), float(self.black_dn)
        levels = (self.gain_e_per_dn, self.read_noise_e, black, white, self.compression)
        noise = (normal.ravel(), uniform.ravel())
        _expose(rate_e_s.ravel(), exposure_s, noise, offset.ravel(), levels, counts.ravel())
        return counts


@dataclass(frozen=True, eq=False)
class Unit:
    """One camera's own sensor: numbers, and per pixel (h, w) offset, relative response (mean 1) and dark current."""

    sensor: Sensor
    offset_dn: Floats
    response: Floats
    dark_e_s: Floats

    def expose(self, rate_e_s: Floats, exposure_s: float, key: Key) -> NDArray[np.uint16]:
        """Counts (h, w) of electron rates (h, w) that hold the pixels' response and dark current already."""
        return self.sensor.expose(rate_e_s, exposure_s, key, self.offset_dn)


def build_unit(model: Sensor, shape: tuple[int, int], key: Key) -> Unit:
    """The unit of this key; the same key gives the same unit."""
    rng = generator((*key, "unit"))
    sensor = replace(
        model,
        gain_e_per_dn=model.gain_e_per_dn * (1 + GAIN_SPREAD * rng.uniform(-1, 1)),
        read_noise_e=model.read_noise_e * (1 + READ_NOISE_SPREAD * rng.uniform(-1, 1)),
        compression=rng.uniform(*COMPRESSION),
    )
    spread = rng.uniform(*RESPONSE_SPREAD)
    columns = OFFSET_COLUMN_DN * rng.standard_normal(shape[1], dtype=np.float32)
    offset = OFFSET_PIXEL_DN * rng.standard_normal(shape, dtype=np.float32) + columns
    response = 1 + spread * rng.standard_normal(shape, dtype=np.float32)
    dark = sensor.dark_current(shape, (*key, "dark"))
    return Unit(sensor, np.asarray(offset - offset.mean(), np.float32), np.asarray(response, np.float32), dark)


@numba.njit(cache=True)
def _expose(
    rate_e_s: Floats,
    exposure_s: float,
    noise: tuple[Floats, Floats],
    offset: Floats,
    levels: tuple[float, float, float, float, float],
    counts: NDArray[np.uint16],
) -> None:
    normal, uniform = noise
    gain, read_e, black, white, compression = levels
    for i in range(rate_e_s.size):
        mean_e = rate_e_s[i] * exposure_s
        if mean_e > GAUSSIAN_ABOVE_E:
            electrons = mean_e + np.sqrt(mean_e + read_e * read_e) * normal[i]
        else:
            electrons = _poisson(mean_e, uniform[i]) + read_e * normal[i]
        share = min(electrons / gain / (white - black), 2.0)  # far above white, whatever is lost
        signal = share * (1.0 - compression * share * share) * (white - black)
        level = np.floor(black + offset[i] + signal + 0.5)
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
