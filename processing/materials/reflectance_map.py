"""From photographs of a sphere to reflectance maps over gradient space."""

import numpy as np

from processing.materials.photographs import BodyPhotographs
from processing.materials.sight import Sight
from processing.products import Provenance, ReflectanceMaps, normals_of, sphere_normals
from processing.products.arrays import Float64
from processing.products.directions import falloff


def reflectance_maps(
    photographs: BodyPhotographs,
    sight: Sight,
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
    shape = (len(photographs.radiance), size, size, 3)
    value, variance = np.empty(shape, np.float32), np.empty(shape, np.float32)
    points = _texel_points(sight, size)
    lights = zip(photographs.light_directions, photographs.light_distances, strict=True)
    closeness = np.stack([falloff(sphere_normals(size), direction, distance) for direction, distance in lights])
    for channel in range(3):
        radiance, noise = photographs.sampled(points, channel)
        scale = irradiance[:, channel, None, None] * closeness
        value[..., channel] = radiance.reshape(shape[:3]) / scale
        variance[..., channel] = noise.reshape(shape[:3]) / scale**2
    return ReflectanceMaps(
        value,
        variance,
        np.asarray(photographs.light_directions, np.float64),
        photographs.light_distances,
        sight.view_distance,
        provenance or Provenance(),
    )


def _texel_points(sight: Sight, size: int) -> Float64:
    """Image points (texel, sample, 2) that divide each texel evenly, no farther apart than sites of one channel."""
    middle = sight.image_points(np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    spacing_px = 1.05 * float(np.linalg.norm(middle[1] - middle[0])) / size  # nearer than the limb it is magnified
    samples = max(int(np.ceil(spacing_px / 2)), 1)
    fine = (np.arange(size * samples) + 0.5) * (2 / (size * samples)) - 1
    p, q = np.meshgrid(fine, fine)
    points = sight.image_points(normals_of(p, q))
    blocks = points.reshape(size, samples, size, samples, 2).swapaxes(1, 2)
    return blocks.reshape(size * size, samples * samples, 2)
