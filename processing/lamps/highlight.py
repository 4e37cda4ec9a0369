"""The image of a small lamp in a mirror ball: a spot of about a pixel, placed by the shape that all of it has.

A centroid of so few pixels, of three colours in a mosaic, would depend on where in its pixel the spot lies. A Gaussian
that is integrated over the pixels, with an amplitude for each colour, does not.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from processing.radiometry.hdr import PixelStatus, Radiance
from processing.radiometry.mosaic import cfa_channels

Array = NDArray[np.float64]
_HALF_PX = 5  # half side of the square that a spot is fitted in
_LEAST_NOISES = 8.0  # of a 2 x 2 block over the noise of the background
_WIDTHS_PX = (0.25, 3.0)  # a spot's standard deviation; a hot pixel is narrower, a window's reflection wider
_MAX_CHI2 = 1e4  # per degree of freedom; shapes that are not Gaussian reach hundreds in bright spots
_ROUNDS = 40
_REWEIGHTED = 3


@dataclass(frozen=True, eq=False)
class Highlight:
    """A spot: centre `uv_px` (column, row) and its covariance, standard deviation `width_px`, and `light` (3,).

    `light` is the sum over the spot's pixels, per channel, in the image's unit, as if every pixel had that channel.
    """

    uv_px: Array
    covariance_px2: Array
    width_px: float
    light: Array


def find_highlights(
    radiance: Radiance, cfa: NDArray[np.uint8], near_px: Array, reach_px: float, most: int = 3
) -> tuple[Highlight, ...]:
    """Up to `most` spots of a mosaic (h, w) within `reach_px` of an image point (column, row), the brightest first.

    Missing pixels take no part; saturated ones mark a spot, whose unsaturated flanks then place it. Empty where
    nothing rises over the noise: the lamp is dark or hidden.
    """
    value = _with_peaks(radiance)
    blocks = value[:-1, :-1] + value[1:, :-1] + value[:-1, 1:] + value[1:, 1:]
    rows, columns = np.ogrid[: blocks.shape[0], : blocks.shape[1]]
    away_px = np.hypot(columns + 0.5 - float(near_px[0]), rows + 0.5 - float(near_px[1]))
    blocks = np.where(away_px <= reach_px, blocks, np.nan)
    found: list[Highlight] = []
    while len(found) < most:
        peak = _peak(blocks, value)
        if peak is None:
            break
        row, column = peak
        blocks[max(row - _HALF_PX, 0) : row + _HALF_PX + 1, max(column - _HALF_PX, 0) : column + _HALF_PX + 1] = np.nan
        spot = fit_spot(radiance, cfa, np.array([column + 0.5, row + 0.5]))
        if spot is not None and np.hypot(*(spot.uv_px - near_px)) <= reach_px + 1:
            found.append(spot)
    return tuple(sorted(found, key=lambda spot: -float(spot.light.sum())))


def _with_peaks(radiance: Radiance) -> Array:
    """Values with 0 for missing pixels and, for saturated ones, twice the largest measured."""
    value = np.where(np.isfinite(radiance.value), radiance.value, 0.0).astype(np.float64)
    return np.where(radiance.status == PixelStatus.SATURATED, 2 * float(value.max(initial=0.0)), value)


def _peak(blocks: Array, value: Array) -> tuple[int, int] | None:
    """The brightest block, None where it does not stand out from the others."""
    known = blocks[np.isfinite(blocks)]
    if known.size < 16:
        return None
    middle = float(np.median(known))
    noise = 1.4826 * float(np.median(np.abs(known - middle)))
    row, column = np.unravel_index(np.nanargmax(blocks), blocks.shape)
    rises = blocks[row, column] - middle
    # A hot pixel stands alone; light from a lens falls on its neighbours too.
    around = np.sort(value[max(row - 1, 0) : row + 3, max(column - 1, 0) : column + 3], axis=None)
    if rises <= max(_LEAST_NOISES * noise, 1e-6 * abs(middle)) or around[-1] > 0.97 * around[-4:].sum():
        return None
    return int(row), int(column)


def fit_spot(radiance: Radiance, cfa: NDArray[np.uint8], near_px: Array) -> Highlight | None:
    """The spot at an image point, by weighted least squares; None where none is determined.

    Model: background + light of the channel x Gaussian integrated over the pixel; centre, width, three amplitudes and
    a background. The covariance is that of the fit, enlarged where the residuals exceed the noise.
    """
    height, width = radiance.value.shape
    column, row = np.rint(near_px).astype(int)
    top, left = max(row - _HALF_PX, 0), max(column - _HALF_PX, 0)
    window = np.s_[top : min(row + _HALF_PX + 1, height), left : min(column + _HALF_PX + 1, width)]
    value, variance = (np.asarray(part[window], np.float64) for part in (radiance.value, radiance.variance))
    known = np.isfinite(value) & np.isfinite(variance) & (variance > 0)
    if np.count_nonzero(known) < 20:
        return None
    rows, columns = np.nonzero(known)
    channel = cfa_channels(cfa, (height, width))[window][known].astype(np.intp)
    pixels = _Pixels(columns + left, rows + top, channel, value[known], variance[known])
    return pixels.fit(near_px)


@dataclass(frozen=True, eq=False)
class _Pixels:
    column: NDArray[np.intp]
    row: NDArray[np.intp]
    channel: NDArray[np.intp]
    value: Array
    variance: Array

    def fit(self, start_px: Array) -> Highlight | None:
        """Gauss-Newton on centre and log width, damped; the amplitudes are linear and follow (variable projection)."""
        variance = self.variance
        shape = np.array([start_px[0], start_px[1], np.log(0.7)])
        for _ in range(_REWEIGHTED):
            shape = self._minimise(shape, variance)
            variance = self._model_variance(shape)
        return self._describe(shape, variance)

    def _minimise(self, shape: Array, variance: Array) -> Array:
        residual, jacobian = self._linearised(shape, variance)
        cost, damping = float(residual @ residual), 1e-3
        for _ in range(_ROUNDS):
            normal = jacobian.T @ jacobian
            step = np.linalg.lstsq(normal + damping * np.diag(np.diag(normal)), jacobian.T @ residual, rcond=None)[0]
            trial = shape + np.clip(step[:3], -0.7, 0.7)
            trial[2] = np.clip(trial[2], *np.log((_WIDTHS_PX[0] / 2, 2 * _WIDTHS_PX[1])))
            trial_residual, trial_jacobian = self._linearised(trial, variance)
            trial_cost = float(trial_residual @ trial_residual)
            if not trial_cost < cost:
                damping *= 10
                if damping > 1e6:
                    break
                continue
            small = cost - trial_cost < 1e-10 * cost
            shape, residual, jacobian, cost = trial, trial_residual, trial_jacobian, trial_cost
            damping = max(damping / 10, 1e-9)
            if small:
                break
        return shape

    def _linearised(self, shape: Array, variance: Array) -> tuple[Array, Array]:
        """Whitened residual (n,) at the best amplitudes, and the whitened Jacobian (n, 7) of the model."""
        whiten = 1 / np.sqrt(variance)
        spot, slopes = self._spot(shape)
        linear = self._linear(spot) * whiten[:, None]
        amplitudes = np.linalg.lstsq(linear, self.value * whiten, rcond=None)[0]
        strength = amplitudes[self.channel] * whiten
        return self.value * whiten - linear @ amplitudes, np.column_stack([*(strength * s for s in slopes), linear])

    def _linear(self, spot: Array) -> Array:
        return np.column_stack([*(np.where(self.channel == c, spot, 0.0) for c in range(3)), np.ones_like(spot)])

    def _spot(self, shape: Array) -> tuple[Array, tuple[Array, Array, Array]]:
        """Share of the light in each pixel, and its slopes with column, row and log width."""
        u, v, width = shape[0], shape[1], np.exp(shape[2])
        across, across_u, across_w = _share(self.column, u, width)
        down, down_v, down_w = _share(self.row, v, width)
        return across * down, (across_u * down, across * down_v, across_w * down + across * down_w)

    def _model_variance(self, shape: Array) -> Array:
        """Variance as the fitted spot, not the pixel's own noisy value, makes it."""
        linear = self._linear(self._spot(shape)[0])
        whiten = 1 / np.sqrt(self.variance)
        model = linear @ np.linalg.lstsq(linear * whiten[:, None], self.value * whiten, rcond=None)[0]
        bright = self.value > 5 * np.sqrt(self.variance)
        ratio = np.divide(model, self.value, out=np.ones_like(model), where=bright)
        return np.asarray(self.variance * np.clip(ratio, 0.5, 2.0), np.float64)

    def _describe(self, shape: Array, variance: Array) -> Highlight | None:
        residual, jacobian = self._linearised(shape, variance)
        whiten = 1 / np.sqrt(variance)
        amplitudes = np.linalg.lstsq(
            self._linear(self._spot(shape)[0]) * whiten[:, None], self.value * whiten, rcond=None
        )[0]
        used = np.flatnonzero(np.linalg.norm(jacobian, axis=0) > 0)
        freedom = len(self.value) - len(used)
        width_px = float(np.exp(shape[2]))
        if freedom < 8 or not {0, 1, 2} <= set(used.tolist()) or not _WIDTHS_PX[0] < width_px < _WIDTHS_PX[1]:
            return None
        excess = float(residual @ residual) / freedom
        scale = np.linalg.norm(jacobian[:, used], axis=0)
        inverse = np.linalg.pinv((jacobian[:, used] / scale).T @ (jacobian[:, used] / scale), hermitian=True)
        covariance = np.asarray(inverse[:2, :2] / np.outer(scale[:2], scale[:2]) * max(excess, 1.0), np.float64)
        if excess > _MAX_CHI2 or not amplitudes[:3].sum() > 0 or not (np.diag(covariance) > 0).all():
            return None
        return Highlight(shape[:2].copy(), covariance, width_px, np.asarray(amplitudes[:3], np.float64))


def _share(pixels: NDArray[np.intp], centre: float, width: float) -> tuple[Array, Array, Array]:
    """Share of a Gaussian in pixels along one axis, and its slopes with the centre and the logarithm of the width."""
    ends = [(pixels + side - centre) / width for side in (-0.5, 0.5)]
    low, high = (np.exp(-end * end / 2) / np.sqrt(2 * np.pi) for end in ends)
    share = (erf(ends[1] / np.sqrt(2)) - erf(ends[0] / np.sqrt(2))) / 2
    return share, (low - high) / width, ends[0] * low - ends[1] * high
