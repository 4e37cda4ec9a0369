"""Directions of lights from their highlights on a chrome sphere."""

from collections.abc import Sequence
from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from processing.errors import ImageError
from processing.materials.limb import SphereImage
from processing.products.arrays import Float64

_BRIGHT = 0.9  # of the brightest pixel: what belongs to the highlight and not to the streaks of a scratched sphere
_LEAST_RISE = 3.0  # of the highlight over what nine tenths of the sphere are darker than


def sphere_of_mask(mask: NDArray[np.bool_]) -> SphereImage:
    """Circle of the mask (y, x) of a whole sphere: the disc of its area about its centroid.

    Its deviations are those of pixels that each decide whether they are in: one in sqrt(12) of a pixel along the edge.
    Raises ImageError where the mask is empty or no disc.
    """
    rows, columns = np.nonzero(mask)
    if len(rows) == 0:
        raise ImageError("the mask of the sphere is empty; expected a picture that is white where the sphere is")
    centre = np.array([columns.mean(), rows.mean()])
    radius = sqrt(len(rows) / pi)
    beyond = np.hypot(*(np.stack([columns, rows]) - centre[:, None])) > radius + 1.5
    if beyond.mean() > 0.01:
        raise ImageError(f"the mask is no disc: {beyond.mean():.0%} of it lies outside the circle of its area")
    edge = np.argwhere(mask & ~ndimage.binary_erosion(mask))[:, ::-1].astype(np.float64)
    covariance = np.diag([2.0, 2.0, 1.0]) / 12 / len(edge)
    return SphereImage(centre, radius, covariance, edge)


def light_directions(images: NDArray[np.floating], sphere: SphereImage, names: Sequence[str] = ()) -> Float64:
    """Unit vectors (light, 3) toward distant lights, in the view frame, from images (light, y, x) of a chrome sphere.

    The highlight is the largest bright region, its place the centroid of its light, saturated or not. There the
    sphere's normal n halves the angle to the camera, which sees along -z from far away: L = 2 n_z n - z.
    Raises ImageError, with the image's name, where one shows no highlight, or a light behind the sphere.
    """
    names = names or [f"image {number}" for number in range(1, len(images) + 1)]
    return np.stack([_direction(image, sphere, name) for image, name in zip(images, names, strict=True)])


def _direction(image: NDArray[np.floating], sphere: SphereImage, name: str) -> Float64:
    across, along = (highlight_px(image, sphere, name) - sphere.centre_px) / sphere.radius_px
    normal = np.array([across, -along, np.sqrt(max(1 - across**2 - along**2, 0.0))])
    light = np.asarray(2 * normal[2] * normal - np.array([0.0, 0.0, 1.0]), np.float64)
    if light[2] <= 0:
        raise ImageError(f"{name}: the light that the chrome sphere shows lies behind the picture")
    return light


def highlight_px(image: NDArray[np.floating], sphere: SphereImage, name: str) -> Float64:
    """Column and row of the highlight of an image, whose `name` errors tell."""
    row, column = np.ogrid[: image.shape[0], : image.shape[1]]
    inside = np.hypot(column - sphere.centre_px[0], row - sphere.centre_px[1]) < sphere.radius_px
    value = np.where(inside & np.isfinite(image), image, 0.0).astype(np.float64)
    regions, count = ndimage.label(value > _BRIGHT * value.max())
    if count == 0 or value.max() < _LEAST_RISE * np.percentile(value[inside], 90):
        raise ImageError(f"{name}: the chrome sphere shows no highlight that stands out")
    largest = 1 + int(np.argmax(np.bincount(regions.ravel())[1:]))
    return np.array(ndimage.center_of_mass(value, regions, largest))[::-1]
