"""Peak times and laser planes to 3D points: what one sweep measures in one camera."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.cameras.calibration import CameraModel
from processing.laser import range_kernel
from processing.laser.holder import Holder, plane_hits
from processing.laser.laser_plane import LaserSweep
from processing.laser.space_time import PeakStatus, PeakTimes

Array = NDArray[np.float64]


class RangeStatus(IntEnum):
    """Outcome at one pixel; only MEASURED carries a displacement."""

    MEASURED = range_kernel.MEASURED
    NOT_SAMPLE = range_kernel.NOT_SAMPLE  # the pixel does not look into the holder's opening
    NO_PEAK = range_kernel.NO_PEAK  # no time: see PeakTimes.status
    NO_PLANE = range_kernel.NO_PLANE  # outside the sweep, seen edge on, or less certain than the sample's box
    OUTSIDE_BOX = range_kernel.OUTSIDE_BOX  # the point lies where no sample can be: a false peak


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
    status, found = np.empty(peaks.status.shape, np.uint8), np.empty((2, *peaks.status.shape), np.float32)
    box = range_kernel.SampleBox(geometry.invert(rig_from_sample), holder.sample_m / 2, holder.depth_m)
    times = np.where(peaks.status == PeakStatus.OK, peaks.time_frames, np.float32(np.nan))
    range_kernel.cut_rays(
        (camera.pixel_rays(), np.ascontiguousarray(camera.centre_m)),
        (times, peaks.variance),
        sweep.model,
        box,
        status,
        found,
    )
    return RangeImage(found[0], found[1], status)
