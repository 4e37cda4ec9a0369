"""Maps of how the pixels of one camera differ, each value as good as the frames and the other pixels make it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.errors import CalibrationError
from processing.radiometry.frame_series import PHASES, Mask, Series, phase_sum
from processing.radiometry.linearity import Linearity

Array = NDArray[np.float64]

CERTAIN = 5.0  # standard deviations from which a pixel's own value is kept whole
HOT_E_S = 100.0  # dark current from which a pixel is not used
DEAD, BRIGHT = 0.5, 1.5  # response relative to the surroundings beyond which a pixel is not used
DEGREE = 4  # of the polynomial for lens and light box
GRID = 512


@dataclass(frozen=True, eq=False)
class Spread:
    """A map shrunk toward its mean, the variance left in it, and the true standard deviation between pixels.

    `sigma` is the standard deviation of that `deviation`.
    """

    values: Array
    variance: Array
    deviation: float
    sigma: float


def shrunk(values: Array, noise_variance: Array | float, counted: Mask) -> Spread:
    """The best estimate of each pixel's deviation from 0, given how much pixels differ and how well each is measured.

    The true variance is what the map's exceeds its noise's. A value more than five of its standard deviations off
    does not belong to that distribution and is kept as it is.
    Source: linear minimum-variance estimate, prior / (prior + noise).
    """
    noise = np.broadcast_to(np.asarray(noise_variance, np.float64), values.shape)
    core = counted & (np.abs(values) < CERTAIN * np.sqrt(noise + np.median(values[counted] ** 2) / 0.455))
    prior = max(float((values[core] ** 2 - noise[core]).mean()), 0.0)
    mean_noise = float(noise[core].mean())
    of_square = float(np.sqrt((4 * prior + 2 * mean_noise) * mean_noise / max(int(core.sum()), 1)))
    share = prior / np.maximum(prior + noise, 1e-300)
    # What is left is stated for a prior one standard deviation larger: it may only seem to be nothing.
    left = (prior + of_square) * noise / np.maximum(prior + of_square + noise, 1e-300)
    outside = np.abs(values) > CERTAIN * np.sqrt(noise + prior)
    estimate = np.where(outside, values, share * values)
    deviation = float(np.sqrt(prior))
    sigma = of_square / (2 * deviation) if deviation > np.sqrt(of_square) else float(np.sqrt(of_square))
    return Spread(np.where(counted, estimate, 0.0), np.where(outside, noise, left), deviation, float(sigma))


class DarkSums:
    """Straight line of every pixel's dark counts over exposure time, from running sums."""

    def __init__(self) -> None:
        self._counts: Array = np.zeros((0, 0))
        self._moments = np.zeros(3)  # frames, times, squared times
        self._noise = np.zeros(3)  # the same, times the variance of a sample

    def add(self, series: Series, variance_dn2: float) -> None:
        """Count in the frames of one exposure, a sample of which has this variance."""
        if self._counts.size == 0:
            self._counts = np.zeros((2, *series.mean_dn.shape))
        self._counts[0] += series.frames * series.mean_dn
        self._counts[1] += series.frames * series.exposure_s * series.mean_dn
        moments = series.frames * np.array([1.0, series.exposure_s, series.exposure_s**2])
        self._moments += moments
        self._noise += variance_dn2 * moments

    def line(self) -> tuple[Array, Array, Array]:
        """Offset at no exposure (h, w) in dn, slope (h, w) in dn/s, and the variance (2,) of both.

        Raises CalibrationError where all exposures are one.
        """
        n, times, squares = self._moments
        determinant = n * squares - times**2
        if determinant <= 1e-9 * n * squares:
            raise CalibrationError("dark frames of one exposure only; dark current needs two exposures, far apart.")
        offset = (squares * self._counts[0] - times * self._counts[1]) / determinant
        slope = (n * self._counts[1] - times * self._counts[0]) / determinant
        along = np.array([[squares**2, -2 * squares * times, times**2], [times**2, -2 * n * times, n**2]])
        return offset, slope, along @ self._noise / determinant**2


def offset_map(offset_dn: Array, noise_dn2: float, counted: Mask) -> Spread:
    """Offsets about their mean: columns and rows as they are, since many pixels tell them, pixels shrunk."""
    use = np.where(counted, offset_dn, np.nan)
    lines = np.nanmean(use, axis=0)[None, :] + np.zeros_like(use)
    lines = lines + np.nanmean(use - lines, axis=1)[:, None]
    pixels = shrunk(offset_dn - lines, noise_dn2, counted)
    mean = float(np.nanmean(use))
    whole = lines - mean
    deviation = float(np.sqrt(max(float(np.nanvar(use)) - noise_dn2, 0.0)))
    sigma = pixels.sigma * pixels.deviation / max(deviation, 1e-12)
    return Spread(np.where(counted, whole + pixels.values, 0.0), pixels.variance, deviation, float(sigma))


