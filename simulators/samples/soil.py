"""Dark, uneven ground."""

import numpy as np

from simulators.samples.bodies import terrain
from simulators.samples.mesh import Mesh
from simulators.samples.noise import band_noise, smooth_noise

POINTS = 108  # along one side


def soil(period_m: float, lowest_m: float, rng: np.random.Generator) -> Mesh:
    """One period of it, about half a millimetre from its lowest to its highest point."""
    bumps = band_noise(rng, POINTS, (3, 45), 0.6)
    heights = lowest_m + 0.00007 * (bumps - bumps.min())
    grain = smooth_noise(rng, (POINTS, POINTS), (0.5, 0.5))
    surface = np.empty((POINTS, POINTS, 5))
    surface[..., :3] = np.clip(1 + 0.25 * grain + 0.1 * bumps, 0.4, 1.8)[..., None] * [0.085, 0.058, 0.038]
    surface[..., 3:] = [0.01, 0.95]
    return terrain(heights, surface, period_m)
