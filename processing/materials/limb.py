"""The image of a sphere: centre and radius from its limb, over several lights.

Each light shows only the part of the limb that faces it, and next to the terminator the sphere fades out before it
ends. So the lights are joined first, each pixel by the one that shows it best; then the limb is sought ray by ray, from
the dark outside inward, and a circle is fitted to it robustly. `limb_profile` tells from all rays together how far the
sphere reaches beyond it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from processing.errors import ImageError
from processing.materials.limb_profile import DEPTHS_PX, limb_depth_px, mean_profile
from processing.products.arrays import Float64
from processing.robust import biweight, bulk_deviation

_STEP_PX = 0.25  # between the samples of a ray
_PLATEAU_PX = (0.5, 2.0)  # how far inside the limb its own brightness is read
_WINDOWS_PX = (10.0, 6.0, 6.0, 6.0)  # half width of the search, from round to round
_RAYS = (240, 1440)
_LEAST_RAYS = 24
_LEAST_NOISES = 10.0  # brightness of a limb over the noise of the background
_ROUNDS = 20
_LEAST_SCALE_PX = 0.02  # of limb points about the circle
_LEAST_SHARE = 0.05  # and over the median brightness of the limb


@dataclass(frozen=True, eq=False)
class SphereImage:
    """The circle that bounds a sphere in an image.

    `centre_px` (column, row) and `radius_px`; `covariance_px2` (3, 3) orders column, row, radius. `limb_px` (n, 2) are
    the points of the limb that hold it.
    """

    centre_px: Float64
    radius_px: float
    covariance_px2: Float64
    limb_px: Float64

    @property
    def sigma_px(self) -> Float64:
        """Standard deviations of column, row and radius, (3,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance_px2)), np.float64)


def find_sphere(images: NDArray[np.floating]) -> SphereImage:
    """Fit the limb of a sphere before a dark background in linear images (light, row, column); NaN = not measured.

    The sphere is the largest bright region; a card or a holder beside it does not disturb, nor does a sphere that the
    image's border cuts, as long as a third of its limb is seen. The limb of a sphere off the optical axis is taken for
    a circle, which holds to 0.1 % within 2.5 deg.
    Raises ImageError where there is no such region or too little of its limb is lit.
    """
    if images.ndim != 3 or 0 in images.shape:
        raise ImageError(f"expected images as light, row, column; got an array of shape {images.shape}")
    missing = ~np.isfinite(images)
    known = np.where(missing, 0.0, images)
    level = np.percentile(known, 99, axis=(1, 2), keepdims=True)
    scaled = np.divide(known, level, out=np.zeros(images.shape), where=level > 0)
    brightest = np.where(missing.any(axis=0), np.nan, scaled.max(axis=0))
    circle = _rough_circle(scaled.sum(axis=0))
    for window_px in _WINDOWS_PX:
        sphere = _fit_circle(circle, *_limb_points(brightest, circle, window_px))
        circle = np.array([*sphere.centre_px, sphere.radius_px])
    return _at_the_limb(sphere, np.where(missing, np.nan, scaled))


def _at_the_limb(sphere: SphereImage, images: Float64) -> SphereImage:
    """The circle where the sphere ends, from the one where it has half of its brightness; that one where none tells."""
    outward = sphere.limb_px - sphere.centre_px
    outward = outward / np.linalg.norm(outward, axis=1, keepdims=True)
    points = sphere.centre_px + outward[:, None] * (sphere.radius_px - DEPTHS_PX)[:, None]
    profile = mean_profile(np.stack([_sample(image, points[..., 0], points[..., 1]) for image in images]))
    depth_px, sigma_px = (np.nan, np.nan) if profile is None else limb_depth_px(profile)
    if np.isnan(depth_px):
        return sphere
    covariance = sphere.covariance_px2 + np.diag([0.0, 0.0, sigma_px**2])
    limb_px = sphere.limb_px - depth_px * outward
    return SphereImage(sphere.centre_px, sphere.radius_px - depth_px, covariance, limb_px)


def _rough_circle(image: Float64) -> Float64:
    """Column, row and radius of the largest bright region, to a percent or two."""
    smooth = ndimage.gaussian_filter(image, 1.5)
    dark, bright = np.percentile(smooth, (5, 99))
    regions, count = ndimage.label(smooth > dark + 0.06 * (bright - dark))
    if bright <= dark or count == 0:
        raise ImageError("no sphere found: the images are uniform; is the lamp on and the exposure long enough?")
    largest = 1 + int(np.argmax(np.bincount(regions.ravel())[1:]))
    region = ndimage.binary_fill_holes(regions == largest)
    edge = region & ~ndimage.binary_erosion(region, border_value=1)
    row, column = np.nonzero(edge)
    if len(row) < _LEAST_RAYS:
        raise ImageError(f"no sphere found: the largest bright region has an edge of {len(row)} pixels")
    return _consensus_circle(np.stack([column, row], axis=1).astype(np.float64))


def _consensus_circle(points: Float64) -> Float64:
    """The circle through three edge points that the most others lie on; it must have a size that the region has."""
    rng = np.random.default_rng(0)
    largest = float(np.ptp(points, axis=0).max())
    triples = points[rng.integers(0, len(points), (600, 3))]
    circles = [circle for triple in triples if (circle := _through(triple)) is not None and circle[2] < 2 * largest]
    if not circles:
        raise ImageError("no sphere found: the edge of the largest bright region is straight")
    support = [np.count_nonzero(np.abs(np.hypot(*(points - c[:2]).T) - c[2]) < max(0.01 * c[2], 1.0)) for c in circles]
    return circles[int(np.argmax(support))]


