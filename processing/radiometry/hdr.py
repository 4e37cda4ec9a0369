"""High dynamic range: one radiance image, with its variance, from a bracketed stack."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from processing.errors import ImageError
from processing.radiometry import merge_kernel
from processing.radiometry.sensor import PixelCorrection, Sensor


class PixelStatus(IntEnum):
    """What a pixel of a merged image is."""

    OK = merge_kernel.OK  # measured
    SATURATED = merge_kernel.SATURATED  # saturated in every exposure: value NaN
    DARK = merge_kernel.DARK  # measured, but under three standard deviations: no signal above the noise
    MISSING = merge_kernel.MISSING  # no finite sample: value NaN
    HOT = merge_kernel.HOT  # a defect of the sensor: value NaN


@dataclass(frozen=True, slots=True)
class Radiance:
    """A merged image: `value` float32, `variance` its square's unit, both NaN where `status` says why; equal shapes."""

    value: NDArray[np.float32]
    variance: NDArray[np.float32]
    status: NDArray[np.uint8]

    def count(self, status: PixelStatus) -> int:
        """Number of pixels with this status."""
        return int(np.count_nonzero(self.status == status))


def merge_exposures(
    raw_dn: NDArray[np.generic], exposure_s: ArrayLike, sensor: Sensor, correction: PixelCorrection | None = None
) -> Radiance:
    """Maximum-likelihood radiance of a stack (k, h, w) of raw counts under shot and read noise.

    A sample y of exposure t has mean r t and variance v = r t + read variance, and counts as Poisson shifted by the
    read variance: its score is t (y - r t) / v. A saturated sample counts as 'at least the white level' (censored),
    so that the result stays unbiased where an exposure switches off. Negative values are kept. `value` is in
    electrons per second, `variance` is the inverse of the information at the optimum. Non-finite samples are left
    out, positive infinity is saturated. With a `correction` the value is that of the nominal pixel.
    Source: Granados et al. 2010, eq. 6, with the censoring of Tobin 1958; solved by Fisher scoring.
    Raises ImageError where the stack's shape and the exposures disagree or a time is not positive.
    """
    stack, times = _checked(raw_dn, exposure_s)
    numbers = (sensor.black_dn, sensor.white_dn, sensor.gain_e_per_dn, sensor.dark_variance_e2)
    if correction is None:
        return Radiance(*merge_kernel.merge_exposures(stack, times, numbers, None))
    if correction.flat.shape != stack.shape[1:]:
        raise ImageError(f"correction of {correction.flat.shape} pixels for frames of {stack.shape[1:]}.")
    return _corrected(*merge_kernel.merge_exposures(stack, times, numbers, correction.offset_dn), correction)


def _corrected(
    rate: NDArray[np.float32], rate_variance: NDArray[np.float32], status: NDArray[np.uint8], pixels: PixelCorrection
) -> Radiance:
    """Radiance of the nominal pixel from the rate of the real one: r = (rate - dark) / flat."""
    with np.errstate(invalid="ignore", divide="ignore"):
        value = (rate - pixels.dark_e_s) / pixels.flat
        variance = rate_variance + (0.0 if pixels.dark_variance is None else pixels.dark_variance)
        variance = variance + value**2 * (0.0 if pixels.flat_variance is None else pixels.flat_variance)
        variance = variance / pixels.flat**2
        status[np.isfinite(rate)] = PixelStatus.OK
        status[value < 3 * np.sqrt(variance)] = PixelStatus.DARK
    value[pixels.hot], variance[pixels.hot], status[pixels.hot] = np.nan, np.nan, PixelStatus.HOT
    return Radiance(value.astype(np.float32), variance.astype(np.float32), status)


def _checked(raw_dn: NDArray[np.generic], exposure_s: ArrayLike) -> tuple[NDArray[np.generic], NDArray[np.float64]]:
    stack, times = np.asarray(raw_dn), np.asarray(exposure_s, np.float64)
    if stack.ndim != 3 or times.shape != stack.shape[:1] or stack.shape[0] == 0:
        raise ImageError(f"stack of shape {stack.shape} with {times.size} exposure times; (k, h, w) and k are needed.")
    if not (np.isfinite(times) & (times > 0)).all():
        raise ImageError(f"exposure times must be positive and finite, not {times.tolist()} s.")
    return (stack if stack.dtype == np.uint16 else stack.astype(np.float32)), times
