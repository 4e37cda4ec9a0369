"""The image circle of a fish-eye photograph, and the lens that it belongs to."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from processing.cameras.lens import Fisheye
from processing.errors import ImageError
from processing.products.arrays import Float64
from processing.robust import biweight, bulk_deviation

_RAYS = 720
_CORNER = 0.05  # of the picture's sides: what lies there is outside of the circle
_LIT = 0.05  # of the light in the middle: more is inside
_INSIDE_PX, _OUTSIDE_PX = (3.0, 8.0), (3.0, 8.0)  # where the levels on both sides of the rim are taken
_TRIPLES, _NEAR = 300, 0.01
_ROUNDS = 12
_ENOUGH = 0.4  # of the rays must agree


class CircleStatus(IntEnum):
    """Whether a photograph shows its image circle."""

    FOUND = 0
    CUT = 1  # a part of it lies outside of the picture; found by the rest
    NOT_FOUND = 2  # no circle that enough of the rim agrees on


@dataclass(frozen=True, slots=True)
class ImageCircle:
    """`centre_px` (2,) (column, row), `radius_px`, their standard deviation, and the share of the rim that agrees."""

    centre_px: Float64
    radius_px: float
    sigma_px: float
    agreeing: float
    status: CircleStatus

    def check(self) -> None:
        """Raises ImageError where no circle was found."""
        if self.status is CircleStatus.NOT_FOUND:
            raise ImageError(
                f"no image circle: {self.agreeing:.0%} of the rim agrees on one. Is it a circular fish-eye photograph, "
                "not cropped, of a place that is not dark all around? Or give the lens."
            )


def equidistant(circle: ImageCircle, field_rad: float) -> Fisheye:
    """The lens of which the angle from the axis is in proportion to the distance from the circle's centre.

    Raises ImageError for fields that no lens has.
    """
    if not 0 < field_rad < 2 * np.pi:
        raise ImageError(f"a field of view of {np.degrees(field_rad):g} deg; that of a fish-eye is 150 to 250 deg.")
    focal_px = circle.radius_px / (field_rad / 2)
    u, v = circle.centre_px
    return Fisheye(np.array([[focal_px, 0, u], [0, focal_px, v], [0, 0, 1]]), np.zeros(4))


def find_circle(luminance: NDArray[np.floating]) -> ImageCircle:
    """The image circle of a linear picture (h, w), by the outermost light along rays from its middle.

    Dark places at the rim and glints outside of it are left out: circles through three points of the rim, the one that
    most agree with, then least squares with Tukey's weights on the places of half the light just inside.
    """
    picture = np.nan_to_num(np.asarray(luminance, np.float64), nan=0.0, posinf=0.0)
    outside = _outside(picture)
    middle = np.array(picture.shape[::-1]) / 2 - 0.5
    level = outside + _LIT * (float(np.percentile(picture, 80)) - outside)
    lit = picture > level
    if not level > outside or not lit.any():
        return ImageCircle(middle, 0.0, np.inf, 0.0, CircleStatus.NOT_FOUND)
    start = np.array([np.median(np.nonzero(lit.any(axis=i))[0]) for i in (0, 1)])
    points = _outermost(picture, start, level)
    if len(points) < 0.2 * _RAYS:
        return ImageCircle(middle, 0.0, np.inf, 0.0, CircleStatus.NOT_FOUND)
    rough = _most_agreed(points, min(picture.shape))
    edge = _half_level(picture, rough, outside)
    if len(edge) < 0.2 * _RAYS:
        return ImageCircle(middle, 0.0, np.inf, len(edge) / _RAYS, CircleStatus.NOT_FOUND)
    return _fitted(edge, rough, picture.shape)


def _outside(picture: Float64) -> float:
    """Light outside of the circle: the darkest corner's median."""
    height, width = (max(int(_CORNER * size), 2) for size in picture.shape)
    corners = (
        picture[:height, :width],
        picture[:height, -width:],
        picture[-height:, :width],
        picture[-height:, -width:],
    )
    return min(float(np.median(corner)) for corner in corners)