def _through(points: Float64) -> Float64 | None:
    a, b, c = points
    matrix = 2 * np.stack([b - a, c - a])
    if abs(np.linalg.det(matrix)) < 1.0:
        return None
    centre = np.linalg.solve(matrix, [b @ b - a @ a, c @ c - a @ a])
    return np.array([*centre, np.hypot(*(a - centre))])


def _limb_points(image: Float64, circle: Float64, window_px: float) -> tuple[Float64, Float64]:
    """Angle and radius of the limb on each ray from the circle's centre that shows it."""
    rays = int(np.clip(np.pi * circle[2], *_RAYS))
    angle = np.asarray(np.arange(rays) * (2 * np.pi / rays), np.float64)
    radius = np.asarray(circle[2] + np.arange(-window_px, window_px, _STEP_PX), np.float64)
    column = circle[0] + radius * np.cos(angle)[:, None]
    row = circle[1] + radius * np.sin(angle)[:, None]
    found = _falls(_sample(image, column, row))
    use = np.flatnonzero(np.isfinite(found))
    return angle[use], radius[0] + found[use] * _STEP_PX


def _sample(image: Float64, column: Float64, row: Float64) -> Float64:
    """Bilinear values at these points, NaN outside."""
    height, width = image.shape
    inside = (column >= 0) & (row >= 0) & (column <= width - 1) & (row <= height - 1)
    left = np.clip(np.floor(column), 0, width - 2).astype(np.intp)
    top = np.clip(np.floor(row), 0, height - 2).astype(np.intp)
    x, y = column - left, row - top
    upper = image[top, left] * (1 - x) + image[top, left + 1] * x
    lower = image[top + 1, left] * (1 - x) + image[top + 1, left + 1] * x
    return np.where(inside, upper * (1 - y) + lower * y, np.nan)


def _falls(profiles: Float64) -> Float64:
    """Index, with its fraction, at which each profile (n, samples) falls to half of what it has just inside; or NaN.

    The outermost such place counts. Half of the limb's own brightness is where a blurred edge lies whatever its blur,
    and what the stone does further in has no part in it.
    """
    near, far = (round(distance / _STEP_PX) for distance in _PLATEAU_PX)
    outside = profiles[:, -2 * near :]
    if np.isnan(outside).all():
        return np.full(len(profiles), np.nan)
    dark = np.nanmedian(outside)
    noise = 1.4826 * np.nanmedian(np.abs(outside - dark))
    windows = np.lib.stride_tricks.sliding_window_view(profiles - dark, far - near, axis=1)
    plateau = windows.mean(axis=2)[:, : profiles.shape[1] - far]
    typical = float(np.median(plateau[np.isfinite(plateau)])) if np.isfinite(plateau).any() else 0.0
    lit = plateau > max(_LEAST_NOISES * noise, _LEAST_SHARE * typical)
    above = profiles[:, far:] - dark - plateau / 2
    crossing = lit[:, :-1] & (above[:, :-1] >= 0) & (above[:, 1:] < 0)
    last = crossing.shape[1] - 1 - np.argmax(crossing[:, ::-1], axis=1)
    ray = np.arange(len(profiles))
    before, after = above[ray, last], above[ray, last + 1]
    fraction = before / np.where(crossing.any(axis=1), before - after, 1.0)
    return np.where(crossing.any(axis=1), far + last + fraction, np.nan)


def _fit_circle(circle: Float64, angle: Float64, radius: Float64) -> SphereImage:
    """Robust circle through limb points given by rays from the centre of a circle close by."""
    spread = float(np.abs(np.mean(np.exp(1j * angle)))) if len(angle) else 1.0
    if len(angle) < _LEAST_RAYS or spread > 0.85:
        raise ImageError(f"no sphere found: only {len(angle)} rays around it show a lit limb; light more of it")
    design = np.stack([np.cos(angle), np.sin(angle), np.ones_like(angle)], axis=1)
    keep = np.ones_like(angle)
    for _ in range(_ROUNDS):
        weighted = design * keep[:, None]
        step = np.linalg.solve(weighted.T @ design, weighted.T @ radius)
        left = radius - design @ step
        keep = biweight(left, max(bulk_deviation(left), _LEAST_SCALE_PX))
    held = np.flatnonzero(keep)
    inverse = np.linalg.inv((design * keep[:, None]).T @ design)
    noise = float(keep @ left**2) / max(len(held) - 3, 1) * _correlation_length(left[held])
    limb_px = circle[:2] + (radius[:, None] * design[:, :2])[held]
    return SphereImage(circle[:2] + step[:2], float(step[2]), inverse * noise, limb_px)


def _correlation_length(left: Float64) -> float:
    """How many neighbouring rays carry one independent error: 1 + 2 sum of the positive autocorrelations."""
    total, square = 1.0, float(left @ left)
    for lag in range(1, min(len(left) // 4, 60)):
        correlation = float(left[lag:] @ left[:-lag]) / square if square > 0 else 0.0
        if correlation <= 0.05:
            break
        total += 2 * correlation
    return total
