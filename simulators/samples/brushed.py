"""Brass turned on a lathe: fine grooves along circles, so that its highlight is drawn out across them."""

import numpy as np

from simulators.samples.noise import smooth_step
from simulators.samples.space_noise import fractal, tilted_normals
from simulators.scene import Array, Floats, Grain, Material

# Of 70 % copper and 30 % zinc, red, green and blue: from the refractive index that Querry measured (1985).
BRASS = (0.91, 0.78, 0.42)
ALONG, ACROSS = 0.30, 0.55  # roughness
# Albedo of what lies on it, and of light that goes from groove to groove: with 0.01 the body is too dark beside its
# highlights for its limb to be found from above.
DUST = 0.03
# The circles lie about the rig's y axis: its poles are at the left and right limb for the front camera and for all of
# the arc, so that none looks at a place where the grain turns about.
AXIS = np.array([0.0, 1.0, 0.0])
_STREAKS = np.array([1.5, 70.0, 1.5])  # of noise over a radius: 0.7 mm wide on a ball of 50 mm radius
_SCORED = 0.02  # slope of the streaks


def brushed(unit: Array, seed: int) -> tuple[Floats, Material]:
    """Normals (n, 3) with streaks along the circles, and the metal at unit vectors (n, 3), dulled here and there."""
    height = np.full(len(unit), _SCORED / _STREAKS.max())
    normals = tilted_normals(unit, lambda place: fractal(place * _STREAKS, seed + 40, 2), height)
    dull = smooth_step(-0.1, 0.5, fractal(unit * 2.1 + 2.3, seed + 41, 3))
    streak = fractal(unit * _STREAKS + 5.9, seed + 42, 2)
    roughness = np.column_stack([ALONG + 0.05 * dull, ACROSS + 0.05 * dull + 0.04 * streak]).astype(np.float32)
    reflectance = (np.array(BRASS) * (1 - 0.25 * dull[:, None])).astype(np.float32)
    nothing = np.zeros(len(unit), np.float32)
    material = Material(
        np.full((len(unit), 3), DUST, np.float32),
        nothing,
        nothing + 1,
        grain=Grain(_along(normals), roughness, reflectance),
    )
    return normals, material


def _along(normals: Floats) -> Floats:
    """Unit tangents (n, 3) of the circles about the axis; square to it where there is no circle."""
    tangent = np.cross(AXIS, normals)
    length = np.linalg.norm(tangent, axis=1, keepdims=True)
    at_pole = length < 1e-6
    return np.where(at_pole, [1.0, 0.0, 0.0], tangent / np.where(at_pole, 1.0, length)).astype(np.float32)
