"""The functions of light and view whose weighted sum is the residual of a texel."""

from enum import StrEnum

import numpy as np

from processing.products.arrays import Float64
from processing.products.blinn_phong import half_vectors


class ResidualBasis(StrEnum):
    """What a texel's residual is a linear combination of, in the tangent frame."""

    HALF = "half"  # H: the paper's s . H
    HALF_LIGHT = "half_light"  # H, L_z, 1
    BIQUADRATIC = "biquadratic"  # 1, L_x, L_y, L_x^2, L_x L_y, L_y^2: a polynomial texture map's
    HEMISPHERICAL = "hemispherical"  # nine hemispherical harmonics of L
    BILINEAR = "bilinear"  # L_i V_j: what masks, shadows and shifts a relief from one view to the next

    @property
    def names(self) -> tuple[str, ...]:
        """One name for each function, in the order of `evaluate`."""
        return _NAMES[self]

    @property
    def size(self) -> int:
        """Number of functions."""
        return len(self.names)

    def evaluate(self, light: Float64, view: Float64) -> Float64:
        """Values (n, size) for unit directions (n, 3) away from the surface, in the tangent frame (normal = +z)."""
        light = np.asarray(light, np.float64)
        one = np.ones(len(light))
        x, y, z = light.T
        match self:
            case ResidualBasis.HALF:
                return half_vectors(light, view)
            case ResidualBasis.HALF_LIGHT:
                return np.column_stack([half_vectors(light, view), z, one])
            case ResidualBasis.BIQUADRATIC:
                return np.column_stack([one, x, y, x * x, x * y, y * y])
            case ResidualBasis.HEMISPHERICAL:
                return _hemispherical(light)
            case ResidualBasis.BILINEAR:
                return (light[:, :, None] * np.asarray(view, np.float64)[:, None, :]).reshape(-1, 9)


_NAMES = {
    ResidualBasis.HALF: ("H.t", "H.b", "H.n"),
    ResidualBasis.HALF_LIGHT: ("H.t", "H.b", "H.n", "L.n", "1"),
    ResidualBasis.BIQUADRATIC: ("1", "L.t", "L.b", "L.tt", "L.tb", "L.bb"),
    ResidualBasis.HEMISPHERICAL: ("00", "1-1", "10", "11", "2-2", "2-1", "20", "21", "22"),
    ResidualBasis.BILINEAR: tuple(f"LV.{light}{view}" for light in "tbn" for view in "tbn"),
}


def _hemispherical(light: Float64) -> Float64:
    """Hemispherical harmonics up to l = 2, orthonormal over the upper half; (n, 9) in the order l, m = -l to l.

    Real spherical harmonics of 2 cos(theta) - 1 in place of cos(theta), so that all but the m = 0 ones vanish straight
    above and at the horizon. Source: Gautron et al. 2004, 3.1.
    """
    cosine = np.clip(light[:, 2], 0.0, 1.0)
    level = np.hypot(light[:, 0], light[:, 1])
    across = np.divide(light[:, :2], level[:, None], out=np.zeros((len(light), 2)), where=level[:, None] > 0)
    c, s = across.T
    x = 2 * cosine - 1
    root = 2 * np.sqrt(cosine * (1 - cosine))  # sqrt(1 - x^2)
    about = np.sqrt(1 / (2 * np.pi))
    first, second = np.sqrt(3.0), np.sqrt(15.0)
    functions = np.column_stack([
        np.ones_like(x),
        first * root * s, first * x, first * root * c,
        second * root**2 * c * s, second * x * root * s, np.sqrt(5.0) * (1.5 * x * x - 0.5), second * x * root * c,
        0.5 * second * root**2 * (c * c - s * s),
    ])  # fmt: skip
    return np.asarray(about * functions, np.float64)
