"""Photon transfer: black level, noise, gain, linearity and maps of a sensor from its own dark and flat frames.

The variance of counts that photons cause is their mean over the gain; so frames of an even field measure electrons per
count without knowing the light. Source: Janesick, Photon Transfer (2007); EMVA 1288 release 4.0, sections 2 and 6 to 8.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.errors import CalibrationError, ImageError
from processing.radiometry.frame_series import PHASES, Frame, Levels, Mask, Series, gather, levels, phase_sum
from processing.radiometry.light_drift import corrected_s, light_drift
from processing.radiometry.linearity import Linearity, LinearityFit, fit_linearity
from processing.radiometry.pixel_maps import HOT_E_S, DarkSums, FlatSums, Spread, flat_map, offset_map, shrunk
from processing.radiometry.saturation import below_saturation, saturation_point
from processing.radiometry.sensor import PixelCorrection, Sensor

Array = NDArray[np.float64]
Exposure = tuple[float, Iterable[Frame]]

ABOVE_ZERO = 4.0  # standard deviations of the dark that the black level must leave
LEAST_FLATS = 3  # levels below saturation in each channel
LEAST_LIGHT = 20.0  # of the brightest usable flat, in standard deviations of one sample in the dark
HOT_SIGMA = 8.0  # of the longest dark exposure: under it a pixel is not called hot
DISAGREE = (5.0, 0.02)  # a channel's gain is wrong beyond both: standard deviations, and share
UNEVEN_DARK = (8.0, 2.0)  # light under the cap beyond both: standard deviations, and electrons per second
QUANTISATION_DN2 = 1 / 12


@dataclass(frozen=True, slots=True)
class Measured:
    """A number and its standard deviation."""

    value: float
    sigma: float


@dataclass(frozen=True, eq=False)
class Transfer:
    """What the numbers rest on, level by level (n,), for looking at: dark levels first.

    Linear signal and variance in dn, the variance that the fit expects, the phase of the mosaic (0 to 3), exposure,
    whether it was fitted, and the residual from linearity (NaN where not fitted).
    """

    signal_dn: Array
    variance_dn2: Array
    expected_dn2: Array
    phase: NDArray[np.int_]
    exposure_s: Array
    used: Mask
    residual: Array


@dataclass(frozen=True, eq=False)
class SensorMeasurement:
    """One camera's sensor as measured; `figures` by name with their standard deviations.

    `sensor` is for linear counts: its white level is the saturation point put through `linearity`.
    """

    sensor: Sensor
    correction: PixelCorrection
    linearity: Linearity
    figures: Mapping[str, Measured]
    transfer: Transfer


def measure_sensor(dark: Iterable[Exposure], flat: Iterable[Exposure], stated: Sensor) -> SensorMeasurement:
    """Measure a sensor from dark frames and flat ones; each frame is read once.

    Both are exposure times with their frames: darks from the longest to the shortest, so that hot pixels are known,
    flats of an even and steady light from the shortest to the longest, so that saturation shows. `stated` is what the
    files say: the white level where none saturates, and a gain to begin with.
    Raises CalibrationError where there are too few frames or exposures, no light or light under the cap, only
    saturated flats, a channel without light or of another gain than the others, or light that is not steady;
    ImageError for a frame of another size or with values that are not finite.
    """
    darkness = _measure_dark(dark, stated)
    flats = _gather_flats(flat, darkness, stated)
    light_s, drift = _steady(flats, darkness.black_dn.value)
    curve = _linearity(flats, light_s, darkness)
    ptc = _fit_transfer(darkness, flats, curve)
    return _assembled(darkness, flats, light_s, drift, curve, ptc)


@dataclass(frozen=True, eq=False)
class _Dark:
    levels: list[Levels]
    black_dn: Measured
    phase_black_dn: Array  # (4,)
    offset: Spread
    slope_dn_s: Array
    slope_noise_dn2: float
    sound: Mask


def _measure_dark(dark: Iterable[Exposure], stated: Sensor) -> _Dark:
    sums, gathered = DarkSums(), list[Levels]()
    sound: Mask = np.zeros((0, 0), np.bool_)
    for exposure_s, frames in dark:
        if gathered and exposure_s >= gathered[-1].exposure_s:
            raise ImageError("dark exposures must fall from the longest to the shortest.")
        series = gather(frames, exposure_s)
        if not gathered:
            sound = _not_hot(series, stated)
        if series.mean_dn.shape != sound.shape:
            raise ImageError(f"dark frames of {series.mean_dn.shape} and of {sound.shape} pixels.")
        gathered.append(levels(series, sound))
        sums.add(series, float(gathered[-1].variance_dn2.mean()))
    if not gathered:
        raise CalibrationError("no dark frames; a sensor is measured from dark and flat ones.")
    offset, slope, (offset_noise, slope_noise) = sums.line()
    _check_capped(slope, sound, stated.gain_e_per_dn)
    black = Measured(float(offset[sound].mean()), float(np.sqrt(offset_noise / sound.sum())))
    by_phase = phase_sum(np.where(sound, offset, 0.0)) / phase_sum(sound)
    if min(by_phase) < ABOVE_ZERO * np.sqrt(gathered[-1].variance_dn2.mean()):
        raise CalibrationError(
            f"the black level, {min(by_phase):.1f} dn, is so low that noise is cut off at 0; such a sensor's noise is "
            "not in its files."
        )
    return _Dark(gathered, black, by_phase, offset_map(offset, offset_noise, sound), slope, slope_noise, sound)


def _not_hot(longest: Series, stated: Sensor) -> Mask:
    """Pixels whose dark current is one that averages and corrects well, told by the longest exposure."""
    typical = float(np.median(longest.mean_dn))
    if typical > (stated.black_dn + stated.white_dn) / 2:
        raise CalibrationError("the dark frames are bright: is the cap on the lens?")
    noise_dn2 = float(np.median(longest.scatter_dn2)) / (longest.frames - 1)
    hot_dn = HOT_E_S * longest.exposure_s / stated.gain_e_per_dn
    limit_dn = max(hot_dn, HOT_SIGMA * np.sqrt(noise_dn2 / longest.frames + 1.0))
    return np.asarray(longest.mean_dn - typical < limit_dn, np.bool_)


def _check_capped(slope_dn_s: Array, sound: Mask, gain: float) -> None:
    """Dark current is alike behind all filters; light is not, nor is it behind a lens."""
    parts = [slope_dn_s[r::2, c::2][sound[r::2, c::2]] for r, c in PHASES]
    if min(part.size for part in parts) == 0:
        raise CalibrationError("dark frames that are bright everywhere: is the cap on the lens?")
    means = np.array([part.mean() for part in parts])
    sigma = float(np.sqrt(np.mean([part.var() / part.size for part in parts])))
    apart_e_s = float(np.ptp(means)) * gain
    if np.ptp(means) > UNEVEN_DARK[0] * sigma and apart_e_s > UNEVEN_DARK[1]:
        raise CalibrationError(
            f"dark frames hold light: channels differ by {apart_e_s:.1f} electrons per second. Is the cap on the lens?"
        )


@dataclass(frozen=True, eq=False)
class _Flats:
    levels: list[Levels]
    frame_dn: list[Array]
    taken_s: list[Array]
    usable: NDArray[np.bool_]  # (series, 4)
    sums: FlatSums
    saturation_dn: float
    reached: bool


def _gather_flats(flat: Iterable[Exposure], dark: _Dark, stated: Sensor) -> _Flats:
    found, usable, sums = list[Levels](), list[NDArray[np.bool_]](), FlatSums()
    frame_dn, taken_s = list[Array](), list[Array]()
    at_rest = (dark.phase_black_dn, np.mean([one.variance_dn2 for one in dark.levels], axis=0))
    saturation_dn: float | None = None
    for exposure_s, frames in flat:
        if found and exposure_s <= found[-1].exposure_s:
            raise ImageError("flat exposures must rise from the shortest to the longest.")
        series = gather(frames, exposure_s)
        if series.mean_dn.shape != dark.sound.shape:
            raise ImageError(f"flat frames of {series.mean_dn.shape} pixels, dark ones of {dark.sound.shape}.")
        level = levels(series, dark.sound)
        usable.append(below_saturation(level, found, usable, at_rest, stated.white_dn))
        saturation_dn = saturation_point(series, dark.sound, level, found, usable, at_rest)
        sums.add(series, usable[-1])
        found.append(level)
        frame_dn.append(series.frame_dn)
        taken_s.append(series.taken_s)
    reached = saturation_dn is not None
    saturation_dn = stated.white_dn if saturation_dn is None else saturation_dn
    flats = _Flats(found, frame_dn, taken_s, np.array(usable), sums, saturation_dn, reached)
    _check_light(flats, dark)
    return flats


def _check_light(flats: _Flats, dark: _Dark) -> None:
    if not flats.levels:
        raise CalibrationError("no flat frames; a sensor is measured from dark and flat ones.")
    count = flats.usable.sum(axis=0)
    noise_dn = np.sqrt(np.mean([one.variance_dn2.mean() for one in dark.levels]))
    names = ("first", "second", "third", "fourth")
    for phase in range(4):
        lit = [
            one.level_dn[phase] - dark.black_dn.value
            for one, clear in zip(flats.levels, flats.usable, strict=True)
            if clear[phase]
        ]
        where = f"the {names[phase]} channel of the mosaic"
        if count[phase] < LEAST_FLATS:
            raise CalibrationError(
                f"{count[phase]} flat exposures of {where} are below saturation, {LEAST_FLATS} are needed; "
                "take shorter ones."
            )
        if max(lit) < LEAST_LIGHT * noise_dn:
            raise CalibrationError(f"no light in {where}: the brightest flat is {max(lit):.1f} dn over black.")


def _steady(flats: _Flats, black_dn: float) -> tuple[Array, Measured]:
    """Exposure times corrected for a light that drifts evenly, and the drift."""
    every = [(index, clear) for index, clear in enumerate(flats.usable) if clear.any()]
    drift = light_drift(
        [flats.frame_dn[index][:, clear] - black_dn for index, clear in every],
        [flats.levels[index].level_variance_dn2[clear] * flats.levels[index].frames for index, clear in every],
        [flats.taken_s[index] for index, _ in every],
    )
    exposures = np.array([one.exposure_s for one in flats.levels])
    return corrected_s(exposures, flats.taken_s, drift), Measured(drift.per_s, drift.sigma_per_s)


def _linearity(flats: _Flats, light_s: Array, dark: _Dark) -> LinearityFit:
    black = dark.black_dn
    series, phase = np.nonzero(flats.usable)
    level = np.array([one.level_dn - dark.phase_black_dn for one in flats.levels])[flats.usable]
    noise = np.array([one.level_variance_dn2 for one in flats.levels])[flats.usable]
    span_dn = flats.saturation_dn - black.value
    return fit_linearity(level, noise + 4 * black.sigma**2, light_s[series], phase, span_dn)


@dataclass(frozen=True, eq=False)
class _TransferFit:
    gain: Measured
    read_noise_e: Measured
    transfer: Transfer


def _fit_transfer(dark: _Dark, flats: _Flats, curve: LinearityFit) -> _TransferFit:
    """Weighted line through variance against linear signal, dark levels among them: slope 1 / gain, variance at 0."""
    every = [*dark.levels, *flats.levels]
    counted = np.concatenate([one.level_dn - dark.phase_black_dn for one in every])
    variance = np.concatenate([one.variance_dn2 for one in every])
    freedom = np.concatenate([one.freedom for one in every])
    used = np.concatenate([np.ones(4 * len(dark.levels), bool), flats.usable.ravel()])
    signal, steep = curve.linearity.linear_dn(counted), 1 / curve.linearity.slope(counted) ** 2
    rows = np.stack([steep * signal, np.ones_like(signal)], axis=1)
    at_zero = float(variance[: 4 * len(dark.levels)].mean())
    lit = used & (signal > 0) & (np.arange(len(used)) >= 4 * len(dark.levels))
    line = np.array([float(np.median((variance[lit] - at_zero) / signal[lit])), at_zero])
    covariance = np.eye(2)
    for _ in range(4):
        expected = np.maximum(rows @ line, QUANTISATION_DN2)
        weight = freedom / (2 * expected**2) * used
        covariance = np.linalg.inv((rows * weight[:, None]).T @ rows)
        line = covariance @ (rows.T @ (weight * variance))
    chi2 = float((weight * (variance - rows @ line) ** 2).sum()) / max(int(used.sum()) - 2, 1)
    if chi2 > 1 + 4 * np.sqrt(2 / max(int(used.sum()) - 2, 1)):
        covariance = covariance * chi2  # something else than noise: the errors grow by it
    phase = np.tile(np.arange(4), len(every))
    _check_channels(rows, variance, weight, phase, line)
    exposure = np.repeat([one.exposure_s for one in every], 4)
    residual = np.full(len(used), np.nan)
    residual[4 * len(dark.levels) :][flats.usable.ravel()] = curve.residual
    transfer = Transfer(signal, variance, rows @ line, phase, exposure, used, residual)
    return _TransferFit(*_gain_and_read_noise(line, covariance), transfer)


def _gain_and_read_noise(line: Array, covariance: Array) -> tuple[Measured, Measured]:
    slope, at_zero = line
    if slope <= 0:
        raise CalibrationError("the noise does not grow with the light: these are not raw frames of an even field.")
    gain = 1 / slope
    read_dn2 = max(at_zero - QUANTISATION_DN2, 0.0)
    read_e = gain * np.sqrt(read_dn2)
    # d read / d (slope, at zero); where rounding hides all of it, the standard deviation of the square is what is known
    step = np.array([-gain * read_e, gain / (2 * np.sqrt(max(read_dn2, 1e-12)))])
    sigma = float(np.sqrt(step @ covariance @ step)) if read_dn2 > 0 else gain * float(covariance[1, 1]) ** 0.25
    return Measured(float(gain), float(gain**2 * np.sqrt(covariance[0, 0]))), Measured(float(read_e), sigma)


def _check_channels(rows: Array, variance: Array, weight: Array, phase: NDArray[np.int_], line: Array) -> None:
    """Every channel's own slope, the variance at zero being common."""
    for one in range(4):
        mine = weight * (phase == one)
        information = float((mine * rows[:, 0] ** 2).sum())
        slope = float((mine * rows[:, 0] * (variance - line[1])).sum()) / information
        away = abs(slope / line[0] - 1)
        if away > DISAGREE[1] and abs(slope - line[0]) > DISAGREE[0] / np.sqrt(information):
            raise CalibrationError(
                f"the channels disagree: phase {one} of the mosaic has a gain {away:.1%} off the others'; "
                "is the field even, and are the frames raw?"
            )


