"""Space-time analysis: when the middle of the laser stripe crossed each pixel, to a fraction of a frame.

A pixel looks at one point of the sample; while the stripe sweeps over it, its samples draw the stripe's Gaussian
cross-section in time, whatever the albedo around (Curless and Levoy 1995, section 3). So the analysis runs on the raw
mosaic, pixel by pixel, and neither colour nor texture biases it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from processing.laser import pulse
from processing.laser.ambient import ambient_change
from processing.laser.block_maxima import WINDOW
from processing.laser.estimators import Estimator, retime
from processing.laser.peak_tracker import Profiles, track_peaks
from processing.laser.pulse import Camera
from processing.laser.pulse_tiles import fit_sweep
from processing.radiometry.sensor import Sensor

_USUAL_WIDTH = 1.5  # frames; where nothing is seen, nothing depends on it
_PILOTS = 1024  # pulses that determine it
_SPARSE = 29  # of so many pixels one is looked at for pilots; prime, so that rows and mosaic places take turns
_LEAST_WIDTH = 0.4  # frames; a narrower pulse is one sample
_BRIGHT = 5.0  # sigmas of a pilot's brightest sample above its mean
_SIGNIFICANCE = 5.0  # sigmas of the amplitude below which a pixel is dark
_SPAN = 3.5  # widths on either side of the peak (and one frame) that enter the fit


class PeakStatus(IntEnum):
    """Outcome at one pixel; only OK carries a time."""

    OK = 0
    TOO_DARK = pulse.TOO_DARK  # no pulse above the noise: occluded from the laser, or black
    CUT_OFF = pulse.CUT_OFF  # the pulse lies at the first or last frame, or too few frames surround it
    DOUBLE = pulse.DOUBLE  # a second comparable peak: interreflection, or two surfaces in one pixel
    SATURATED = pulse.SATURATED  # clipped, and not both flanks are seen
    DISTORTED = pulse.DISTORTED  # not a single pulse of the stripe's width
    NOT_WANTED = pulse.NOT_WANTED  # outside the mask


@dataclass(frozen=True)
class PeakTimes:
    """Times of the stripe's passage (h, w), float32; NaN where `status` (uint8, PeakStatus) is not OK.

    `time_frames` and `width_frames` (standard deviation of the pulse) are in frame intervals from frame 0, `variance`
    is that of the time in frames squared, from the Fisher information: float32 resolves a thousandth of a frame up to
    frame 16000. `amplitude_e`, the pulse's height above the
    background in electrons, is given wherever a pulse could be fitted.
    """

    time_frames: NDArray[np.float32]
    variance: NDArray[np.float32]
    amplitude_e: NDArray[np.float32]
    status: NDArray[np.uint8]
    width_frames: NDArray[np.float32] = field(repr=False)


@dataclass(frozen=True, slots=True)
class PulseSettings:
    """What counts as a pulse.

    `width_frames` (standard deviation) is found from the brightest pulses where it is None; each pixel's own width may
    differ from it by about `width_tolerance` (one sigma of its logarithm; 0 fixes it).
    `double_fraction` is the height of another peak, relative to the pulse, that spoils the measurement. A lower one, or
    one bright sample, within 3.5 widths and a frame is fitted along with the pulse: it pulls the time by up to half a
    frame (one of half the height) and `variance`, which is that of noise alone, does not show it.
    `estimator` reads the time from what was found to be a pulse; the width, amplitude and status are the Gaussian's.
    """

    width_frames: float | None = None
    width_tolerance: float = 0.2
    double_fraction: float = 0.4
    estimator: Estimator = Estimator.GAUSSIAN


def peak_times(
    frames: Iterable[NDArray[np.uint16]],
    sensor: Sensor,
    settings: PulseSettings | None = None,
    times: Sequence[float] | NDArray[np.floating] | None = None,
    mask: NDArray[np.bool_] | None = None,
) -> PeakTimes:
    """Time of the stripe's passage at every pixel of a sweep, one pass over its frames.

    `frames`: array (t, h, w) or any iterable of frames (h, w), uint16 raw_dn. `times` (t,) in frame intervals where
    frames are missing or uneven; 0, 1, 2, ... otherwise. `mask` (h, w) says which pixels are wanted; all if omitted.
    Weighted Gaussian maximum likelihood under shot and read noise of time, amplitude, background and width on the
    samples around the brightest one; saturated samples count as 'at least full well'.
    Raises ImageError where there is no frame, or where one (or the mask) differs in shape or type.
    """
    return fit_peaks(track_peaks(frames, times, mask), sensor, settings or PulseSettings())


def fit_peaks(profiles: Profiles, sensor: Sensor, settings: PulseSettings) -> PeakTimes:
    """Peak times of profiles that were kept from a sweep."""
    width = settings.width_frames or typical_width(profiles, sensor, settings)
    results, status = _fit(profiles, sensor, settings, (width, settings.width_tolerance, _SPAN * width + 1.0))
    if settings.estimator != Estimator.GAUSSIAN:
        centroid = settings.estimator == Estimator.CENTROID
        ambient = ambient_change(profiles.sample_dn, sensor.black_dn, width)
        retime(profiles.sweep(ambient), _camera(sensor), width, centroid, results, status)
    time, variance, amplitude, width_frames = results.reshape(4, *profiles.shape)
    return PeakTimes(time, variance, amplitude, status.reshape(profiles.shape), width_frames)


def typical_width(profiles: Profiles, sensor: Sensor, settings: PulseSettings) -> float:
    """Standard deviation in frames of the sweep's pulses: the median over bright, single ones.

    The stripe's width over its speed is common to all pixels. Where all pulses are saturated their flanks tell it.
    1.5 where no pulse can be told.
    """
    pilots = _pilots(profiles, sensor)
    if pilots is None:
        return _USUAL_WIDTH
    width = _area_width(pilots, sensor)
    for _ in range(2):
        (_, _, amplitude, found), status = _fit(pilots, sensor, settings, (width, 0.5, _SPAN * width + 1.0))
        good = status == PeakStatus.OK
        if not good.any():
            return width
        light = amplitude * found  # what a pulse collects says nothing about the error of its width
        width = float(np.median(found[good & (light >= np.median(light[good]))]))
    return width


def _area_width(pilots: Profiles, sensor: Sensor) -> float:
    """Typical width of pulses from their area over their height above the frames outside their windows."""
    window = pilots.frames_dn.astype(np.float64)
    others = pilots.times.size - len(window)
    outside = (pilots.total_dn - window.sum(axis=0)) / max(others, 1)
    light = window - (outside if others >= len(window) else np.median(window, axis=0))
    width = light.sum(axis=0) / np.maximum(light.max(axis=0), 1.0) / np.sqrt(2.0 * np.pi)
    return float(np.clip(np.median(width), _LEAST_WIDTH, WINDOW / 2))


def _pilots(profiles: Profiles, sensor: Sensor) -> Profiles | None:
    """Up to _PILOTS of the bright pixels, spread over the image, saturated ones if all are; None where none is."""
    for stride in (_SPARSE, 1):
        pixels = np.arange(0, profiles.brightest.size, stride)
        chosen = pixels[profiles.brightest[pixels] >= 0]
        frame = profiles.brightest[chosen]
        peak_e = profiles.frames_dn[frame - profiles.origin[chosen], chosen].astype(np.float64) - sensor.black_dn
        height_e = peak_e - (profiles.total_dn[chosen] / profiles.times.size - sensor.black_dn)
        peak_e, height_e = peak_e * sensor.gain_e_per_dn, height_e * sensor.gain_e_per_dn
        bright = height_e > _BRIGHT * np.sqrt(np.maximum(peak_e, 0.0) + sensor.dark_variance_e2)
        clean = bright & (peak_e < sensor.saturation_e)
        if np.count_nonzero(clean) >= _PILOTS // 4:
            break
    chosen = chosen[clean if clean.any() else bright]
    chosen = chosen[:: -(-chosen.size // _PILOTS) or 1]
    return profiles.subset(chosen) if chosen.size else None


def _fit(
    profiles: Profiles, sensor: Sensor, settings: PulseSettings, width: tuple[float, float, float]
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    limits = (_SIGNIFICANCE, settings.double_fraction)
    ambient = ambient_change(profiles.sample_dn, sensor.black_dn, width[0])
    return fit_sweep(profiles.sweep(ambient), _camera(sensor), width, limits)


def _camera(sensor: Sensor) -> Camera:
    return sensor.black_dn, sensor.gain_e_per_dn, sensor.dark_variance_e2, sensor.saturation_e
