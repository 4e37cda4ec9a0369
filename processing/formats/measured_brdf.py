"""Measured BRDFs as text, .brdf: wavelengths, then per line two directions and the BRDF at each wavelength.

Comments begin with #. The first number counts the wavelengths, which follow in nm; then come lines of theta_i, phi_i,
theta_s, phi_s in radians, theta from the normal, and the values in 1/sr. Written by Cornell's Program of Computer
Graphics, read by pbrt (version 2).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from processing.errors import ImageError
from processing.products.arrays import Float32, Float64

_BANDS_NM = ((580.0, 700.0), (490.0, 580.0), (400.0, 490.0))  # red, green, blue


@dataclass(frozen=True, eq=False)
class MeasuredBrdf:
    """`value` (s, wavelength) in 1/sr at `wavelength_nm`, for unit vectors `light`, `view` (s, 3), z the normal."""

    wavelength_nm: Float64
    light: Float64
    view: Float64
    value: Float64

    def rgb(self) -> Float32:
        """Means over 580 to 700, 490 to 580 and 400 to 490 nm (s, 3); NaN for a band that was not measured."""
        bands = [(self.wavelength_nm >= low) & (self.wavelength_nm < high) for low, high in _BANDS_NM]
        empty = np.full(len(self.value), np.nan)
        means = [self.value[:, band].mean(axis=1) if band.any() else empty for band in bands]
        return np.stack(means, axis=1).astype(np.float32)


def read_measured_brdf(path: Path) -> MeasuredBrdf:
    """Raises ImageError where the file cannot be read, is not numbers throughout, or ends within a line."""
    try:
        lines = path.read_text(encoding="ascii").splitlines()
        numbers = np.array(" ".join(line.split("#")[0] for line in lines).split(), np.float64)
    except (OSError, ValueError) as error:
        raise ImageError(f"{path}: not a readable measured BRDF ({error}).") from error
    count = int(numbers[0]) if len(numbers) and 0 < numbers[0] < len(numbers) else 0
    rows = numbers[1 + count :]
    if count == 0 or len(rows) == 0 or len(rows) % (4 + count):
        raise ImageError(f"{path}: {len(numbers)} numbers are not whole lines of angles and {count} values.")
    table = rows.reshape(-1, 4 + count)
    return MeasuredBrdf(numbers[1 : 1 + count], _direction(*table[:, :2].T), _direction(*table[:, 2:4].T), table[:, 4:])


def _direction(polar: Float64, azimuth: Float64) -> Float64:
    across = np.sin(polar)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.cos(polar)], axis=1)
