"""Space-time analysis: when the middle of the laser stripe crossed each pixel, to a fraction of a frame.

A pixel looks at one point of the sample; while the stripe sweeps over it, its samples draw the stripe's Gaussian
cross-section in time, whatever the albedo around (Curless and Levoy 1995, section 3). So the analysis runs on the raw
mosaic, pixel by pixel, and neither colour nor texture biases it.
"""

import os
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from processing.laser import pulse
from processing.laser.peak_tracker import Profiles, track_peaks
from processing.radiometry.sensor import Sensor

_WIDTHS = (0.6, 1.0, 1.7, 2.8)  # starting points of the common width, frames
_USUAL_WIDTH = 1.5  # frames; where nothing is seen, nothing depends on it
_PILOTS = 1500  # pulses that determine it
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
    is that of the time in frames squared, from the Fisher information. `amplitude_e`, the pulse's height above the
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
    `double_fraction` is the height of another peak, relative to the pulse, that spoils the measurement.
    """

    width_frames: float | None = None
    width_tolerance: float = 0.2
    double_fraction: float = 0.4


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
    span = min(_SPAN * width + 1.0, float(profiles.reach))
    return _assemble(profiles, _fit(profiles, sensor, settings, (width, settings.width_tolerance, span)))


def typical_width(profiles: Profiles, sensor: Sensor, settings: PulseSettings) -> float:
    """Standard deviation in frames of the sweep's pulses: the median over bright, unsaturated, single ones.

    The stripe's width over its speed is common to all pixels. 1.5 where no pulse can be told.
    """
    pilots = _pilots(profiles, sensor)
    if pilots.brightest.size == 0:
        return _USUAL_WIDTH
    fits = [_fit(pilots, sensor, settings, (width, 1.0, float(profiles.reach))) for width in _WIDTHS]
    cost = np.stack([np.where(f[:, pulse.STATUS] == PeakStatus.OK, f[:, pulse.COST], np.inf) for f in fits])
    width = np.stack([f[:, pulse.WIDTH] for f in fits])[np.argmin(cost, axis=0), np.arange(cost.shape[1])]
    good = width[np.isfinite(cost.min(axis=0))]
    return float(np.median(good)) if good.size else _USUAL_WIDTH


def _pilots(profiles: Profiles, sensor: Sensor) -> Profiles:
    """The profiles of up to _PILOTS of the brighter unsaturated pixels, spread over the image."""
    peak_e = (profiles.window_dn[:, profiles.reach].astype(np.float64) - sensor.black_dn) * sensor.gain_e_per_dn
    mean_dn = profiles.total_dn / profiles.times.size
    height_e = peak_e - (mean_dn - sensor.black_dn) * sensor.gain_e_per_dn
    clean = (profiles.brightest >= 0) & (peak_e < sensor.saturation_e)
    clean &= height_e > 8.0 * np.sqrt(np.maximum(peak_e, 0.0) + sensor.dark_variance_e2)
    chosen = np.flatnonzero(clean)
    if chosen.size > _PILOTS:
        chosen = chosen[height_e[chosen] >= np.median(height_e[chosen])]
        chosen = chosen[:: -(-chosen.size // _PILOTS)]
    return Profiles(
        (1, chosen.size),
        profiles.times,
        profiles.window_dn[chosen],
        profiles.brightest[chosen],
        profiles.second_dn[chosen],
        profiles.total_dn[chosen],
    )


def _fit(
    profiles: Profiles, sensor: Sensor, settings: PulseSettings, width: tuple[float, float, float]
) -> NDArray[np.float64]:
    """Rows of pulse.FIELDS per pixel; rows of pixels are fitted in parallel, each pixel by itself."""
    camera = (sensor.black_dn, sensor.gain_e_per_dn, sensor.dark_variance_e2, sensor.saturation_e)
    limits = (_SIGNIFICANCE, settings.double_fraction)
    pixels = profiles.brightest.size
    fits = np.empty((pixels, pulse.FIELDS))

    def run(start: int) -> None:
        part = slice(start, min(start + 16384, pixels))
        data = (profiles.window_dn[part], profiles.brightest[part], profiles.second_dn[part], profiles.total_dn[part])
        pulse.fit_pulses(data, profiles.times, camera, width, limits, fits[part])

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(run, range(0, pixels, 16384)))
    return fits


def _assemble(profiles: Profiles, fits: NDArray[np.float64]) -> PeakTimes:
    grid = fits.reshape(*profiles.shape, pulse.FIELDS)
    measured = grid[..., pulse.STATUS] == PeakStatus.OK

    def column(index: int) -> NDArray[np.float32]:
        with np.errstate(over="ignore"):  # what is less certain than single precision can say is not certain at all
            return np.where(measured, grid[..., index], np.nan).astype(np.float32)

    return PeakTimes(
        column(pulse.TIME),
        column(pulse.VARIANCE),
        grid[..., pulse.AMPLITUDE].astype(np.float32),
        grid[..., pulse.STATUS].astype(np.uint8),
        column(pulse.WIDTH),
    )
