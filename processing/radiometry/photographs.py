"""Relative radiance, with its variance, from a bracketed stack of 8-bit photographs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import log_ndtr

from processing.errors import ImageError
from processing.radiometry import photograph_kernel
from processing.radiometry.hdr import Radiance
from processing.radiometry.response import CODES, Response, exposure_errors, recover_response

Array = NDArray[np.float64]
_GRID = 2048
_BEYOND = 3.0  # log exposure that the tables reach beyond the codes
_CONTRADICTED = 0.5  # log exposure: shutters and lamps that flicker stay within
_CLEARLY = 1.5  # ratio of exposures that cannot look reversed
_END_SIGMA, _END_DN = 3.0, (3, 16)  # codes that JPEG may have moved off the ends are taken as clipped


@dataclass(frozen=True, slots=True)
class MergedPhotographs:
    """`radiance` (h, w, channels), the `response` used, and `exposure` (k,) as the pictures themselves say it."""

    radiance: Radiance
    response: Response
    exposure: Array


def merge_photographs(
    srgb8: NDArray[np.uint8],
    exposure: ArrayLike,
    response: Response | None = None,
    names: Sequence[str] = (),
) -> MergedPhotographs:
    """Relative radiance (h, w, channels) of 8-bit photographs (k, h, w, channels) by maximum likelihood.

    `exposure` (k,) is time, or time x ISO / 100 / f-number squared: the radiance that gives code 128 at exposure 1
    is 1. Without a `response` it is recovered from the stack. A code's light has the variance of its noise; codes at
    the ends count as 'at least' and 'at most' (censored), so that the result stays unbiased where an exposure leaves
    the range. `variance` is the noise's, plus the response's own error, which pixels of like codes share. A pixel
    black in every exposure is DARK, with the end of the range as its standard deviation. `names` are for errors.
    Raises ImageError where the shapes disagree, an exposure is not positive or contradicts the pictures, or the
    photographs do not determine the response and none is given.
    """
    stack, stated = _checked(srgb8, exposure, response)
    names = names or [f"picture {i + 1} of exposure {one:.4g}" for i, one in enumerate(stated)]
    order = np.argsort(stated, kind="stable")
    _check_order(stack[order], stated[order], [names[i] for i in order])
    log_error = np.zeros(len(stated))
    if response is None:
        response, log_error[order] = recover_response(stack[order], stated[order])
    elif len(stated) > 1:
        log_error = exposure_errors(stack, stated, response)
    worst = int(np.argmax(np.abs(log_error)))
    if abs(log_error[worst]) > _CONTRADICTED:
        factor = np.exp(log_error[worst])
        raise ImageError(f"{names[worst]} has {factor:.3g} times its stated exposure, say the pictures; leave it out.")
    log_exposure = np.log(stated) + log_error
    radiance = Radiance(*photograph_kernel.merge_photographs(stack, log_exposure, *merge_tables(response)))
    return MergedPhotographs(radiance, response, np.exp(log_exposure))


def merge_tables(response: Response) -> tuple[Array, Array, tuple[float, float, int], NDArray[np.int64]]:
    """Light by code (channels, 256), table by log exposure (channels, grid, 6), its grid, and the end codes.

    What a mean exposure predicts: the inverse variance of a code's light, score and information about the mean of
    'above the last code' and 'below the first one' (Tobin 1958), and the response's own standard deviation.
    """
    curves, light = response.log_exposure, response.light
    start, stop = float(curves.min()) - _BEYOND, float(curves.max()) + _BEYOND
    u = np.linspace(start, stop, _GRID)
    foot = np.clip(np.ceil(_END_SIGMA * response.coding_sigma_dn), *_END_DN).astype(np.int64)
    ends = np.stack([foot, CODES - 1 - foot], axis=1)
    tables = [_channel_table(u, response, c, ends[c]) for c in range(curves.shape[1])]
    grid = (start, (_GRID - 1) / (stop - start), _GRID)
    return np.ascontiguousarray(light.T), np.stack(tables), grid, ends


def _channel_table(u: Array, response: Response, channel: int, ends: NDArray[np.int64]) -> Array:
    curve, code = response.log_exposure[:, channel], np.arange(CODES)
    mean = np.exp(u)
    by_code = response.slope[:, channel] * response.code_sigma_dn[:, channel]
    sigma = mean * np.interp(u, curve, by_code)
    # Beyond the codes the light's noise no longer shrinks or grows with it.
    first, last = np.exp(curve[ends[0]]), np.exp(curve[-1])
    sigma = np.where(mean < first, first * by_code[ends[0]], np.where(mean > last, last * by_code[-1], sigma))
    high = np.exp(np.interp(ends[1] + 0.5, code, curve))
    low = np.exp(np.interp(ends[0] - 0.5, code, curve))
    above, below = _censored((high - mean) / sigma, sigma), _censored((mean - low) / sigma, sigma)
    systematic = np.interp(u, curve, response.log_exposure_sigma[:, channel])
    return np.stack([1 / sigma**2, above[0], above[1], -below[0], below[1], systematic], axis=1)


def _censored(excess: Array, sigma: Array) -> tuple[Array, Array]:
    """Score and information about the mean of 'beyond', that many deviations away: hazard l / sigma, l (l - a) / v."""
    hazard = np.exp(-0.5 * excess**2 - 0.5 * np.log(2 * np.pi) - log_ndtr(-excess))
    return hazard / sigma, np.maximum(hazard * (hazard - excess), 0) / sigma**2


def _checked(
    srgb8: NDArray[np.uint8], exposure: ArrayLike, response: Response | None
) -> tuple[NDArray[np.uint8], Array]:
    stack, stated = np.asarray(srgb8), np.asarray(exposure, np.float64)
    if stack.dtype != np.uint8 or stack.ndim != 4 or stated.shape != stack.shape[:1] or stack.size == 0:
        raise ImageError(
            f"photographs {stack.dtype} {stack.shape} with {stated.size} exposures; uint8 (k, h, w, channels) needed."
        )
    if not (np.isfinite(stated) & (stated > 0)).all():
        raise ImageError(f"exposures must be positive and finite, not {stated.tolist()}.")
    if response is None and len(np.unique(stated)) < 2:
        raise ImageError("photographs need two or more different exposures, or a response saved from another bracket.")
    if response is not None and response.log_exposure.shape[1] != stack.shape[-1]:
        raise ImageError(
            f"photographs of {stack.shape[-1]} channels, response of {response.log_exposure.shape[1]}: not one camera."
        )
    return stack, stated


def _check_order(stack: NDArray[np.uint8], exposure: Array, names: Sequence[str]) -> None:
    """Raises ImageError where a picture of clearly more exposure is the darker one; sorted by exposure."""
    rows, columns = (slice(None, None, max(size // 200, 1)) for size in stack.shape[1:3])
    thin = stack[:, rows, columns].astype(np.int16)
    for i in range(len(stack) - 1):
        inside = ((thin[i : i + 2] > 10) & (thin[i : i + 2] < 245)).all(axis=0)
        if exposure[i + 1] < _CLEARLY * exposure[i] or np.count_nonzero(inside) < 50:
            continue
        if np.median((thin[i + 1] - thin[i])[inside]) < 0:
            raise ImageError(
                f"{names[i + 1]} has more exposure than {names[i]} but is darker: times are swapped, or scenes differ."
            )
