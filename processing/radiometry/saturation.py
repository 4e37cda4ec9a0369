"""Where a sensor saturates: its converter at one code, or its pixels at full wells that differ a little."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from processing.radiometry.frame_series import PHASES, Levels, Mask, Series

Array = NDArray[np.float64]

CLEAR = 4.0  # standard deviations between a level that is used and the highest code
LEAST_GROWTH = 0.85  # of a level over what shorter exposures promise; light that drifts may fall by a tenth
LEAST_NOISE = 0.7  # of the variance over what lower levels promise; pixels that saturate have none
COLLAPSED = 0.1  # the same, of a level that is saturated as a whole
TRUSTED = 5.0  # dark standard deviations over black from which a level promises anything
EARLIEST = 0.01  # quantile of the pixels' full wells that counts as the saturation of all


def below_saturation(
    level: Levels,
    before: Sequence[Levels],
    clear: Sequence[NDArray[np.bool_]],
    dark: tuple[Array, Array],
    white_dn: float,
) -> NDArray[np.bool_]:
    """Which phases (4,) of an exposure can be used, given the shorter ones `before` and whether they were `clear`.

    All samples lie under the highest code `white_dn`, and level and variance go on as they did: a full well that is
    reached before the highest code shows in both. `dark` are black level and variance (4,) without light.
    """
    clip_dn = level.brightest_dn + CLEAR * np.sqrt(np.maximum(level.variance_dn2, 0.0))
    usable: NDArray[np.bool_] = clip_dn < white_dn - 0.5
    if clear:
        usable &= clear[-1]
    promised, noise_dn2 = _promised(level.exposure_s, before, clear, dark)
    with np.errstate(invalid="ignore"):  # NaN promises nothing
        usable &= ~((level.level_dn - dark[0]) < LEAST_GROWTH * promised) & ~(
            level.variance_dn2 < LEAST_NOISE * noise_dn2
        )
    return usable


def saturation_point(
    longest: Series, sound: Mask, level: Levels, before: Sequence[Levels], clear: Sequence[NDArray[np.bool_]],
    dark: tuple[Array, Array],
) -> float | None:  # fmt: skip
    """The code from which on samples are saturated, from the longest exposure; None where it saturates no channel.

    A saturated channel has lost the noise of its light. Where its pixels stand at different codes, it is that of the
    lowest hundredth, less what read noise may take off it.
    """
    _, noise_dn2 = _promised(level.exposure_s, before, clear, dark)
    found = []
    for phase, (row, column) in enumerate(PHASES):
        if clear[-1][phase] or not level.variance_dn2[phase] < COLLAPSED * noise_dn2[phase]:
            continue
        part = np.s_[row::2, column::2]
        wells = longest.mean_dn[part][sound[part]]
        found.append(float(np.quantile(wells, EARLIEST) - CLEAR * np.sqrt(max(level.variance_dn2[phase], 0.0))))
    return float(np.floor(min(found))) if found else None


def _promised(
    exposure_s: float, before: Sequence[Levels], clear: Sequence[NDArray[np.bool_]], dark: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Level over black and variance (4,) as the usable shorter exposures promise them; NaN where they promise none."""
    black_dn, dark_dn2 = dark
    signal, time, noise = (np.zeros(4) for _ in range(3))
    for one, usable in zip(before, clear, strict=False):
        lit = usable & (one.level_dn - black_dn > TRUSTED * np.sqrt(dark_dn2))
        signal += np.where(lit, one.level_dn - black_dn, 0.0)
        time += np.where(lit, one.exposure_s, 0.0)
        noise += np.where(lit, one.variance_dn2 - dark_dn2, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        promised = signal / time * exposure_s
        return promised, dark_dn2 + noise / signal * promised
