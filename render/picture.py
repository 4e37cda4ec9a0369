"""Linear pictures, and the only place where they become display values."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from render.arrays import Float32, Float64, Rows

Srgb8 = NDArray[np.uint8]

# Above this display value highlights are bent toward white instead of being cut.
_SHOULDER = 0.75
# Luminance of linear sRGB primaries (IEC 61966-2-1).
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
# The backdrop in linear display values: dark, a little lighter in the middle, so that both rims stand out.
_BACKDROP_MIDDLE, _BACKDROP_CORNER = np.array([0.052, 0.055, 0.060]), np.array([0.012, 0.013, 0.015])


@dataclass(frozen=True, eq=False)
class Picture:
    """Linear `radiance` (h, w, 3) float32 and the share of each pixel that shows the object, `coverage` (h, w).

    Radiance is premultiplied: an edge pixel that is half covered has half its surface's radiance.
    """

    radiance: Float32
    coverage: Float32

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Pixels that show the object at all, (h, w)."""
        return self.coverage > 0.0

    def averaged(self, factor: int) -> "Picture":
        """The picture with `factor` x `factor` pixels averaged to one."""
        if factor == 1:
            return self
        return Picture(_block_means(self.radiance, factor), _block_means(self.coverage, factor))

    def srgb8(self, exposure: float) -> Srgb8:
        """Display values (h, w, 3): radiance times `exposure`, highlights rolled off, over the backdrop, as sRGB."""
        coverage = self.coverage[:, :, None]
        surface = self.radiance / np.maximum(coverage, 1e-6) * exposure
        display = coverage * _rolled_off(surface) + (1.0 - coverage) * _backdrop(self.coverage.shape)
        return encode_srgb8(display)


def exposure_for(pictures: Sequence[Picture], *, level: float = 0.65, percentile: float = 98.0) -> float:
    """One exposure for all pictures: that percentile of the object's luminance becomes `level` on the display.

    1 where nothing is lit.
    """
    lit = np.concatenate([p.radiance[p.coverage > 0.99] @ LUMINANCE for p in pictures])
    reference = float(np.percentile(lit, percentile)) if lit.size else 0.0
    return level / reference if reference > 0.0 else 1.0


def encode_srgb8(linear: Rows) -> Srgb8:
    """Linear display values as 8-bit sRGB; what lies outside [0, 1] ends at its bound (IEC 61966-2-1)."""
    value = np.clip(linear, 0.0, 1.0)
    encoded = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1.0 / 2.4) - 0.055)
    return np.asarray(np.round(255.0 * encoded), dtype=np.uint8)


def contact_sheet(images: Sequence[Srgb8], columns: int, *, gap_px: int = 6) -> Srgb8:
    """Images of one size side by side in rows of `columns`, on black."""
    height, width = images[0].shape[:2]
    rows = -(-len(images) // columns)
    sheet = np.zeros((rows * (height + gap_px) - gap_px, columns * (width + gap_px) - gap_px, 3), dtype=np.uint8)
    for index, image in enumerate(images):
        top, left = index // columns * (height + gap_px), index % columns * (width + gap_px)
        sheet[top : top + height, left : left + width] = image
    return sheet


def save_image(path: Path, image: Srgb8) -> None:
    """Write an image; the suffix says the format."""
    Image.fromarray(image).save(path)


def save_animation(path: Path, images: Sequence[Srgb8], *, frame_time_s: float = 0.08) -> None:
    """Write an endless animation as .png (lossless), .webp (small) or .gif (256 colours)."""
    first, *rest = (Image.fromarray(image) for image in images)
    duration_ms = round(1000.0 * frame_time_s)
    first.save(path, save_all=True, append_images=rest, duration=duration_ms, loop=0)


def _block_means(image: Float32, factor: int) -> Float32:
    """Means of `factor` x `factor` pixels; whole strided images are added, which is quicker than a mean over axes."""
    total = np.zeros_like(image[::factor, ::factor])
    for row in range(factor):
        for column in range(factor):
            total += image[row::factor, column::factor]
    return np.asarray(total / np.float32(factor * factor), dtype=np.float32)


def _rolled_off(display: Rows) -> Float64:
    """Display values with everything above the shoulder bent below 1; slope and value meet at the shoulder."""
    room = 1.0 - _SHOULDER
    over = np.maximum(display - _SHOULDER, 0.0)
    return np.asarray(np.minimum(display, _SHOULDER) + room * (1.0 - np.exp(-over / room)))


@lru_cache(maxsize=4)
def _backdrop(shape: tuple[int, ...]) -> Float64:
    """The backdrop (h, w, 3) in linear display values."""
    row, column = np.meshgrid(*(np.linspace(-1.0, 1.0, side) for side in shape), indexing="ij")
    share = np.clip(0.5 * (row**2 + column**2), 0.0, 1.0)[:, :, None]
    return np.asarray(_BACKDROP_MIDDLE * (1.0 - share) + _BACKDROP_CORNER * share)
