"""From linear light to the display."""

import numpy as np
from numpy.typing import NDArray

_REC709 = np.array([0.2126, 0.7152, 0.0722])
_BURNT = 99.5  # percentile of the luminance that is shown as white
_KEY = 0.18  # Reinhard et al. 2002: the display value of the scene's log-average


def srgb(linear: NDArray[np.floating]) -> NDArray[np.floating]:
    """Display values of linear ones, 0 to 1 onto 0 to 1 (IEC 61966-2-1); outside clipped, NaN stays."""
    x = np.clip(linear, 0.0, 1.0)
    return np.asarray(np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055), linear.dtype)


def linear_of_srgb(encoded: NDArray[np.floating]) -> NDArray[np.floating]:
    """Inverse of `srgb` between 0 and 1; NaN stays."""
    x = np.clip(encoded, 0.0, 1.0)
    return np.asarray(np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4), encoded.dtype)


def srgb8(linear: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Display codes of linear values, 0 to 1 mapped to 0 to 255 (IEC 61966-2-1); outside clipped, NaN black."""
    codes: NDArray[np.uint8] = (srgb(np.nan_to_num(linear, nan=0.0, posinf=1.0, neginf=0.0)) * 255.0 + 0.5).astype(
        np.uint8
    )
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
