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
    read variance: its score is t (y - r t) / v. A saturated sample counts as 'at least the white level' (censored), so
    that none is rejected for its own noise; negative values are kept. `value` is in electrons per second and solves
    the likelihood to 0.01 of its standard deviation (typically 0.0005), `variance` is the inverse of the information
    there, to 1 %. Within three deviations of an exposure's saturation the likelihood itself leans upward: by 0.2 %
    where exposures lie a factor of three apart, 1 % where 16, 2.4 % where 60, always under half a deviation.
    Exposures come in any order, equal times are welcome. Non-finite samples are left out, positive infinity is
    saturated. With a `correction` the value is that of the nominal pixel. Whole counts are fastest as uint16; all
    else is taken as float32.
    Source: Granados et al. 2010, eq. 6, with the censoring of Tobin 1958; solved by Fisher scoring.
    Raises ImageError where the stack's shape and the exposures disagree or a time is not positive.
    """
    stack, times = _checked(raw_dn, exposure_s)
    if correction is not None and correction.flat.shape != stack.shape[1:]:
        raise ImageError(f"correction of {correction.flat.shape} pixels for frames of {stack.shape[1:]}.")
    shape = stack.shape[1:]
    merged = Radiance(np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.uint8))
    out = merge_kernel.Merged(merged.value.reshape(-1), merged.variance.reshape(-1), merged.status.reshape(-1))
    maps = None if correction is None else _maps(correction)
    merge_kernel.merge_pixels(
        stack.reshape(len(stack), -1), _exposures(times, sensor), _levels(times, sensor), maps, out
    )
    return merged


def _exposures(times: NDArray[np.float64], sensor: Sensor) -> merge_kernel.Exposures:
    index = np.argsort(-times, kind="stable")
    share = times[index] / times.max()
    dark_variance_dn2 = sensor.dark_variance_e2 / sensor.gain_e_per_dn**2
    return merge_kernel.Exposures(index, share.astype(np.float32), (dark_variance_dn2 / share).astype(np.float32))


def _levels(times: NDArray[np.float64], sensor: Sensor) -> merge_kernel.Levels:
    gain = sensor.gain_e_per_dn
    levels = (sensor.black_dn, sensor.white_dn, sensor.white_dn - 0.5)
    noise = (1 / gain, sensor.dark_variance_e2 / gain**2)
    return merge_kernel.Levels(*map(np.float32, (*levels, *noise, gain / times.max())))


def _maps(correction: PixelCorrection) -> merge_kernel.PixelMaps:
    """Maps as the kernel reads them; a variance that is not known counts as none."""
    floats = (correction.offset_dn, correction.dark_e_s, correction.flat)
    offset, dark, flat = (np.ascontiguousarray(m, np.float32).reshape(-1) for m in floats)
    none = np.zeros(merge_kernel.BLOCK_PX, np.float32)
    variances = (
        none if m is None else np.ascontiguousarray(m, np.float32).reshape(-1)
        for m in (correction.dark_variance, correction.flat_variance)
    )
    return merge_kernel.PixelMaps(offset, dark, flat, np.ascontiguousarray(correction.hot).reshape(-1), *variances)


def _checked(raw_dn: NDArray[np.generic], exposure_s: ArrayLike) -> tuple[NDArray[np.generic], NDArray[np.float64]]:
    stack, times = np.asarray(raw_dn), np.asarray(exposure_s, np.float64)
    if stack.ndim != 3 or times.shape != stack.shape[:1] or stack.shape[0] == 0:
        raise ImageError(f"stack of shape {stack.shape} with {times.size} exposure times; (k, h, w) and k are needed.")
    if not (np.isfinite(times) & (times > 0)).all():
        raise ImageError(f"exposure times must be positive and finite, not {times.tolist()} s.")
    if stack.dtype.kind not in "uif":
        raise ImageError(f"counts of type {stack.dtype}; whole or real numbers are needed.")
    return np.ascontiguousarray(stack, np.uint16 if stack.dtype == np.uint16 else np.float32), times
