"""Relative radiance, with its variance, from a bracketed stack of 8-bit photographs."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from processing.errors import ImageError
from processing.radiometry.hdr import PixelStatus, Radiance
from processing.radiometry.response import FOOT, Response, code_weight, recover_response


def merge_photographs(srgb8: NDArray[np.uint8], exposure_s: ArrayLike) -> tuple[Radiance, Response]:
    """Relative radiance (h, w, 3) of 8-bit photographs (k, h, w, 3) with an unknown response, and that response.

    Each sample R(code) / time weighs by the inverse of its variance, the noise of a code times the slope of the
    response, and not at all where clipped. Unit: the radiance that gives code 128 in one second is 1. A pixel under
    the foot of the curve in its longest unclipped exposure is DARK, with the foot as its standard deviation.
    Source: Debevec and Malik 1997, eq. 6, with weights by variance. Raises ImageError where the shapes disagree,
    two times are equal or the photographs do not overlap.
    """
    stack, times = np.asarray(srgb8), np.asarray(exposure_s, np.float64)
    if stack.dtype != np.uint8 or stack.ndim != 4 or times.shape != stack.shape[:1]:
        raise ImageError(f"photographs {stack.dtype} {stack.shape} with {times.size} times; uint8 (k, h, w, 3) needed.")
    if len(times) < 2 or len(np.unique(times)) < len(times) or not (np.isfinite(times) & (times > 0)).all():
        raise ImageError(f"photographs need two or more different, positive exposure times, not {times.tolist()} s.")
    order = np.argsort(times)
    response = recover_response(stack[order], times[order])
    return _weighted_mean(stack, times, order, response), response


def _weighted_mean(
    stack: NDArray[np.uint8], times: NDArray[np.float64], order: NDArray[np.intp], response: Response
) -> Radiance:
    """Each frame is read once, through tables by code; `order` goes from the shortest time to the longest."""
    light = np.exp(response.log_exposure)
    sigma = light * response.slope * response.code_sigma_dn
    trust = code_weight()
    code = np.arange(len(light))
    total, mean, spread, foot, foot_sigma = (np.zeros(stack.shape[1:], np.float32) for _ in range(5))
    for i in order:
        variance = (sigma / times[i]) ** 2
        weight = trust / variance
        frame = stack[i]
        total += weight.astype(np.float32)[frame]
        mean += (weight * light / times[i]).astype(np.float32)[frame]
        spread += (weight**2 * variance).astype(np.float32)[frame]
        low = (code < FOOT)[frame]
        foot[low] = (light / times[i]).astype(np.float32)[frame[low]]
        foot_sigma[low] = light[FOOT] / times[i]
    with np.errstate(invalid="ignore", divide="ignore"):
        value, variance32 = mean / total, spread / total**2
    under = (total == 0) & (foot_sigma > 0)
    value[under], variance32[under] = foot[under], foot_sigma[under] ** 2
    status = np.where(value**2 < 9 * variance32, PixelStatus.DARK, PixelStatus.OK).astype(np.uint8)
    status[np.isnan(value)] = PixelStatus.SATURATED
    return Radiance(value, variance32, status)
