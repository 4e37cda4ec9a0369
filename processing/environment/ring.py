"""The ring near a fish-eye image's rim, on polar places."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from processing.environment.image_circle import ImageCircle
from processing.products.arrays import Float64

RING = 0.6, 0.992  # of the image radius: where a frame reflects


@dataclass(frozen=True, eq=False)
class RingGrid:
    """Polar places around a circle's centre: radii (r,) in pixels, `count` azimuths, about as far apart."""

    centre_px: Float64
    radii_px: Float64
    count: int

    @property
    def step_px(self) -> float:
        """Pixels between two radii."""
        return float(self.radii_px[1] - self.radii_px[0])

    @property
    def outer_px(self) -> float:
        """Radius of the image circle."""
        return float(self.radii_px[0] / RING[0])

    def of(self, circle: ImageCircle) -> "RingGrid":
        """The same places of another circle by the same lens."""
        return replace(self, centre_px=circle.centre_px, radii_px=self.radii_px * circle.radius_px / self.outer_px)

    @property
    def places_px(self) -> Float64:
        """(r, count, 2) as (column, row)."""
        angle = 2 * np.pi * np.arange(self.count) / self.count
        toward = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return np.asarray(self.centre_px + self.radii_px[:, None, None] * toward)

    def sample(self, picture: NDArray[np.floating]) -> Float64:
        """A picture (h, w) at the places (r, count), linear between pixels."""
        at = self.places_px
        found = map_coordinates(np.asarray(picture, np.float64), [at[..., 1], at[..., 0]], order=1, mode="nearest")
        return np.asarray(found, np.float64)

    def back(self, ring: Float64, shape: tuple[int, int]) -> Float64:
        """Values (r, count) at the pixels (h, w) of the picture, 0 outside of the ring."""
        rows, columns = np.indices(shape)
        x, y = columns - self.centre_px[0], rows - self.centre_px[1]
        r = (np.hypot(x, y) - self.radii_px[0]) / self.step_px
        phi = np.arctan2(y, x) % (2 * np.pi) / (2 * np.pi) * self.count
        wrapped = np.concatenate([ring, ring[:, :1]], axis=1)
        found = map_coordinates(wrapped, [np.clip(r, 0, len(ring) - 1), phi], order=1, mode="nearest")
        return np.where((r >= 0) & (r <= len(ring) - 1), found, 0.0)


def ring_grid(circle: ImageCircle, step_px: float = 1.0) -> RingGrid:
    """The ring of a circle in which reflections of the frame are looked for, places that far apart."""
    inner, outer = (share * circle.radius_px for share in RING)
    count = int(2 * np.pi * 0.9 * circle.radius_px / step_px) // 2 * 2
    return RingGrid(circle.centre_px, np.arange(inner, outer, step_px), count)
