"""Merged photographs of a body under one light after another, as a camera's mosaics.

Frames are those of `products.sphere`: x along the image's columns, y down its rows, z from the camera to the body's
centre, from which distances are measured.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from processing.errors import ImageError
from processing.products.arrays import Float64


@dataclass(frozen=True, eq=False)
class BodyPhotographs:
    """Merged photographs of a body, one per light, and where the lights stand.

    `radiance` and its `variance` are mosaics (light, row, column) in any one unit, NaN where nothing was measured;
    `cfa` (2, 2) tells channel 0, 1 or 2 of each site. `light_directions` (light, 3) are unit vectors away from the
    body's centre; a distance may be infinite. `radius_m` is that of the sphere, or of the sphere about the centre that
    holds the body. `lamps` (light,) are the same number where it is the same lamp that stands elsewhere.
    Raises ImageError where the shapes do not belong together.
    """

    radiance: NDArray[np.floating]
    variance: NDArray[np.floating]
    cfa: NDArray[np.uint8]
    light_directions: Float64
    light_distances_m: Float64
    radius_m: float
    lamps: NDArray[np.intp]

    def __post_init__(self) -> None:
        lights = len(self.light_directions)
        if self.radiance.ndim != 3 or self.radiance.shape != self.variance.shape or len(self.radiance) != lights:
            raise ImageError(f"{lights} lights, radiance {self.radiance.shape}, variance {self.variance.shape}")
        if self.light_distances_m.shape != (lights,) or self.lamps.shape != (lights,):
            raise ImageError(f"{lights} lights, distances {self.light_distances_m.shape}, lamps {self.lamps.shape}")

    @property
    def light_distances(self) -> Float64:
        """Distances of the lights in radii of the body."""
        return np.asarray(self.light_distances_m / self.radius_m, np.float64)

    def sampled(self, points: Float64, channel: int) -> tuple[Float64, Float64]:
        """Mean radiance over points (place, sample, 2) of one channel's bilinear interpolation, and its variance.

        Both (light, place). NaN where any of the sites is, or lies outside of the image.
        """
        height, width = self.radiance.shape[1:]
        mean, whole = _interpolation(points, self.cfa, channel, (height, width))
        square = mean.multiply(mean).tocsr()
        value = np.stack([mean @ mosaic.ravel() for mosaic in self.radiance])
        variance = np.stack([square @ mosaic.ravel() for mosaic in self.variance])
        value[:, ~whole] = np.nan
        variance[np.isnan(value)] = np.nan
        return value, variance


def _interpolation(
    points: Float64, cfa: NDArray[np.uint8], channel: int, shape: tuple[int, int]
) -> tuple[csr_array, NDArray[np.bool_]]:
    """Matrix (place, pixel) of the mean over points (place, sample, 2) of the channel's bilinear interpolation.

    With it comes which places (place,) have all of their sites within the image.
    """
    sites = np.argwhere(cfa == channel)
    rows, columns, weights = [], [], []
    for site_row, site_column in sites:
        x, y = (points[..., 0] - site_column) / 2, (points[..., 1] - site_row) / 2
        left, top = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
        fx, fy = x - left, y - top
        for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
            rows.append(2 * (top + down) + site_row)
            columns.append(2 * (left + right) + site_column)
            weights.append((fy if down else 1 - fy) * (fx if right else 1 - fx))
    row, column, weight = np.stack(rows), np.stack(columns), np.stack(weights) / (len(sites) * points.shape[1])
    inside = (row >= 0) & (column >= 0) & (row < shape[0]) & (column < shape[1])
    whole = (inside | (weight == 0)).all(axis=(0, 2))
    use = inside & (weight > 0)
    place = np.broadcast_to(np.arange(len(points))[:, None], row.shape)[use]
    entries = (weight[use], (place, (row * shape[1] + column)[use]))
    return coo_array(entries, shape=(len(points), shape[0] * shape[1])).tocsr(), whole
