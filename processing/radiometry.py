"""From counts to light and from light to the display: sensor model, demosaicing, tone mapping."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError

_RED_BLUE = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], np.float64) / 4
_GREEN = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]], np.float64) / 4
_REC709 = np.array([0.2126, 0.7152, 0.0722])
_BURNT = 99.5  # percentile of the luminance that is shown as white
_KEY = 0.18  # Reinhard et al. 2002: the display value of the scene's log-average


@dataclass(frozen=True, slots=True)
class Sensor:
    """The noise model of one camera at one ISO: counts = black + (electrons + read noise) / gain, clipped at white.

    `assumed` says that gain and read noise are a guess because the frame carries no noise profile: radiance is then
    right up to a factor and its variance is only indicative.
    """

    black_dn: float
    white_dn: float
    gain_e_per_dn: float
    read_noise_e: float
    assumed: bool = False

    def __post_init__(self) -> None:
        numbers = (self.black_dn, self.white_dn, self.gain_e_per_dn, self.read_noise_e)
        if not all(np.isfinite(numbers)) or self.white_dn <= self.black_dn or self.gain_e_per_dn <= 0:
            raise ImageError(f"not a sensor: {self}; white must exceed black and the gain be positive.")

    @classmethod
    def from_noise_profile(cls, black_dn: float, white_dn: float, slope: float, offset: float) -> "Sensor":
        """Sensor of DNG's NoiseProfile: variance = slope x + offset on x = (dn - black) / (white - black).

        Source: DNG specification 1.7, tag 51041. Raises ImageError where the slope is not positive.
        """
        span_dn = white_dn - black_dn
        if slope <= 0 or span_dn <= 0:
            raise ImageError(f"noise profile ({slope}, {offset}): the slope must be positive.")
        gain = 1.0 / (slope * span_dn)
        return cls(black_dn, white_dn, gain, float(np.sqrt(max(offset, 0.0))) * span_dn * gain)

    @property
    def dark_variance_e2(self) -> float:
        """Variance of a sample without light: read noise and the rounding to whole counts, in electrons squared."""
        return self.read_noise_e**2 + self.gain_e_per_dn**2 / 12.0

    @property
    def saturation_e(self) -> float:
        """Electrons above which a sample is rounded to the white level or clipped to it."""
        return (self.white_dn - 0.5 - self.black_dn) * self.gain_e_per_dn


def cfa_channels(cfa: NDArray[np.uint8], shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Channel index (0 red, 1 green, 2 blue) of every pixel (h, w) of a mosaic with the 2x2 pattern `cfa`."""
    rows, columns = np.indices(shape, sparse=True)
    channels: NDArray[np.uint8] = np.asarray(cfa, np.uint8)[rows % 2, columns % 2]
    return channels


