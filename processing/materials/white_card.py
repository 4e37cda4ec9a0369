"""The irradiance of every light, read from a white card beside the body."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.materials.photographs import BodyPhotographs
from processing.materials.sight import Sight
from processing.products.arrays import Float64
from processing.products.directions import falloff, toward

_MARGIN = 0.12  # share of the card's sides that is left out, for its blurred edge
_LEAST_LIT_SHARE = 0.25
_PENUMBRA = 1.02  # in radii
_LEAST_COSINE = 0.05


@dataclass(frozen=True, slots=True)
class WhiteCard:
    """A matt white card in the plane through the body's centre that faces the camera.

    Its centre lies `right_m` along the image's columns and `up_m` against its rows from the body's centre;
    `reflectance` is the share of light that it returns.
    """

    right_m: float
    up_m: float
    width_m: float
    height_m: float
    reflectance: float

    def corners(self, radius_m: float, margin: float) -> Float64:
        """Corners (4, 3) in radii, of the card that is made smaller by this share of its sides on every side."""
        half_m = (0.5 - margin) * np.array([self.width_m, self.height_m])
        middle_m = np.array([self.right_m, -self.up_m])
        around_m = half_m * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        return np.column_stack([middle_m + around_m, np.zeros(4)]) / radius_m


def card_irradiance(photographs: BodyPhotographs, sight: Sight, card: WhiteCard) -> Float64:
    """Irradiance (light, 3) at normal incidence in the body's centre, read from the white card under each light.

    E = pi L / (reflectance cos theta), times the ratio of the squared distances; pixels in the body's shadow are left
    out by geometry. A light that the body keeps from most of the card gets the mean of the others of the same lamp,
    which is the same lamp everywhere.
    Raises ImageError where a lamp never reaches the card, or the card is not seen.
    """
    points, rows, columns = _card_pixels(photographs, sight, card)
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
    return _shared_by_lamp(reading, photographs.lamps)


def _shared_by_lamp(reading: Float64, lamps: NDArray[np.intp]) -> Float64:
    filled = reading.copy()
    for lamp in np.unique(lamps):
        own = lamps == lamp
        seen = own & np.isfinite(reading).all(axis=1)
        if not seen.any() or not (reading[seen] > 0).all():
            raise ImageError(
                f"the white card is dark, saturated or shadowed under every light of lamp {lamp + 1} of "
                f"{len(np.unique(lamps))}; check where it stands, or leave the lamp out"
            )
        filled[own & ~seen] = reading[seen].mean(axis=0)
    return filled


def _card_pixels(
    photographs: BodyPhotographs, sight: Sight, card: WhiteCard
) -> tuple[Float64, NDArray[np.intp], NDArray[np.intp]]:
    """Points (n, 3) on the card in radii, and the rows and columns of the pixels that see them."""
    corners = card.corners(photographs.radius_m, _MARGIN)
    seen_px = sight.image_points(corners)
    low, high = np.ceil(seen_px.min(axis=0)).astype(int), np.floor(seen_px.max(axis=0)).astype(int)
    height, width = photographs.radiance.shape[1:]
    if (high - low < 2).any() or (low < 0).any() or high[0] >= width or high[1] >= height:
        raise ImageError(
            f"the white card would cover columns {low[0]} to {high[0]} and rows {low[1]} to {high[1]} of a picture of "
            f"{width} x {height}; check place and size of the card in the plan"
        )
    rows, columns = (axis.ravel() for axis in np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1])
    # Over so small a part of the image the lens's distortion is the same everywhere: a homography.
    plane_from_image = cv2.getPerspectiveTransform(seen_px.astype(np.float32), corners[:, :2].astype(np.float32))
    places = np.stack([columns, rows], axis=-1)[:, None].astype(np.float64)
    points = cv2.perspectiveTransform(places, plane_from_image)[:, 0]
    within = ((points >= corners[:, :2].min(axis=0)) & (points <= corners[:, :2].max(axis=0))).all(axis=1)
    return np.column_stack([points, np.zeros(len(points))])[within], rows[within], columns[within]


def _card_light(
    photographs: BodyPhotographs, light: int, points: Float64
) -> tuple[Float64, Float64, NDArray[np.bool_]]:
    """Cosine of incidence, squared ratio of the centre's distance to the point's, and whether the light gets there."""
    direction, distance = photographs.light_directions[light], photographs.light_distances[light]
    way = toward(points, direction, distance)
    along = (points * way).sum(axis=1)
    past = np.sqrt(np.maximum((points * points).sum(axis=1) - along**2, 0.0))
    shadowed = (along < 0) & (past < _PENUMBRA)
    cosine = -way[:, 2]
    return cosine, falloff(points, direction, distance), ~shadowed & (cosine > _LEAST_COSINE)
