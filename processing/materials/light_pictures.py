"""From photographs of a body of any shape to its pictures under every light, without the background."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from processing.errors import ImageError
from processing.materials.photographs import BodyPhotographs
from processing.materials.sight import CalibratedSight
from processing.materials.white_card import WhiteCard, card_irradiance
from processing.products import Provenance
from processing.products.arrays import Float64
from processing.products.light_stack import LightStack, plane_points

_LEAST_BRIGHTNESS = 0.03  # of the brightest percentile: what is darker under all lights together is background
_LEAST_NOISES = 5.0
_CARD_BORDER = -0.1  # share of the card's sides around it that is not searched for the body
_STACK_FROM_VIEW = np.array([1.0, -1.0, -1.0])  # y up and z toward the camera, from y down and z away from it


def light_stack(
    photographs: BodyPhotographs, sight: CalibratedSight, card: WhiteCard, provenance: Provenance | None = None
) -> LightStack:
    """Pictures of the plane through the body's centre that faces the camera, undistorted, at the camera's resolution.

    The body is the largest region that is bright under the lights together, without the white card; outside of it is
    NaN. The picture's middle is the body's centre in the rig (`sight.centre_m`). `photographs.radius_m` needs only to
    hold the body: the picture shows no more, and the card is read where a sphere about the body throws no shadow.
    Points nearer than the plane by h are seen by h / distance too far out; that is left as it is.
    Raises ImageError where there is no body or the card is not seen.
    """
    pixel = _pixel(sight)
    half = int(np.ceil(1 / pixel))
    grid = plane_points((2 * half + 1, 2 * half + 1), pixel) * _STACK_FROM_VIEW
    value, variance = _pictures(photographs, sight, grid)
    body = _body(value, variance, _card_region(grid, card, sight.radius_m))
    reach = float(np.linalg.norm(grid[body], axis=1).max())
    irradiance = card_irradiance(*_within(photographs, sight, reach), card)
    rows, columns = (_crop(body, axis) for axis in (0, 1))
    scale = irradiance[:, None, None]
    return LightStack(
        np.asarray(np.where(body[..., None], value / scale, np.nan)[:, rows, columns], np.float32),
        np.asarray(np.where(body[..., None], variance / scale**2, np.nan)[:, rows, columns], np.float32),
        photographs.light_directions * _STACK_FROM_VIEW,
        photographs.light_distances_m,
        pixel * sight.radius_m,
        provenance or Provenance(),
    )


def _pixel(sight: CalibratedSight) -> float:
    """How far apart on the plane, in radii, the camera's pixels are: what a step of one pixel is in the middle."""
    step = 1e-3
    points = step * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    seen_px = sight.image_points(points)
    if not np.isfinite(seen_px).all():
        raise ImageError("the calibrated camera does not see the middle of the rig; is it this camera's calibration?")
    return step / float(np.linalg.norm(seen_px[1] - seen_px[0]))


def _pictures(photographs: BodyPhotographs, sight: CalibratedSight, grid: Float64) -> tuple[Float64, Float64]:
    """Radiance (light, y, x, 3) of the plane's points (y, x, 3), and its variance."""
    shape = (len(photographs.radiance), *grid.shape[:2], 3)
    value, variance = np.empty(shape), np.empty(shape)
    points = sight.image_points(grid).reshape(-1, 1, 2)
    for channel in range(3):
        radiance, noise = photographs.sampled(points, channel)
        value[..., channel], variance[..., channel] = radiance.reshape(shape[:3]), noise.reshape(shape[:3])
    return value, variance


def _body(value: Float64, variance: Float64, card: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Where the body is (y, x): bright under the lights together, in one piece, without holes."""
    known = np.isfinite(value)
    total = np.where(known, value, 0.0).sum(axis=(0, 3))
    noise = np.sqrt(np.where(known, variance, 0.0).sum(axis=(0, 3)))
    searched = known.any(axis=(0, 3)) & ~card
    if not searched.any():
        raise ImageError("no body found: nothing was measured near the middle of the rig; is the sample mounted?")
    dark, bright = np.percentile(total[searched], (2, 99))
    found = searched & (total > dark + np.maximum(_LEAST_BRIGHTNESS * (bright - dark), _LEAST_NOISES * noise))
    pieces, count = ndimage.label(ndimage.binary_opening(found))
    if count == 0:
        raise ImageError("no body found: the pictures are uniform; is the sample mounted and the exposure long enough?")
    largest = 1 + int(np.argmax(np.bincount(pieces.ravel())[1:]))
    filled: NDArray[np.bool_] = ndimage.binary_fill_holes(pieces == largest)
    return filled


def _card_region(grid: Float64, card: WhiteCard, radius_m: float) -> NDArray[np.bool_]:
    corners = card.corners(radius_m, _CARD_BORDER)[:, :2]
    inside = (grid[..., :2] >= corners.min(axis=0)) & (grid[..., :2] <= corners.max(axis=0))
    return np.asarray(inside.all(axis=-1), np.bool_)


def _within(
    photographs: BodyPhotographs, sight: CalibratedSight, reach: float
) -> tuple[BodyPhotographs, CalibratedSight]:
    """The same with the radius that the body really has, given in radii."""
    radius_m = reach * sight.radius_m
    return replace(photographs, radius_m=radius_m), replace(sight, radius_m=radius_m)


def _crop(body: NDArray[np.bool_], axis: int) -> slice:
    """What of the rows (0) or columns (1) holds the body, with its middle where that of the whole is."""
    middle = body.shape[axis] // 2
    reach = int(np.abs(np.flatnonzero(body.any(axis=1 - axis)) - middle).max())
    return slice(middle - reach, middle + reach + 1)
