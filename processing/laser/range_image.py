"""Peak times and laser planes to 3D points: what one sweep measures in one camera."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.cameras.calibration import CameraModel
from processing.laser.fan import fan_distance
from processing.laser.holder import Holder, opening, plane_hits
from processing.laser.laser_plane import LaserSweep, SweepStatus
from processing.laser.space_time import PeakStatus, PeakTimes

Array = NDArray[np.float64]
_MARGIN_M = 0.0003  # by which a point may leave the sample's box, beside three sigma
_GRAZING = 0.05  # cosine between view ray and plane normal under which the cut means nothing


class RangeStatus(IntEnum):
    """Outcome at one pixel; only MEASURED carries a displacement."""

    MEASURED = 0
    NOT_SAMPLE = 1  # the pixel does not look into the holder's opening
    NO_PEAK = 2  # no time: see PeakTimes.status
    NO_PLANE = 3  # outside the sweep, or the plane is seen edge on
    OUTSIDE_BOX = 4  # the point lies where no sample can be: a false peak


@dataclass(frozen=True)
class RangeImage:
    """Displacement (h, w) float32 in metres along the view ray from the plane z = 0, positive below it.

    `variance_m2` float32 is its variance; both NaN where `status` (uint8, RangeStatus) is not MEASURED.
    """

    displacement_m: NDArray[np.float32]
    variance_m2: NDArray[np.float32]
    status: NDArray[np.uint8]

    def points(self, camera: CameraModel) -> Array:
        """The measured points (h, w, 3) in the rig frame; NaN where there is none."""
        return np.asarray(plane_hits(camera, 0.0) + self.displacement_m[..., None] * camera.pixel_rays())


def range_image(
    peaks: PeakTimes, camera: CameraModel, rig_from_sample: Array, holder: Holder, sweep: LaserSweep
) -> RangeImage:
    """Displacement of every pixel that looks into the opening: its ray cut by the laser plane at its peak time.

    The variance is that of the time and of the plane there, through the derivative of the cut. Pixels outside the
    opening are skipped, points outside the sample's box rejected.
    """
    status = np.full(peaks.status.shape, RangeStatus.NO_PEAK, np.uint8)
    status[~opening(camera, rig_from_sample, holder)] = RangeStatus.NOT_SAMPLE
    displacement, variance = (np.full(status.shape, np.nan, np.float32) for _ in range(2))
    looked = (status == RangeStatus.NO_PEAK) & (peaks.status == PeakStatus.OK)
    if sweep.status == SweepStatus.NO_STRIPE or not looked.any():
        return RangeImage(displacement, variance, status)
    rays, start = camera.pixel_rays()[looked], plane_hits(camera, 0.0)[looked]
    time, time_variance = (values[looked].astype(np.float64) for values in (peaks.time_frames, peaks.variance))
    depth, depth_variance = _cut(start, rays, sweep, time, time_variance)
    found = np.where(np.isfinite(depth), RangeStatus.MEASURED, RangeStatus.NO_PLANE).astype(np.uint8)
    with np.errstate(invalid="ignore"):
        outside = ~_in_box(start + depth[:, None] * rays, np.sqrt(depth_variance), rig_from_sample, holder)
    found[(found == RangeStatus.MEASURED) & outside] = RangeStatus.OUTSIDE_BOX
    status[looked] = found
    displacement[looked] = np.where(found == RangeStatus.MEASURED, depth, np.nan)
    variance[looked] = np.where(found == RangeStatus.MEASURED, depth_variance, np.nan)
    return RangeImage(displacement, variance, status)


def _cut(start: Array, rays: Array, sweep: LaserSweep, time: Array, time_variance: Array) -> tuple[Array, Array]:
    """Distance (n,) from `start` along `rays` to the planes at `time`, and its variance; NaN where there is none."""
    normal, offset = sweep.planes(time)
    slant = np.einsum("ij,ij->i", normal, rays)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (offset - np.einsum("ij,ij->i", normal, start)) / slant
        depth[~(np.abs(slant) > _GRAZING)] = np.nan
    variance = np.full(len(depth), np.nan)
    good = np.isfinite(depth)
    points = start[good] + depth[good, None] * rays[good]
    per_angle = fan_distance(sweep.fan, points) / slant[good]
    variance[good] = sweep.angle_variance(points, time[good], time_variance[good]) * per_angle**2
    return depth, variance


def _in_box(points_m: Array, sigma_m: Array, rig_from_sample: Array, holder: Holder) -> NDArray[np.bool_]:
    local = geometry.transform_points(geometry.invert(rig_from_sample), points_m)
    margin = _MARGIN_M + 3.0 * sigma_m
    inside = np.abs(local[:, :2]).max(axis=1) <= holder.sample_m / 2 + margin
    inside &= (local[:, 2] <= margin) & (local[:, 2] >= -holder.depth_m - margin)
    return np.asarray(inside)
