"""One bracketed stack, from its frames to radiance: times measured, movement looked for, needless parts not read."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from processing.radiometry.adaptive import Curve, ReadReport, merge_adaptively, survey_patches
from processing.radiometry.alignment import Alignment, alignment, shift_error
from processing.radiometry.defects import without_hot_pixels
from processing.radiometry.exposure import (
    LINEARISED,
    SYSTEMATIC,
    ExposureTimes,
    TimesVerdict,
    exposure_times,
    times_error,
)
from processing.radiometry.hdr import Radiance
from processing.radiometry.sensor import PixelCorrection, Sensor
from processing.radiometry.sensor_calibration import SensorCalibration


@dataclass(frozen=True, eq=False)
class Exposures:
    """Frames (h, w) of one camera that differ in exposure alone, possibly on disk, with their names for messages.

    `linear_dn` makes their counts linear, where the sensor was measured.
    """

    frames: Sequence[NDArray[np.uint16]]
    exposure_s: Sequence[float]
    names: Sequence[str]
    sensor: Sensor
    correction: PixelCorrection | None = None
    linear_dn: Curve | None = None

    def measured_by(self, calibration: SensorCalibration | None) -> "Exposures":
        """The same frames with their camera's sensor as measured; as they are where it was not."""
        if calibration is None:
            return self
        return replace(
            self, sensor=calibration.sensor, correction=calibration.correction, linear_dn=calibration.linear_dn
        )


@dataclass(frozen=True, eq=False)
class MergedExposures:
    """Radiance of the mosaic, and what was found out about its frames."""

    radiance: Radiance
    times: ExposureTimes
    alignment: Alignment
    read: ReadReport


@dataclass(frozen=True, slots=True)
class MergeOptions:
    """What of a doubtful stack is taken: times that the frames contradict, a picture that moved between exposures."""

    measured_times: bool = False
    moved: bool = False


DEFAULTS = MergeOptions()


def merge_stack(exposures: Exposures, options: MergeOptions = DEFAULTS) -> MergedExposures:
    """Merge by the times that the frames themselves confirm, reading what changes the result; hot pixels are left out.

    Departures of the times beyond the noise are corrected; what remains of them, `times.sigma`, is common to all pixels
    and not in the radiance's variance. Raises ImageError where the frames are none or do not fit together; and one that
    names them, unless the options say otherwise, where times are wrong by more than `exposure.GROSS` or the picture
    moved by more than `alignment.REFUSED_PX`, both beyond doubt.
    """
    linear_dn = exposures.linear_dn or np.asarray
    patches = linear_dn(survey_patches(exposures.frames))
    systematic = SYSTEMATIC if exposures.linear_dn is None else LINEARISED
    times = exposure_times(patches, exposures.exposure_s, exposures.sensor, systematic)
    if times.verdict == TimesVerdict.CONTRADICTED and not options.measured_times:
        raise times_error(times, exposures.names)
    found = alignment(patches, times.exposure_s, exposures.sensor)
    if found.worst is not None and found.worst.refused and not options.moved:
        raise shift_error(found.worst, exposures.names)
    merged = merge_adaptively(
        exposures.frames, times.exposure_s, exposures.sensor, exposures.correction, linear_dn=linear_dn
    )
    return MergedExposures(without_hot_pixels(merged.radiance), times, found, merged.report)
