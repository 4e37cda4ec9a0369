"""White balance from a patch of the picture that is known to be grey."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.radiometry.hdr import PixelStatus, Radiance
from processing.robust import TUKEY, biweight, bulk_deviation

_LEAST_PX = 16
_LOST, _DARK = 0.02, 0.1  # share of pixels without value, or in the dark, that is still an accident
_UNEVEN = 0.1  # relative spread beyond the noise: shading and texture that a grey card does not have


@dataclass(frozen=True, slots=True)
class GreyPatch:
    """Pixels `left top width height`, and what red, green and blue are multiplied with; green 1, with deviations."""

    box_px: tuple[int, int, int, int]
    multipliers: NDArray[np.float64]
    sigma: NDArray[np.float64]


def measure_grey_patch(radiance: Radiance, box_px: tuple[int, int, int, int]) -> GreyPatch:
    """Multipliers that make the patch of a linear image (h, w, 3) grey, by a robust mean of its channels.

    Raises ImageError where the patch leaves the picture, is small, saturated, dark or uneven.
    """
    left, top, width, height = box_px
    rows, columns = radiance.status.shape[:2]
    name = f"grey patch {left},{top},{width},{height}"
    if min(left, top) < 0 or left + width > columns or top + height > rows or min(width, height) < 1:
        raise ImageError(f"{name} leaves the picture of {columns} x {rows} pixels.")
    if width * height < _LEAST_PX:
        raise ImageError(f"{name} has {width * height} pixels; at least {_LEAST_PX} are needed.")
    patch = np.s_[top : top + height, left : left + width]
    _check_status(name, radiance.status[patch])
    value, variance = (plane[patch].reshape(-1, 3).astype(np.float64) for plane in (radiance.value, radiance.variance))
    known = np.isfinite(value).all(axis=1)
    means = [_mean(name, value[known, c], variance[known, c]) for c in range(3)]
    level, sigma = np.array([mean[0] for mean in means]), np.array([mean[1] for mean in means])
    multipliers = level[1] / level
    relative = np.hypot(sigma / level, sigma[1] / level[1])
    relative[1] = 0
    return GreyPatch(box_px, multipliers, multipliers * relative)


def _check_status(name: str, status: NDArray[np.uint8]) -> None:
    saturated = float(np.mean((status == PixelStatus.SATURATED).any(axis=-1)))
    if saturated > _LOST:
        raise ImageError(f"{name}: {saturated:.0%} of it is saturated in every exposure; take a shorter one too.")
    lost = float(np.mean(((status == PixelStatus.MISSING) | (status == PixelStatus.HOT)).any(axis=-1)))
    if lost > _LOST:
        raise ImageError(f"{name}: {lost:.0%} of it has no value; choose another patch.")
    dark = float(np.mean((status == PixelStatus.DARK).any(axis=-1)))
    if dark > _DARK:
        raise ImageError(f"{name}: {dark:.0%} of it is dark, no signal above the noise; light it, or expose longer.")


def _mean(name: str, value: NDArray[np.float64], variance: NDArray[np.float64]) -> tuple[float, float]:
    """Robust mean of a channel and its standard deviation."""
    middle = float(np.median(value))
    if middle <= 0:
        raise ImageError(f"{name}: no light in one of the channels; choose another patch.")
    spread = max(bulk_deviation(value - middle), 1e-12 * middle)
    excess = np.sqrt(max(spread**2 - float(np.median(variance)), 0.0)) / middle
    if excess > _UNEVEN:
        raise ImageError(f"{name}: uneven, it varies by {excess:.0%}; choose a plain grey card in even light.")
    weight = biweight(value - middle, spread)
    mean = float(weight @ value / weight.sum())
    u2 = (value - mean) ** 2 / (TUKEY * spread) ** 2
    steepness = np.where(u2 < 1, (1 - u2) * (1 - 5 * u2), 0).sum()  # of an M-estimator: Huber 1964
    return mean, float(np.sqrt(weight**2 @ (value - mean) ** 2) / max(steepness, 1.0))
