"""Light directions from one sphere in one picture: by the shading of a matt one, or the highlight of a polished one.

For lamps that no carrier turns, and for pictures of others: the light is far away and so is the camera, all in the
camera's frame (x right, y down, z away from it), where the visible normals of a sphere with the outline (centre, r)
are n = ((u - u0) / r, (v - v0) / r, -sqrt(1 - ...)) and the view is (0, 0, -1).
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from processing.errors import ImageError
from processing.robust import biweight, bulk_deviation

Array = NDArray[np.float64]
_VIEW = np.array([0.0, 0.0, -1.0])
_ATTACHED = 0.1  # cosine of incidence under which a point counts as shadow's neighbour: terminators are soft
_LEAST_POINTS = 12
_LEAST_LIGHT = 3.0  # of the light vector over its own deviation
_ROUNDS = 40
_CORE = 0.98  # of the peak over the rest, for what belongs to a highlight: below it is halo and flare


class ShadingStatus(IntEnum):
    """What the shading of a sphere tells."""

    OK = 0
    TOO_FEW_POINTS = 1  # too few lit points, or all on one line
    NO_LIGHT = 2  # nothing over the noise
    NOT_SETTLED = 3  # which points are lit kept changing


@dataclass(frozen=True, eq=False)
class ShadingFit:
    """A unit `direction` (3,) away from the sphere, and the `strength` of the light: radiance where it falls in square.

    `covariance` (3, 3) is that of the direction; `lit` (n,) tells the points it rests on. NaN where `status` says why.
    """

    direction: Array
    strength: float
    covariance: Array
    lit: NDArray[np.bool_]
    status: ShadingStatus


def sphere_normals_seen(centre_px: Array, radius_px: float, shape: tuple[int, int]) -> Array:
    """Normals (h, w, 3) of a sphere in a distant camera's image, NaN outside of its outline."""
    rows, columns = np.indices(shape)
    x, y = (columns - centre_px[0]) / radius_px, (rows - centre_px[1]) / radius_px
    with np.errstate(invalid="ignore"):
        toward = -np.sqrt(1 - x * x - y * y)
    return np.where(np.isfinite(toward)[..., None], np.stack([x, y, toward], axis=-1), np.nan)


def direction_from_shading(radiance: Array, variance: Array, normals: Array) -> ShadingFit:
    """The light on matt points (n,) with unit normals (n, 3), by robust least squares of radiance = normal . light.

    Points that the light does not reach are left out: attached shadow is where the fit itself has the normals turn
    away. What else does not follow the cosine (highlights, cast shadow, dirt) loses its weight (Tukey's biweight).
    Values that are not finite take no part. The covariance counts residuals beyond the noise.
    """
    known = np.isfinite(radiance) & np.isfinite(variance) & (variance > 0) & np.isfinite(normals).all(axis=1)
    lit = known & (radiance > np.percentile(radiance[known], 50) if known.any() else known)
    fit = np.zeros(3)
    status = ShadingStatus.NOT_SETTLED
    weight = np.where(known, 1 / np.where(known, variance, 1.0), 0.0)
    trust = np.ones(len(radiance))
    for _ in range(_ROUNDS):
        if not _determined(normals[lit]):
            return _nothing(lit, ShadingStatus.TOO_FEW_POINTS)
        before, points = fit, normals[lit]
        share = weight[lit] * trust[lit]
        normal = (points * share[:, None]).T @ points
        fit = np.asarray(
            np.linalg.lstsq(normal, (points * share[:, None]).T @ radiance[lit], rcond=None)[0], np.float64
        )
        left = np.where(known, radiance - np.where(known[:, None], normals, 0.0) @ fit, 0.0) * np.sqrt(weight)
        trust = biweight(left, max(bulk_deviation(left[lit]), 1.0))
        length = float(np.linalg.norm(fit))
        lit = known & (np.where(known[:, None], normals, 0.0) @ fit > _ATTACHED * length)
        if np.linalg.norm(fit - before) <= 1e-7 * length:
            status = ShadingStatus.OK
            break
    excess = float(np.sum(trust[lit] * left[lit] ** 2)) / max(int(np.count_nonzero(lit)) - 3, 1)
    covariance = np.linalg.pinv(normal, hermitian=True) * max(excess, 1.0)
    if not length > _LEAST_LIGHT * np.sqrt(np.trace(covariance)):
        return _nothing(lit, ShadingStatus.NO_LIGHT)
    across = np.eye(3) - np.outer(fit, fit) / length**2
    return ShadingFit(fit / length, length, across @ covariance @ across / length**2, lit, status)


def _determined(normals: Array) -> bool:
    if len(normals) < _LEAST_POINTS:
        return False
    values = np.linalg.svd(normals, compute_uv=False)
    return bool(values[-1] > 1e-3 * values[0])


def _nothing(lit: NDArray[np.bool_], status: ShadingStatus) -> ShadingFit:
    return ShadingFit(np.full(3, np.nan), float("nan"), np.full((3, 3), np.nan), lit, status)


def direction_from_highlight(uv_px: Array, centre_px: Array, radius_px: float) -> Array:
    """Unit direction (3,) to the light whose highlight lies at an image point of a polished sphere.

    Raises ImageError where the point is not on the sphere.
    """
    x, y = (uv_px - centre_px) / radius_px
    square = 1 - x * x - y * y
    if not square >= 0:
        raise ImageError(f"the highlight at {np.round(uv_px, 1).tolist()} is not on the sphere's image.")
    normal = np.array([x, y, -np.sqrt(square)])
    return np.asarray(2 * (normal @ _VIEW) * normal - _VIEW, np.float64)


def highlight_centre(image: NDArray[np.floating], centre_px: Array, radius_px: float) -> Array:
    """Centre (column, row) of the highlight within a polished sphere's outline in a picture (h, w).

    For pictures whose highlights cover many pixels and are saturated: the median column and row of the brightest
    region's core, which flare to one side moves less than a centroid. Raises ImageError where there is none.
    """
    rows, columns = np.ogrid[: image.shape[0], : image.shape[1]]
    inside = np.hypot(columns - float(centre_px[0]), rows - float(centre_px[1])) < radius_px
    value = np.where(inside & np.isfinite(image), image, -np.inf).astype(np.float64)
    known = value[np.isfinite(value)]
    if known.size == 0 or not known.max() > np.median(known):
        raise ImageError("no highlight: the sphere's image is even, or not there.")
    middle = float(np.median(known))
    regions, _ = ndimage.label(value > middle + _CORE * (float(known.max()) - middle))
    largest = 1 + int(np.argmax(np.bincount(regions.ravel())[1:]))
    row, column = np.nonzero(regions == largest)
    return np.array([np.median(column), np.median(row)])