class FlatSums:
    """Counts of every pixel over the exposures that its phase can use, with what exposed them."""

    def __init__(self) -> None:
        self._counts: Array = np.zeros((0, 0))
        self._used: list[list[tuple[int, int]]] = [[], [], [], []]  # (series, frames) per phase
        self._series = 0

    def add(self, series: Series, usable: NDArray[np.bool_]) -> None:
        """Count in the frames of one exposure in the phases (4,) that can use it."""
        if self._counts.size == 0:
            self._counts = np.zeros(series.mean_dn.shape)
        for phase, (row, column) in enumerate(PHASES):
            if usable[phase]:
                self._counts[row::2, column::2] += series.frames * series.mean_dn[row::2, column::2]
                self._used[phase].append((self._series, series.frames))
        self._series += 1

    def rates(self, light_s: Array, black_dn: Array, linearity: Linearity, typical_dn_s: Array) -> "FlatRates":
        """Linear counts per second (h, w) of each pixel, dark current among them.

        Solves sum over frames of C(rate t) = summed counts, C being what the sensor counts of linear counts; `light_s`
        (series,) are exposures corrected for the light's drift, `black_dn` (h, w) each pixel's black level.
        """
        rate, total, taken = (np.empty_like(self._counts) for _ in range(3))
        for phase, (row, column) in enumerate(PHASES):
            frames = np.array([count for _, count in self._used[phase]])
            times = light_s[[number for number, _ in self._used[phase]]]
            grid = typical_dn_s[phase] * np.linspace(-0.5, 3.0, GRID)
            summed = (frames * linearity.counted_dn(grid[:, None] * times)).sum(axis=1)
            part = np.s_[row::2, column::2]
            total[part] = self._counts[part] - frames.sum() * black_dn[part]
            rate[part] = np.interp(total[part], summed, grid)
            taken[part] = frames.sum()
        return FlatRates(rate, total, taken)


@dataclass(frozen=True, eq=False)
class FlatRates:
    """Rates (h, w) from flat frames, and what they rest on: summed counts over black, and how many frames."""

    rate_dn_s: Array
    total_dn: Array
    frames: Array

    def relative_variance(self, gain: float, noise_dn2: float, black_variance_dn2: Array) -> Array:
        """Of each rate: shot noise, that of the dark, and what is not known of the pixel's black level."""
        total = np.maximum(self.total_dn, 1.0)
        known = total / gain + self.frames * noise_dn2 + self.frames**2 * black_variance_dn2
        return np.asarray(known / total**2, np.float64)


def flat_map(rate_dn_s: Array, relative_variance: Array, counted: Mask) -> tuple[Spread, Mask]:
    """Relative response (h, w) with mean 1 per phase and its variance, and which pixels are sound.

    The smooth part, lens and light box, is a polynomial of both image coordinates common to all channels, the pixels'
    own part is shrunk toward 1. `Spread.deviation` is that of the pixels' own response.
    """
    typical = phase_sum(np.where(counted, rate_dn_s, 0.0)) / phase_sum(counted)
    relative = np.empty_like(rate_dn_s)
    for phase, (row, column) in enumerate(PHASES):
        relative[row::2, column::2] = rate_dn_s[row::2, column::2] / typical[phase]
    smooth = _polynomial(relative, counted)
    own = relative / smooth
    sound = counted & (own > DEAD) & (own < BRIGHT)
    pixels = shrunk(own - 1, relative_variance, sound)
    flat = smooth * (1 + pixels.values)
    return Spread(flat, smooth**2 * pixels.variance, pixels.deviation, pixels.sigma), sound


def _polynomial(values: Array, counted: Mask) -> Array:
    """Least squares on every pixel, weights against outliers (a pixel that is dead or bright) in a second round."""
    rows, columns = (np.linspace(-1, 1, side) for side in values.shape)
    powers = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    down = np.stack([rows**i for i, _ in powers], axis=1)
    right = np.stack([columns**j for _, j in powers], axis=1)
    weight = counted.astype(np.float64)
    fitted = np.ones_like(values)
    for _ in range(2):
        normal = _gram(down, right, weight)
        moment = np.einsum("hk,hw,wk->k", down, weight * np.where(counted, values, 0.0), right, optimize=True)
        fitted = np.einsum("hk,k,wk->hw", down, np.linalg.lstsq(normal, moment, rcond=None)[0], right, optimize=True)
        away = np.abs(np.where(counted, values / fitted - 1, 0.0))
        weight = (counted & (away < 0.1)).astype(np.float64)
    return np.asarray(fitted, np.float64)


def _gram(down: Array, right: Array, weight: Array) -> Array:
    """Sums of products of the basis over the image, without the basis at every pixel in memory."""
    count = down.shape[1]
    normal = np.empty((count, count))
    for k in range(count):
        part = (down * down[:, k : k + 1]).T @ weight
        normal[k] = np.einsum("kw,wk->k", part, right * right[:, k : k + 1])
    return normal