def _assembled(
    dark: _Dark, flats: _Flats, light_s: Array, drift: Measured, curve: LinearityFit, ptc: _TransferFit
) -> SensorMeasurement:
    gain, linearity, black = ptc.gain, curve.linearity, dark.black_dn.value
    current = float(dark.slope_dn_s[dark.sound].mean())
    uneven = shrunk(dark.slope_dn_s - current, dark.slope_noise_dn2, dark.sound)
    flat, sound = _flat(dark, flats, light_s, curve, gain.value)
    white = black + float(linearity.linear_dn(flats.saturation_dn - black))
    sensor = Sensor(black, float(np.float32(white)), gain.value, ptc.read_noise_e.value)
    correction = PixelCorrection(
        offset_dn=dark.offset.values.astype(np.float32),
        dark_e_s=(gain.value * (current + uneven.values)).astype(np.float32),
        flat=np.where(sound, flat.values, 1.0).astype(np.float32),
        hot=~sound,
        dark_variance=(gain.value**2 * uneven.variance).astype(np.float32),
        flat_variance=flat.variance.astype(np.float32),
    )
    current_sigma = np.hypot(gain.value * np.sqrt(dark.slope_noise_dn2 / dark.sound.sum()), current * gain.sigma)
    figures = {
        "black_dn": dark.black_dn,
        "gain_e_per_dn": gain,
        "read_noise_e": ptc.read_noise_e,
        "dark_current_e_s": Measured(gain.value * current, float(current_sigma)),
        "saturation_dn": Measured(flats.saturation_dn, 0.0 if flats.reached else float("nan")),
        "full_well_e": Measured(gain.value * (white - black), gain.sigma * (white - black)),
        "offset_spread_dn": Measured(dark.offset.deviation, dark.offset.sigma),
        "offset_left_dn": Measured(float(np.sqrt(dark.offset.variance[dark.sound].mean())), 0.0),
        "response_spread": Measured(flat.deviation, flat.sigma),
        "nonlinearity": Measured((white - black) / (flats.saturation_dn - black) - 1, curve.deviation),
        "light_drift_per_s": drift,
        "hot_pixels": Measured(float((~sound).sum()), 0.0),
    }
    return SensorMeasurement(sensor, correction, linearity, figures, ptc.transfer)


def _flat(dark: _Dark, flats: _Flats, light_s: Array, curve: LinearityFit, gain: float) -> tuple[Spread, Mask]:
    """Relative response of the pixels, without their dark current, and which of them are sound."""
    black_dn = dark.black_dn.value + dark.offset.values
    rates = flats.sums.rates(light_s, black_dn, curve.linearity, curve.rate_dn_s)
    noise_dn2 = float(np.mean([one.variance_dn2.mean() for one in dark.levels]))
    variance = rates.relative_variance(gain, noise_dn2, dark.offset.variance)
    return flat_map(rates.rate_dn_s - float(dark.slope_dn_s[dark.sound].mean()), variance, dark.sound)
