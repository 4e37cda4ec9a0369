"""The laser stripe in single colour images: how much of a pixel's light is the laser's, and a line through points."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.robust import biweight, bulk_deviation, principal_axes

Array = NDArray[np.float64]
_ROUNDS = 15
_LEAST_SCALE_PX = 1e-3  # of exact points, whose scatter is rounding
_TRIALS = 300  # pairs of points: with half of them wrong, none of 300 is right once in 10^37


@dataclass(frozen=True)
class ImageLine:
    """The line a u + b v = c with a^2 + b^2 = 1 in pixels, the RMS distance of the points that make it, their number.

    `inliers` (n,) says which of the given points they are.
    """

    normal: Array
    offset_px: float
    rms_px: float
    inliers: NDArray[np.bool_]


class LaserColour(StrEnum):
    """What tells the laser's light from the rest."""

    RED = "red"
    GREEN = "green"
    BLUE = "blue"
    GREY = "grey"  # the camera sees no colour, or the room is dark


# White and black paper under white light are near 0 in a difference, so only the stripe is left. Of a Bayer camera's
# channels green is the least noisy.
_CHANNELS = {LaserColour.RED: (0, 1), LaserColour.GREEN: (1, 0), LaserColour.BLUE: (2, 1)}


def laser_light(image: NDArray[Any], colour: LaserColour) -> Array:
    """How much of the laser is in each pixel, an image (h, w) in the units of `image` (h, w) or (h, w, 3), RGB.

    Of a coloured laser its channel less another one, R - G, G - R or B - G; of GREY the channels' mean. Raises
    ImageError where a coloured laser is sought in a grey picture.
    """
    if colour == LaserColour.GREY:
        return np.asarray(image, np.float64) if image.ndim == 2 else image[..., :3].mean(axis=-1, dtype=np.float64)
    if image.ndim != 3 or image.shape[2] < 3:
        raise ImageError(f"a colour image (h, w, 3) shows a {colour} laser, not a grey one; for that say grey.")
    own, other = _CHANNELS[colour]
    return np.asarray(image[..., own].astype(np.float64) - image[..., other])


def room_light(image: NDArray[Any], colour: LaserColour) -> NDArray[Any]:
    """The channel (h, w) of a colour image (h, w, 3) that `laser_light` takes off: there a coloured laser is dim.

    Raises ImageError where the image is grey.
    """
    laser_light(image[:1], colour)
    return np.asarray(image[..., _CHANNELS[colour][1]])


def redness(rgb: NDArray[Any]) -> Array:
    """How much redder than grey a pixel is: R - G, an image (h, w) in the units of `rgb` (h, w, 3)."""
    return laser_light(rgb, LaserColour.RED)


def stripe_line(uv_px: Array, tolerance_px: float = 2.0) -> ImageLine:
    """Line through stripe points (n, 2) of which a minority may be wrong.

    Starts from the pair of points that most others support, then reweighted (Tukey) least squares on distances.
    Raises ImageError where fewer than three points are given, or no line has three.
    """
    points = np.asarray(uv_px, np.float64)
    if len(points) < 3:
        raise ImageError(f"{len(points)} stripe points do not make a line.")
    normal, offset = _consensus(points, tolerance_px)
    distance = points @ normal - offset
    for _ in range(_ROUNDS):
        near = np.abs(distance) < tolerance_px
        if np.count_nonzero(near) < 3:
            raise ImageError("the stripe's points do not lie on a line.")
        scale = max(bulk_deviation(distance[near]), _LEAST_SCALE_PX)
        weight = np.where(near, biweight(distance, scale), 0.0)
        centre, _, axes = principal_axes(points, weight)
        normal = axes[:, 0]
        offset = float(normal @ centre)
        distance = points @ normal - offset
    inliers = weight > 0.0
    rms = float(np.sqrt(np.mean(distance[inliers] ** 2)))
    return ImageLine(np.asarray(normal, np.float64), offset, rms, inliers)


def _consensus(points: Array, tolerance_px: float) -> tuple[Array, float]:
    """Normal and offset of the line through two points with the most others within the tolerance."""
    rng = np.random.default_rng(0)  # the same line for the same points
    first, second = rng.integers(0, len(points), (2, _TRIALS))
    along = points[second] - points[first]
    length = np.hypot(along[:, 0], along[:, 1])
    usable = length > 0
    if not usable.any():
        raise ImageError("the stripe's points coincide.")
    normals = np.stack([-along[usable, 1], along[usable, 0]], axis=-1) / length[usable, None]
    offsets = np.einsum("ij,ij->i", normals, points[first[usable]])
    support = (np.abs(points @ normals.T - offsets) < tolerance_px).sum(axis=0)
    best = int(np.argmax(support))
    return normals[best], float(offsets[best])
