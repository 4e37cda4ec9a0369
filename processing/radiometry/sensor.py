"""The noise model of a camera's sensor, and how its pixels differ from it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError


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


@dataclass(frozen=True, slots=True)
class PixelCorrection:
    """How each pixel (h, w) of one camera differs from its `Sensor`.

    A pixel under radiance r (electrons per second of the nominal pixel) collects flat r + dark electrons per second
    over a black level of black + offset. The variances, where known, are those of the maps themselves; they enter
    the variance of a merged image, in which they do not average out over frames. Hot pixels are not measured at all.
    Raises ImageError where the shapes differ or a pixel that is not hot has no positive, finite response.
    """

    offset_dn: NDArray[np.float32]
    dark_e_s: NDArray[np.float32]
    flat: NDArray[np.float32]
    hot: NDArray[np.bool_]
    dark_variance: NDArray[np.float32] | None = None
    flat_variance: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        maps = (self.offset_dn, self.dark_e_s, self.flat, self.hot, self.dark_variance, self.flat_variance)
        shapes = [m.shape for m in maps if m is not None]
        if len(shapes[0]) != 2 or len(set(shapes)) > 1:
            raise ImageError(f"maps of one camera's pixels have shapes {shapes}; all must be one (h, w).")
        sound = (self.flat > 0) & np.isfinite(self.flat) & np.isfinite(self.offset_dn) & np.isfinite(self.dark_e_s)
        if not (sound | self.hot).all():
            raise ImageError("offset, dark and flat must be finite and the flat positive wherever a pixel is not hot.")
