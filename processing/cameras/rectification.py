"""From a camera's image to the sample's texels, in one resampling from the camera's own pixels."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.cameras import resample_kernel
from processing.cameras.calibration import CameraModel
from processing.errors import ImageError
from processing.radiometry.hdr import Radiance

Array = NDArray[np.float64]
_COLOUR = np.tile(np.arange(3, dtype=np.uint8), (2, 2, 1))  # every pixel has three planes


class TexelStatus(IntEnum):
    """What a texel of a rectified image is; of several reasons the greatest number counts."""

    SEEN = resample_kernel.SEEN  # measured in all channels
    OUT_OF_FIELD = resample_kernel.OUT_OF_FIELD  # over half of it lies outside the image, or no lens shows it
    SATURATED = resample_kernel.SATURATED  # a hundredth or more of it is saturated: its mean would be too dark
    MISSING = resample_kernel.MISSING  # over half of it fell on hot or otherwise unmeasured pixels
    AVERTED = 4  # the sample plane shows the camera its back
    HIDDEN = 5  # outside the holder's opening, or its rim lies before it


@dataclass(frozen=True, slots=True)
class Texels:
    """`count` x `count` texels over the square of `side_m` in the sample frame at z = -`depth_m`, row 0 at +Y.

    They are seen through a square opening of `opening_m` whose rim stands `rim_m` over that plane.
    """

    count: int
    side_m: float
    opening_m: float = np.inf
    rim_m: float = 0.0
    depth_m: float = 0.0

    @property
    def centres_m(self) -> Array:
        """Centres (n, n, 3) in the sample frame."""
        return geometry.texel_grid(self.count, self.side_m, -self.depth_m)

    @property
    def corners_m(self) -> Array:
        """Corners (n + 1, n + 1, 3) in the sample frame."""
        return geometry.texel_corners(self.count, self.side_m, -self.depth_m)


@dataclass(frozen=True, slots=True)
class Rectified:
    """An image on the sample's texels: `value` and `variance` (n, n, 3) float32, `status` (n, n) of TexelStatus.

    Row 0 lies at +Y of the sample frame, column 0 at -X. Where the status is not SEEN at least one channel is NaN.
    """

    value: NDArray[np.float32]
    variance: NDArray[np.float32]
    status: NDArray[np.uint8]
    texels: Texels

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Texels (n, n) that are measured in all channels."""
        return np.asarray(self.status == TexelStatus.SEEN, np.bool_)


def rectify(
    radiance: Radiance,
    camera: CameraModel,
    rig_from_sample: Array,
    texels: Texels,
    cfa: NDArray[np.uint8] | None = None,
) -> Rectified:
    """Radiance of the texels over the sample, in one resampling from the camera's own pixels.

    `radiance` is a colour image (h, w, 3), or with `cfa` a mosaic (h, w): then demosaicing is part of the resampling.
    A texel is the mean over its footprint in the image, each point of it interpolated bilinearly between the pixels
    of its colour; so it averages where the image is finer, without aliasing and each pixel with its share of the
    area, and interpolates where it is coarser. Pixels without a value take no part; the variance is that of the
    weighted mean. Raises ImageError where image, camera and pattern do not fit.
    """
    planes, channel = _planes(radiance, camera, cfa)
    corners_px = camera.project(geometry.transform_points(rig_from_sample, texels.corners_m))
    # Samples of one colour are two pixels apart in a mosaic: there the tents that interpolate are as much wider.
    reach = 1 if cfa is None else 2
    value, variance, status = resample_kernel.resample(*planes, channel, corners_px, reach)
    hidden = _obstruction(texels, geometry.transform_points(geometry.invert(rig_from_sample), camera.centre_m))
    if hidden.any():
        value[hidden > 0] = variance[hidden > 0] = np.nan
    return Rectified(value, variance, np.maximum(status, hidden), texels)


def _planes(
    radiance: Radiance, camera: CameraModel, cfa: NDArray[np.uint8] | None
) -> tuple[tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]], NDArray[np.uint8]]:
    """Value, variance and status as (h, w, planes), and the colour of each plane by row and column modulo two."""
    wanted = (*camera.size, 3) if cfa is None else tuple(camera.size)
    shapes = {radiance.value.shape, radiance.variance.shape, radiance.status.shape}
    if shapes != {wanted}:
        raise ImageError(f"an image of shapes {sorted(shapes)} does not fit a camera of {camera.size}: not {wanted}.")
    channel = _COLOUR if cfa is None else np.asarray(cfa, np.uint8)[..., None]
    if channel.shape[:2] != (2, 2) or channel.max() > 2:
        raise ImageError(f"not a Bayer pattern: {np.asarray(cfa).tolist()}")
    shape = (*camera.size, channel.shape[2])
    value, variance = (np.ascontiguousarray(a, np.float32).reshape(shape) for a in (radiance.value, radiance.variance))
    return (value, variance, np.ascontiguousarray(radiance.status, np.uint8).reshape(shape)), channel


def _obstruction(texels: Texels, centre_m: Array) -> NDArray[np.uint8]:
    """AVERTED, HIDDEN or 0 of every texel (n, n), seen from a sample-frame point."""
    shape = (texels.count, texels.count)
    height_m = centre_m[2] + texels.depth_m
    if height_m <= 0:
        return np.full(shape, TexelStatus.AVERTED, np.uint8)
    if np.isinf(texels.opening_m):
        return np.zeros(shape, np.uint8)
    # A line that leaves an upright opening does not come back: it is enough to look at its two ends. How far out
    # they lie along x depends on the column alone, along y on the row alone.
    rise, half_m = min(texels.rim_m / height_m, 1.0), texels.opening_m / 2
    centres_m = texels.centres_m
    column, row = (
        (np.abs(along) > half_m) | (np.abs(along + (eye - along) * rise) > half_m)
        for along, eye in ((centres_m[0, :, 0], centre_m[0]), (centres_m[:, 0, 1], centre_m[1]))
    )
    return np.where(column | row[:, None], TexelStatus.HIDDEN, 0).astype(np.uint8)
