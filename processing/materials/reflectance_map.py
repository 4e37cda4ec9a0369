"""From photographs of a sphere to reflectance maps over gradient space.

Frames are those of `products.sphere`: x along the image's columns, y down its rows, z from the camera to the sphere's
centre. Distances are from that centre.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from processing.errors import ImageError
from processing.materials.limb import SphereImage
from processing.products import Provenance, ReflectanceMaps, normals_of, sphere_normals
from processing.products.arrays import Float64

_CARD_MARGIN = 0.12  # share of the card's sides that is left out, for its blurred edge
_LEAST_LIT_SHARE = 0.25
_PENUMBRA = 1.02  # in sphere radii


@dataclass(frozen=True, eq=False)
class SpherePhotographs:
    """Merged photographs of a sphere, one per light, and where everything stands.

    `radiance` and its `variance` are mosaics (light, row, column) in any one unit, NaN where nothing was measured;
    `cfa` (2, 2) tells channel 0, 1 or 2 of each site. `light_directions` (light, 3) are unit vectors away from the
    sphere's centre; a distance may be infinite.
    """

    radiance: NDArray[np.floating]
    variance: NDArray[np.floating]
    cfa: NDArray[np.uint8]
    light_directions: Float64
    light_distances_m: Float64
    view_distance_m: float
    radius_m: float

    def __post_init__(self) -> None:
        lights = len(self.light_directions)
        if self.radiance.ndim != 3 or self.radiance.shape != self.variance.shape or len(self.radiance) != lights:
            raise ImageError(f"{lights} lights, radiance {self.radiance.shape}, variance {self.variance.shape}")

    @property
    def light_distances(self) -> Float64:
        """Distances of the lights in sphere radii."""
        return np.asarray(self.light_distances_m / self.radius_m, np.float64)

    @property
    def view_distance(self) -> float:
        """Distance of the camera in sphere radii."""
        return self.view_distance_m / self.radius_m


@dataclass(frozen=True, slots=True)
class WhiteCard:
    """A matt white card in the plane through the sphere's centre that faces the camera.

    Its centre lies `right_m` along the image's columns and `up_m` against its rows from the sphere's centre;
    `reflectance` is the share of light that it returns.
    """

    right_m: float
    up_m: float
    width_m: float
    height_m: float
    reflectance: float


def image_points(normal: Float64, sphere: SphereImage, view_distance: float) -> Float64:
    """Image points (..., 2) as column, row of the sphere's points with these normals (..., 3).

    Under orthographic projection (infinite distance) they are r (n_x, n_y) from the centre, the paper's eq. 1. From D
    radii away the limb is the cone that touches the sphere, of radius r = f / sqrt(D^2 - 1), and a point at depth
    D - |n_z| lies nearer than the limb's: r (n_x, n_y) sqrt(D^2 - 1) / (D - |n_z|).
    """
    if np.isinf(view_distance):
        return np.asarray(sphere.centre_px + sphere.radius_px * normal[..., :2], np.float64)
    magnified = np.sqrt(view_distance**2 - 1) / (view_distance + normal[..., 2:])
    return np.asarray(sphere.centre_px + sphere.radius_px * normal[..., :2] * magnified, np.float64)


def reflectance_maps(
    photographs: SpherePhotographs,
    sphere: SphereImage,
    irradiance: Float64,
    size: int = 256,
    provenance: Provenance | None = None,
) -> ReflectanceMaps:
    """R(p, q) on size x size texels over p, q in [-1, 1], in one resampling from the mosaics.

    `irradiance` (light, 3) is that at normal incidence in the sphere's centre, as `card_irradiance` reads it; a lamp
    at a finite distance lights the nearer points more. Each texel is the mean over its area of the bilinear
    interpolation between sites of its channel, and has the variance of that mean; it is NaN where any of these sites
    is, or lies outside the image. Neighbouring texels share sites.
    """
    lights, height, width = photographs.radiance.shape
    shape = (lights, size, size, 3)
    value, variance = np.empty(shape, np.float32), np.empty(shape, np.float32)
    points = _texel_points(sphere, photographs.view_distance, size)
    closeness = _closeness(photographs, size)
    for channel in range(3):
        mean, whole = _interpolation(points, photographs.cfa, channel, (height, width))
        square = mean.multiply(mean).tocsr()
        for light in range(lights):
            scale = irradiance[light, channel] * closeness[light]
            radiance = np.where(whole, mean @ photographs.radiance[light].ravel(), np.nan)
            value[light, ..., channel] = radiance.reshape(size, size) / scale
            noise = (square @ photographs.variance[light].ravel()).reshape(size, size)
            variance[light, ..., channel] = noise / scale**2
    variance[np.isnan(value)] = np.nan
    return ReflectanceMaps(
        value,
        variance,
        np.asarray(photographs.light_directions, np.float64),
        photographs.light_distances,
        photographs.view_distance,
        provenance or Provenance(),
    )


def card_irradiance(photographs: SpherePhotographs, sphere: SphereImage, card: WhiteCard) -> Float64:
    """Irradiance (light, 3) at normal incidence in the sphere's centre, read from the white card under each light.

    E = pi L / (reflectance cos theta), times the ratio of the squared distances; pixels in the sphere's shadow are
    left out by geometry. A light that the sphere keeps from most of the card gets the mean of the others: one lamp on
    an arm is the same lamp everywhere. Raises ImageError where no light reaches the card, or the card is not seen.
    """
    points, rows, columns = _card_pixels(photographs, sphere, card)
    channel = photographs.cfa[rows % 2, columns % 2]
    reading = np.full((len(photographs.radiance), 3), np.nan)
    for light, mosaic in enumerate(photographs.radiance):
        cosine, closeness, lit = _card_light(photographs, light, points)
        if lit.mean() < _LEAST_LIT_SHARE:
            continue
        factor = np.pi / (card.reflectance * np.where(lit, cosine, 1.0) * closeness)
        for c in range(3):
            values = (mosaic[rows, columns] * factor)[lit & (channel == c)]
            reading[light, c] = np.nanmean(values) if np.isfinite(values).any() else np.nan
    seen = np.isfinite(reading).all(axis=1)
    if not seen.any() or not (reading[seen] > 0).all():
        raise ImageError("the white card is dark, saturated or shadowed under every light; check where it stands")
    return np.where(seen[:, None], reading, reading[seen].mean(axis=0))


def _card_pixels(
    photographs: SpherePhotographs, sphere: SphereImage, card: WhiteCard
) -> tuple[Float64, NDArray[np.intp], NDArray[np.intp]]:
    """Points (n, 3) on the card in sphere radii, and the rows and columns of the pixels that see them."""
    distance = photographs.view_distance
    shrink = 1.0 if np.isinf(distance) else float(np.sqrt(distance**2 - 1)) / distance
    px_per_m = sphere.radius_px * shrink / photographs.radius_m
    centre = sphere.centre_px + px_per_m * np.array([card.right_m, -card.up_m])
    half = px_per_m * (0.5 - _CARD_MARGIN) * np.array([card.width_m, card.height_m])
    low, high = np.ceil(centre - half).astype(int), np.floor(centre + half).astype(int)
    height, width = photographs.radiance.shape[1:]
    if (high - low < 2).any() or (low < 0).any() or high[0] >= width or high[1] >= height:
        raise ImageError(f"the white card would cover columns {low[0]} to {high[0]}, rows {low[1]} to {high[1]}")
    rows, columns = (axis.ravel() for axis in np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1])
    from_centre = (np.stack([columns, rows], axis=1) - sphere.centre_px) / (px_per_m * photographs.radius_m)
    return np.column_stack([from_centre, np.zeros(len(rows))]), rows, columns


def _card_light(
    photographs: SpherePhotographs, light: int, points: Float64
) -> tuple[Float64, Float64, NDArray[np.bool_]]:
    """Cosine of incidence, squared ratio of the centre's distance to the point's, and whether the light gets there."""
    direction, distance = photographs.light_directions[light], photographs.light_distances[light]
    if np.isinf(distance):
        toward, closeness = np.broadcast_to(direction, points.shape), np.ones(len(points))
    else:
        way = direction * distance - points
        closeness = distance**2 / (way * way).sum(axis=1)
        toward = way / np.linalg.norm(way, axis=1, keepdims=True)
    along = (points * toward).sum(axis=1)
    past = np.sqrt(np.maximum((points * points).sum(axis=1) - along**2, 0.0))
    shadowed = (along < 0) & (past < _PENUMBRA)
    cosine = -toward[:, 2]
    return cosine, closeness, ~shadowed & (cosine > 0.05)


def _closeness(photographs: SpherePhotographs, size: int) -> Float64:
    """Squared ratio of the centre's distance from each light to that of each texel's point, (light, q, p)."""
    normal = sphere_normals(size)
    ratios = np.ones((len(photographs.light_directions), size, size))
    for light, distance in enumerate(photographs.light_distances):
        if np.isfinite(distance):
            way = photographs.light_directions[light] * distance - normal
            ratios[light] = distance**2 / (way * way).sum(axis=-1)
    return ratios


def _texel_points(sphere: SphereImage, view_distance: float, size: int) -> Float64:
    """Image points (texel, sample, 2) that divide each texel evenly, no farther apart than sites of one channel."""
    spacing_px = 2.1 * sphere.radius_px / size
    samples = max(int(np.ceil(spacing_px / 2)), 1)
    fine = (np.arange(size * samples) + 0.5) * (2 / (size * samples)) - 1
    p, q = np.meshgrid(fine, fine)
    points = image_points(normals_of(p, q), sphere, view_distance)
    blocks = points.reshape(size, samples, size, samples, 2).swapaxes(1, 2)
    return blocks.reshape(size * size, samples * samples, 2)


def _interpolation(
    points: Float64, cfa: NDArray[np.uint8], channel: int, shape: tuple[int, int]
) -> tuple[csr_array, NDArray[np.bool_]]:
    """Matrix (texel, pixel) of the mean over points (texel, sample, 2) of the channel's bilinear interpolation.

    With it comes which texels (texel,) have all of their sites within the image.
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
    texel = np.broadcast_to(np.arange(len(points))[:, None], row.shape)[use]
    entries = (weight[use], (texel, (row * shape[1] + column)[use]))
    return coo_array(entries, shape=(len(points), shape[0] * shape[1])).tocsr(), whole