def demosaic(
    mosaic: NDArray[np.floating], variance: NDArray[np.floating], cfa: NDArray[np.uint8]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Colour image (h, w, 3) and variance of a linear Bayer mosaic (h, w), by normalised bilinear convolution.

    Missing samples (NaN) take no part: a pixel is NaN only where no neighbour has its channel. The variance is that
    of the weighted mean; neighbours share samples, so it is not independent between pixels.
    Raises ImageError where the shapes disagree or the pattern is not 2x2 of 0, 1, 2.
    """
    _check_mosaic(mosaic, variance, cfa)
    channels = cfa_channels(cfa, (mosaic.shape[0], mosaic.shape[1]))
    valid = np.isfinite(mosaic) & np.isfinite(variance)
    planes = [
        _interpolate(np.where(use, mosaic, 0.0), np.where(use, variance, 0.0), use, _GREEN if c == 1 else _RED_BLUE)
        for c, use in ((c, valid & (channels == c)) for c in range(3))
    ]
    return np.stack([p[0] for p in planes], -1), np.stack([p[1] for p in planes], -1)


def _check_mosaic(mosaic: NDArray[np.floating], variance: NDArray[np.floating], cfa: NDArray[np.uint8]) -> None:
    if mosaic.ndim != 2 or mosaic.shape != variance.shape:
        raise ImageError(f"mosaic {mosaic.shape} and variance {variance.shape} must be one (h, w).")
    if np.shape(cfa) != (2, 2) or not np.isin(cfa, (0, 1, 2)).all():
        raise ImageError(f"not a Bayer pattern: {np.asarray(cfa).tolist()}")


def _interpolate(
    value: NDArray[np.floating], variance: NDArray[np.floating], use: NDArray[np.bool_], kernel: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    total = _filter(use.astype(np.float64), kernel)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(total > 0, _filter(value, kernel) / total, np.nan)
        spread = np.where(total > 0, _filter(variance, kernel**2) / total**2, np.nan)
    return mean.astype(np.float32), spread.astype(np.float32)


def _filter(image: NDArray[np.floating], kernel: NDArray[np.float64]) -> NDArray[np.float64]:
    image64 = np.ascontiguousarray(image, np.float64)
    return np.asarray(cv2.filter2D(image64, cv2.CV_64F, kernel, borderType=cv2.BORDER_CONSTANT), np.float64)


def grey_mosaic(mosaic: NDArray[np.floating], cfa: NDArray[np.uint8]) -> NDArray[np.float64]:
    """A linear mosaic (h, w) of a scene without colour as a grey image: each channel scaled to the same brightness.

    Unlike demosaicing it keeps every pixel's own sample, so that small markers stay legible. The scale is the 95th
    percentile of each channel. Raises ImageError where a channel has no light or no finite sample.
    """
    _check_mosaic(mosaic, mosaic, cfa)
    channels = cfa_channels(cfa, (mosaic.shape[0], mosaic.shape[1]))
    known = [mosaic[(channels == c) & np.isfinite(mosaic)] for c in range(3)]
    level = np.array([np.percentile(values, 95) if values.size else 0.0 for values in known])
    if not (level > 0).all():
        raise ImageError("a mosaic without light, or saturated everywhere; check the lamp and the exposure.")
    return np.asarray(mosaic / level[channels], np.float64)


def white_balance(
    image: NDArray[np.floating], variance: NDArray[np.floating], multipliers: NDArray[np.floating]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Image and variance (..., 3) with each channel times its multiplier (3,), normalised so that green stays."""
    factors = np.asarray(multipliers, np.float64) / multipliers[1]
    return (image * factors).astype(np.float32), (variance * factors**2).astype(np.float32)


def srgb8(linear: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Display codes of linear values, 0 to 1 mapped to 0 to 255 (IEC 61966-2-1); outside clipped, NaN black."""
    x = np.clip(np.nan_to_num(linear, nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    codes: NDArray[np.uint8] = (encoded * 255.0 + 0.5).astype(np.uint8)
    return codes


def tonemap(radiance: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Display picture (h, w[, 3]) of linear radiance of any scale: Reinhard's global operator, burning at 99.5 %.

    Infinite radiance (saturated in every exposure) is white, NaN is black.
    Source: Reinhard et al. 2002, eqs. 1, 2 and 4.
    """
    luminance = radiance @ _REC709 if radiance.ndim == 3 else np.asarray(radiance, np.float64)
    lit = luminance[np.isfinite(luminance) & (luminance > 0)]
    if lit.size == 0:
        return srgb8(np.where(np.isposinf(radiance), 1.0, 0.0))
    scale = _KEY / np.exp(np.mean(np.log(lit)))
    burn = max(float(np.percentile(lit, _BURNT)) * scale, 1e-6)
    scaled = np.maximum(luminance * scale, 0.0)
    with np.errstate(invalid="ignore"):
        compression = scale * (1.0 + scaled / burn**2) / (1.0 + scaled)
    compression = np.where(np.isposinf(luminance), 1.0, compression)
    return srgb8(radiance * (compression[..., None] if radiance.ndim == 3 else compression))
