"""A picture whose pixels are functions of the light's direction: what PTM and RTI files hold."""

from dataclasses import dataclass

import numpy as np

from processing.errors import ImageError
from processing.products.arrays import Float32, Float64
from processing.products.residual_basis import ResidualBasis

BASES = (ResidualBasis.BIQUADRATIC, ResidualBasis.HEMISPHERICAL)
_HEIGHTS, _AZIMUTHS = 64, 16  # products go up to the fourth harmonic of the azimuth
_ELSEWHERE = 0.01
_OVERHEAD = np.array([[0.0, 0.0, 1.0]])  # these bases do not look at the view


@dataclass(frozen=True, eq=False)
class RelightableImage:
    """Display values: the sum over k of `coefficients` (k, y, x, channel) float32 times function k of `basis`.

    Display values are sRGB encoded, 0 to 1; the functions are of the light's direction alone, in the frame of
    `LightStack`: x right, y up the picture (row 0 is the top), z toward the camera. Three channels are R, G, B; a
    single one is the luminance that multiplies `colour` (y, x, 3) float32 (a PTM of format LRGB). `lights` (n, 3) are
    the directions that it was fitted to, where they are known: between them it is measured, far from them a guess.
    Source: Malzbender et al. 2001, eqs. 4 and 5 (biquadratic); Gautron et al. 2004 (hemispherical harmonics).
    Raises ImageError where the shapes do not belong together or the basis depends on the view.
    """

    coefficients: Float32
    basis: ResidualBasis
    colour: Float32 | None = None
    lights: Float64 | None = None

    def __post_init__(self) -> None:
        if self.basis not in BASES:
            raise ImageError(f"a relightable image is over {' or '.join(BASES)}, not {self.basis}")
        shape, channels = self.coefficients.shape, 3 if self.colour is None else 1
        if len(shape) != 4 or shape[::3] != (self.basis.size, channels):
            raise ImageError(f"coefficients over {self.basis} are ({self.basis.size}, y, x, {channels}), not {shape}")
        if self.colour is not None and self.colour.shape != (*shape[1:3], 3):
            raise ImageError(f"a colour of {self.colour.shape} does not belong to coefficients of {shape}")

    def evaluate(self, light: Float64) -> Float32:
        """The picture (y, x, 3) under one light (3,), a unit vector; not clipped to 0 and 1."""
        functions = evaluate_basis(self.basis, np.asarray(light, np.float64)[None])[0].astype(np.float32)
        picture = np.tensordot(functions, self.coefficients, 1)
        return np.asarray(picture if self.colour is None else picture * self.colour, np.float32)


def evaluate_basis(basis: ResidualBasis, lights: Float64) -> Float64:
    """Values (n, k) of a basis of the light alone for unit directions (n, 3)."""
    return basis.evaluate(lights, np.broadcast_to(_OVERHEAD, lights.shape))


def metric(basis: ResidualBasis, lights: Float64 | None = None) -> Float64:
    """Mean products (k, k) of the basis' functions: coefficients c make a mean squared picture of c @ metric @ c.

    The mean is over `lights` and, so that no direction counts for nothing, to a hundredth over the whole hemisphere;
    without lights it is over that alone.
    """
    cosines = (np.arange(_HEIGHTS) + 0.5) / _HEIGHTS  # equal heights are equal solid angles
    cosine, azimuth = np.meshgrid(cosines, np.arange(_AZIMUTHS) * (2 * np.pi / _AZIMUTHS))
    sine = np.sqrt(1 - cosine**2)
    everywhere = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine], axis=-1).reshape(-1, 3)
    if lights is None:
        return _mean_products(basis, everywhere)
    return (1 - _ELSEWHERE) * _mean_products(basis, lights) + _ELSEWHERE * _mean_products(basis, everywhere)


def _mean_products(basis: ResidualBasis, lights: Float64) -> Float64:
    functions = evaluate_basis(basis, lights)
    return np.asarray(functions.T @ functions / len(functions), np.float64)