def _along(picture: Float64, centre: Float64, radii: Float64) -> tuple[Float64, Float64]:
    """Values (rays, radii) around a centre, NaN beyond the picture, and the rays' directions (rays, 2)."""
    angle = 2 * np.pi * np.arange(_RAYS) / _RAYS
    toward = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    uv = centre + radii[..., None] * toward[:, None]
    return map_coordinates(picture, [uv[..., 1], uv[..., 0]], order=1, cval=np.nan), toward


def _outermost(picture: Float64, centre: Float64, level: float) -> Float64:
    radii = np.arange(0.0, np.hypot(*picture.shape), 1.0)
    values, toward = _along(picture, centre, radii[None])
    bright = values > level
    last = len(radii) - 1 - bright[:, ::-1].argmax(axis=1)
    # Light up to the picture's border says nothing of the rim.
    known = bright.any(axis=1) & ~np.isnan(values[np.arange(_RAYS), np.minimum(last + 2, len(radii) - 1)])
    return np.asarray(centre + radii[last[known], None] * toward[known])


def _most_agreed(points: Float64, side_px: int) -> tuple[Float64, float]:
    rng = np.random.default_rng(0)
    best, most = (points.mean(axis=0), 1.0), -1
    for _ in range(_TRIPLES):
        centre, radius = _least_squares(points[rng.choice(len(points), 3, replace=False)], np.ones(3))
        near = np.abs(np.linalg.norm(points - centre, axis=1) - radius) < _NEAR * side_px
        if near.sum() > most and radius < side_px:
            best, most = (centre, radius), int(near.sum())
    return best


def _least_squares(points: Float64, weights: Float64) -> tuple[Float64, float]:
    """Centre and radius by Kasa's linear form."""
    root = np.sqrt(weights)
    design = np.column_stack([2 * points, np.ones(len(points))]) * root[:, None]
    solved = np.linalg.lstsq(design, root * (points**2).sum(axis=1), rcond=None)[0]
    return solved[:2], float(np.sqrt(max(solved[2] + (solved[:2] ** 2).sum(), 0.0)))


def _half_level(picture: Float64, rough: tuple[Float64, float], outside: float) -> Float64:
    """Where the light falls to half of what it is just inside, near a rough circle; rays without a fall are out."""
    centre, radius = rough
    near = np.arange(-12.0, 12.0, 0.25)
    values, toward = _along(picture, centre, (radius + near)[None])
    inner = np.median(values[:, (near > -_INSIDE_PX[1]) & (near < -_INSIDE_PX[0])], axis=1)
    outer = np.median(values[:, (near > _OUTSIDE_PX[0]) & (near < _OUTSIDE_PX[1])], axis=1)
    half = 0.5 * (np.nan_to_num(inner) + outside)
    above = values > half[:, None]
    last = len(near) - 1 - above[:, ::-1].argmax(axis=1)
    row, following = np.arange(_RAYS), np.minimum(last + 1, len(near) - 1)
    drop = values[row, last] - values[row, following]
    part = np.divide(values[row, last] - half, drop, out=np.zeros(_RAYS), where=drop > 0)
    sharp = (
        above.any(axis=1) & (last < len(near) - 1) & (outer < outside + 0.2 * (inner - outside)) & np.isfinite(outer)
    )
    return np.asarray((centre + (radius + near[last] + 0.25 * part)[:, None] * toward)[sharp])


def _fitted(points: Float64, rough: tuple[Float64, float], shape: tuple[int, ...]) -> ImageCircle:
    centre, radius = rough
    weights = np.ones(len(points))
    for _ in range(_ROUNDS):
        away = np.linalg.norm(points - centre, axis=1) - radius
        sigma = max(bulk_deviation(away), 0.05)
        weights = biweight(away, sigma)
        if weights.sum() < 10:
            break
        centre, radius = _least_squares(points, weights)
    away = np.linalg.norm(points - centre, axis=1) - radius
    agreeing = float(np.count_nonzero(np.abs(away) < max(0.01 * radius, 1.0)) / _RAYS)
    sigma_px = float(bulk_deviation(away) * np.sqrt(2 / max(weights.sum(), 1.0)))
    low, high = centre - radius, centre + radius
    whole = (low > -0.5).all() and (high < np.array(shape[1::-1]) - 0.5).all()
    status = CircleStatus.FOUND if whole else CircleStatus.CUT
    return ImageCircle(centre, radius, sigma_px, agreeing, status if agreeing >= _ENOUGH else CircleStatus.NOT_FOUND)
