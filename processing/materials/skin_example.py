"""The example that a skin is made of: what it looks like, and where in it a piece fits."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.random import Generator
from scipy import fft
from scipy.ndimage import maximum_filter

from processing.products.arrays import Float32, Float64
from processing.products.srf import Srf

CELL_TEXELS = 2  # pieces are compared at half the resolution first
_COMPONENTS = 4
# Offsets whose error is within a tenth of the best are alike (Efros and Freeman 2001, 2.1).
_TOLERANCE = 0.1
_ELEVATIONS_RAD = np.radians([35.0, 65.0])
_VIEWS = [-1, 4, 5, 6, 7]  # among the lights: straight above, and the steep ones


@dataclass(frozen=True, slots=True, eq=False)
class Example:
    """Residuals as an image, `coefficients` (h, w, 3 k), and what the eye sees of them, `appearance` (h, w, 4).

    Appearance is the radiance under nine lights from five sides, in its four principal components, scaled to unit
    variance in all: one measure of difference whatever the basis. `seen` (3 k, 4) takes coefficients to it. `missing`
    (h, w) is 0 where a residual is determined.
    """

    coefficients: Float32
    appearance: Float32
    seen: Float64
    missing: Float32
    wrap: bool

    @property
    def cells(self) -> Float32:
        """Appearance at the resolution that pieces are compared at first, (h / 2, w / 2, 4)."""
        return _blocks(self.appearance)

    def holes(self, cells: int) -> Float64:
        """Cells of a round piece at each offset (h / 2, w / 2) that are not determined, or lie next to such."""
        missing = _blocks(self.missing[..., None])[..., 0]
        missing = maximum_filter(missing > 0.0, 3, mode="wrap" if self.wrap else "nearest").astype(np.float64)
        from_middle = np.arange(cells) - 0.5 * (cells - 1)
        disc = np.hypot(*np.meshgrid(from_middle, from_middle)) <= 0.5 * cells
        spectrum = np.conj(fft.rfft2(disc, missing.shape)) * fft.rfft2(missing)
        return np.asarray(np.rint(fft.irfft2(spectrum, missing.shape)))


def example_of(srf: Srf, scale: float) -> Example:
    """The residual with `scale` texels (at most 1) for each of the SRF's; undetermined ones count as 0."""
    missing = np.isnan(srf.residual).any(axis=(0, 3)).astype(np.float32)
    image = np.moveaxis(np.nan_to_num(srf.residual), 0, 2)
    h, w = (max(2 * CELL_TEXELS, CELL_TEXELS * round(scale * side / CELL_TEXELS)) for side in image.shape[:2])
    flat = np.ascontiguousarray(image.reshape(*image.shape[:2], -1))
    layers = [cv2.resize(layer, (w, h), interpolation=cv2.INTER_AREA) for layer in [*np.moveaxis(flat, 2, 0), missing]]
    coefficients = np.ascontiguousarray(np.stack(layers[:-1], axis=-1), np.float32)
    seen = _principal(srf, coefficients)
    appearance = np.asarray(coefficients @ seen, np.float32)
    return Example(coefficients, appearance, seen, np.asarray(layers[-1], np.float32), srf.wrap)


class Fitter:
    """Where pieces of a certain size fit into an example, by the squared difference of appearance at every offset.

    By FFT: sum of m (e - x)^2 over a piece e with mask m is a sum of three correlations.
    """

    def __init__(self, example: Example, cells: int) -> None:
        self.example, self.cells = example, cells
        self._image = example.cells.astype(np.float64)
        self._shape = self._image.shape[:2]
        self._spectrum = fft.rfft2(self._image, axes=(0, 1))
        self._squares = fft.rfft2((self._image**2).sum(axis=2))
        last = self._shape if example.wrap else tuple(side - cells + 1 for side in self._shape)
        self._offsets = (slice(0, last[0]), slice(0, last[1]))
        holes = example.holes(cells)[self._offsets]
        self._worse = holes > holes.min()

    def choose(self, piece: Float64, mask: Float64, rng: Generator) -> tuple[int, int]:
        """Row and column, in cells, of one of the best places for `piece` (c, c, 4) where `mask` (c, c) is set.

        Any place where nothing is set; never one with more holes in the example than others.
        """
        masked = fft.rfft2(piece * mask[..., None], self._shape, axes=(0, 1))
        cross = (np.conj(masked) * self._spectrum).sum(axis=2)
        square = np.conj(fft.rfft2(mask, self._shape)) * self._squares
        error = fft.irfft2(square - 2.0 * cross, self._shape)[self._offsets]
        error = np.maximum(error + float((mask[..., None] * piece**2).sum()), 0.0)
        error[self._worse] = np.inf
        # The floor is the rounding of the transform: below it, all are alike.
        alike = np.flatnonzero(error <= error.min() * (1.0 + _TOLERANCE) + 1e-9 * max(float(mask.sum()), 1.0))
        row, column = np.unravel_index(rng.choice(alike), error.shape)
        return int(row), int(column)


def _blocks(image: Float32) -> Float32:
    """Means of CELL_TEXELS x CELL_TEXELS texels of an image (h, w, c)."""
    h, w = image.shape[:2]
    blocks = image.reshape(h // CELL_TEXELS, CELL_TEXELS, w // CELL_TEXELS, CELL_TEXELS, -1)
    return np.asarray(blocks.mean(axis=(1, 3)))


def _principal(srf: Srf, coefficients: Float32) -> Float64:
    """The map from coefficients to the principal components of their radiance, of unit variance in all."""
    azimuths = np.arange(4) * (np.pi / 2.0)
    level, azimuth = (a.ravel() for a in np.meshgrid(_ELEVATIONS_RAD, azimuths))
    across = np.cos(level)
    light = np.column_stack([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(level)])
    light = np.concatenate([light, [[0.0, 0.0, 1.0]]])
    views = light[_VIEWS]
    functions = srf.basis.evaluate(np.tile(light, (len(views), 1)), np.repeat(views, len(light), axis=0))
    seen = np.kron(np.eye(3), functions.T)  # (3 k, 3 lights x views)
    flat = coefficients.reshape(-1, coefficients.shape[-1]).astype(np.float64)
    covariance = seen.T @ np.cov(flat, rowvar=False) @ seen
    variance, axes = np.linalg.eigh(covariance)
    largest = axes[:, -_COMPONENTS:]
    total = float(variance[-_COMPONENTS:].sum())
    # An example that looks the same everywhere fits everywhere.
    return np.asarray(seen @ largest / (np.sqrt(total) if total > 0.0 else np.inf))
