"""Whether the light of a series of flat frames was steady, told by repeats of the same exposures."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.errors import CalibrationError

Array = NDArray[np.float64]

SIGNIFICANT = 3.0  # standard deviations from which a drift is taken out
MOST_DRIFT, MOST_FLICKER = 0.1, 0.01  # over the whole series, and from frame to frame: beyond, the light is refused


@dataclass(frozen=True, slots=True)
class Drift:
    """Relative change of the light per second with its standard deviation, and what is left from frame to frame."""

    per_s: float
    sigma_per_s: float
    flicker: float


def light_drift(level: Sequence[Array], variance: Sequence[Array], taken_s: Sequence[Array]) -> Drift:
    """A straight line in time through all frames' levels, relative to the mean of their own exposure.

    Per exposure: levels over black (n, channels) of each frame, the variance (channels,) of one, times (n,). All
    channels see the same light. Raises CalibrationError where the line leads too far or the frames scatter about it.
    """
    along, across, squares, freedom = 0.0, 0.0, 0.0, 0
    rest: list[tuple[Array, Array, float]] = []
    for levels, noise, times in zip(level, variance, taken_s, strict=True):
        mean = levels.mean(axis=0)
        weight = mean**2 / noise
        relative = ((levels / mean - 1) * weight).sum(axis=1) / weight.sum()
        away, information = times - times.mean(), float(weight.sum())
        across += information * float((away**2).sum())
        along += information * float((away * relative).sum())
        rest.append((relative, away, information))
        freedom += len(times) - 1
    slope = along / across if across > 0 else 0.0
    for relative, away, information in rest:
        squares += information * float(((relative - slope * away) ** 2).sum())
    chi2 = squares / max(freedom - 1, 1)
    precision = float(np.mean([information for *_, information in rest]))
    flicker = float(np.sqrt(max(chi2 - 1, 0.0) / precision))
    sigma = float(np.sqrt(max(chi2, 1.0) / across)) if across > 0 else 0.0
    _check(slope, flicker, taken_s)
    return Drift(slope, sigma, flicker)


def corrected_s(exposure_s: Array, taken_s: Sequence[Array], drift: Drift) -> Array:
    """Exposure times (series,) as they would be under the light of the mean moment; as given where nothing drifts."""
    if abs(drift.per_s) < SIGNIFICANT * drift.sigma_per_s:
        return exposure_s
    moments = np.array([times.mean() for times in taken_s])
    return np.asarray(exposure_s * (1 + drift.per_s * (moments - moments.mean())), np.float64)


def _check(slope: float, flicker: float, taken_s: Sequence[Array]) -> None:
    every = np.concatenate(list(taken_s))
    whole = abs(slope) * float(np.ptp(every))
    if whole > MOST_DRIFT:
        raise CalibrationError(f"the light drifts by {whole:.0%} while the flats are taken; let it warm up first.")
    if flicker > MOST_FLICKER:
        raise CalibrationError(
            f"the light flickers by {flicker:.1%} from flat to flat; use a steady supply, or longer exposures."
        )
