"""Speckle of the laser: granular light, per pixel, of which a part changes while the stripe passes.

A pixel sums some M independent speckles, which leaves the contrast 1 / sqrt(M) (Goodman, Speckle Phenomena in Optics,
2007). They change when the phases across what the pixel resolves, s, change by about a turn. The wave front of the thin
stripe is nearly plane and turns with the laser unit: on the way of one stripe's width w at the distance d by w / d, so
the phases by s w / (d lambda) turns. With w = 0.8 mm, d = 0.8 m, lambda = 650 nm and s = 0.2 to 0.5 mm that is 0.3 to
0.8: speckle decorrelates over about the stripe's width. How much of it does depends on where the unit turns about, so
both parts are given; the moving one bends the pulses of laser frames and is off unless asked for.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from simulators.chance import Key, generator
from simulators.scene import Array, Floats

MODES = 8  # waves that a pixel's moving speckle is the sum of
# Wave numbers of these waves: the quantiles of |N(0, 1)|, so that correlation falls nearly as exp(-travel^2 / 2).
WAVES: NDArray[np.float64] = ndtri(0.5 + (np.arange(MODES) + 0.5) / (2 * MODES))


@dataclass(frozen=True)
class Speckle:
    """Contrasts, up to about 0.3: `still` stays with the pixel, `moving` changes with the fan angle.

    `travel` says how far the stripe moves, in standard deviations of its profile, until the moving part's correlation
    is exp(-1/2).
    """

    still: float = 0.03
    moving: float = 0.0
    travel: float = 1.0

    def fixed(self, count: int, key: Key) -> Array:
        """Factors (n,) of the still part, one per pixel; light is never less than none."""
        return np.maximum(1 + self.still * generator(key).standard_normal(count), 0.0)

    def phases(self, count: int, key: Key) -> Floats:
        """What the moving part of each pixel belongs to (n, MODES); (n, 0) where there is no such part."""
        modes = MODES if self.moving else 0
        return generator((*key, "moving")).uniform(0, 2 * np.pi, (count, modes)).astype(np.float32)

    def passing(self, phases: Floats, widths: Array, sweep: tuple[float, float]) -> Array | float:
        """Factors (n,) of the moving part, mean over a turn of the fan plane from sweep[0] to sweep[1].

        `widths` (n,) are the stripe's standard deviations in radians. The same angles give the same factors.
        """
        if not self.moving:
            return 1.0
        start, end = (np.multiply.outer(angle / (self.travel * widths), WAVES) for angle in sweep)
        damping = np.sinc((end - start) / (2 * np.pi))
        waves = np.cos(0.5 * (start + end) + phases) * damping
        factors: Array = np.maximum(1 + self.moving * np.sqrt(2 / MODES) * waves.sum(axis=1), 0.0)
        return factors


STILL_SPECKLE = Speckle()
