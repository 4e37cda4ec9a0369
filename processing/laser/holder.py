"""The sample holder as the laser analysis sees it: a stepped white frame whose two heights are known."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.cameras.calibration import CameraModel
from processing.laser import holder_kernel

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

    `points_m` (h, w, 3) is where they see it, rig frame; NaN where `height` is 0.
    """

    points_m: Array
    height: NDArray[np.uint8]


def plane_hits(camera: CameraModel, z_m: float) -> Array:
    """Points (h, w, 3) of the rig frame where the pixels' rays meet the plane at this height; NaN where they do not."""
    return geometry.intersect_plane(camera.centre_m, camera.pixel_rays(), (0.0, 0.0, 1.0), z_m)


def reference_region(camera: CameraModel, rig_from_sample: Array, holder: Holder, source_m: Array) -> ReferenceRegion:
    """Pixels whose whole footprint sees one height of the white frame, lit by a laser near `source_m` (3,)."""
    part, points_m = _parts(camera, rig_from_sample, holder, source_m)
    return ReferenceRegion(points_m, np.where(part == holder_kernel.OPENING, 0, part).astype(np.uint8))


def wanted_pixels(camera: CameraModel, rig_from_sample: Array, holder: Holder, source_m: Array) -> NDArray[np.bool_]:
    """Pixels (h, w) that a sweep's analysis needs: those of the reference region and those that look into the opening.

    `source_m` (3,) is about where the laser stands; it decides which of the lower white frame lies in the shadow.
    """
    return np.asarray(_parts(camera, rig_from_sample, holder, source_m)[0] != holder_kernel.NOTHING)


def _parts(
    camera: CameraModel, rig_from_sample: Array, holder: Holder, source_m: Array
) -> tuple[NDArray[np.uint8], Array]:
    """What of the holder every pixel sees (h, w), and where it sees the white frame (h, w, 3)."""
    sides = np.array([holder.sample_m, holder.inner_m, holder.outer_m]) / 2
    part, points_m = np.empty(camera.size, np.uint8), np.empty((*camera.size, 3))
    view = (np.ascontiguousarray(camera.centre_m), np.asarray(source_m, np.float64))
    box = (geometry.invert(rig_from_sample), sides, holder.step_m, _SAFETY_M)
    holder_kernel.see_holder(camera.pixel_rays(), view, box, part, points_m)
    return part, points_m
