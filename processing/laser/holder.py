"""The sample holder as the laser analysis sees it: a stepped white frame whose two heights are known."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.cameras.calibration import CameraModel

Array = NDArray[np.float64]
_SAFETY_M = 0.0004  # beside half a pixel: the holder's edges are neither sharp nor exactly placed


@dataclass(frozen=True, slots=True)
class Holder:
    """Square holder around the turntable axis, sample frame, metres.

    Opening of side `sample_m`; white frame at z = 0 out to side `inner_m`, at z = -`step_m` from there to `outer_m`.
    The sample lies in the opening between z = -`depth_m` and 0. Texels leave out `margin_m` along its edge.
    """

    sample_m: float
    inner_m: float
    outer_m: float
    step_m: float
    depth_m: float
    margin_m: float = 0.0

    @property
    def texels_m(self) -> float:
        """Side of the square that the texels divide."""
        return self.sample_m - 2 * self.margin_m


@dataclass(frozen=True)
class ReferenceRegion:
    """Pixels (h, w) that see the white frame: `height` is 1 on the upper part, 2 on the lower one, 0 elsewhere.

    `points_m` (h, w, 3) is where they see it, rig frame; meaningless where `height` is 0.
    """

    points_m: Array
    height: NDArray[np.uint8]


def plane_hits(camera: CameraModel, z_m: float) -> Array:
    """Points (h, w, 3) of the rig frame where the pixels' rays meet the plane at this height; NaN where they do not."""
    return geometry.intersect_plane(camera.centre_m, camera.pixel_rays(), (0.0, 0.0, 1.0), z_m)


def reference_region(camera: CameraModel, rig_from_sample: Array, holder: Holder, source_m: Array) -> ReferenceRegion:
    """Pixels whose whole footprint sees one height of the white frame, lit by a laser near `source_m` (3,)."""
    upper, lower = plane_hits(camera, 0.0), plane_hits(camera, -holder.step_m)
    margin = _footprint(upper) / 2 + _SAFETY_M
    at_upper, at_lower = (_ring_distance(points, rig_from_sample) for points in (upper, lower))
    towards = np.asarray(source_m) - lower
    light = lower + towards * (holder.step_m / towards[..., 2:])
    with np.errstate(invalid="ignore"):
        on_upper = (at_upper > holder.sample_m / 2 + margin) & (at_upper < holder.inner_m / 2 - margin)
        on_lower = (at_lower > holder.inner_m / 2 + margin) & (at_lower < holder.outer_m / 2 - margin)
        for end in (upper, light):  # neither the view ray nor the laser's passes through the upper part
            on_lower &= _nearest_ring(lower, end, rig_from_sample) > holder.inner_m / 2 + margin
    height = np.where(on_upper, 1, np.where(on_lower, 2, 0)).astype(np.uint8)
    return ReferenceRegion(np.where(on_lower[..., None], lower, upper), height)


def opening(camera: CameraModel, rig_from_sample: Array, holder: Holder) -> NDArray[np.bool_]:
    """Pixels (h, w) whose rays enter the sample's opening through the reference plane."""
    with np.errstate(invalid="ignore"):
        return np.asarray(_ring_distance(plane_hits(camera, 0.0), rig_from_sample) < holder.sample_m / 2)


def _ring_distance(points_m: Array, rig_from_sample: Array) -> Array:
    """Half side of the axis-parallel square of the sample frame on which each point lies."""
    local = geometry.transform_points(geometry.invert(rig_from_sample), points_m)
    return np.asarray(np.abs(local[..., :2]).max(axis=-1))


def _nearest_ring(start_m: Array, end_m: Array, rig_from_sample: Array) -> Array:
    """The least of `_ring_distance` along the way from one point to another."""
    shares = np.linspace(0.0, 1.0, 9)
    rings = [_ring_distance(start_m + share * (end_m - start_m), rig_from_sample) for share in shares]
    return np.asarray(np.min(rings, axis=0))


def _footprint(points_m: Array) -> Array:
    """Length of a pixel's larger side on the plane."""
    if min(points_m.shape[:2]) < 2:
        return np.full(points_m.shape[:2], np.nan)
    sides = [np.linalg.norm(np.gradient(points_m, axis=axis), axis=-1) for axis in (0, 1)]
    return np.asarray(np.maximum(*sides))
