"""The Blinn-Phong lobe, round or drawn out: one set of parameters for a whole material."""

from dataclasses import dataclass

import numpy as np

from processing.products.arrays import Float64


def half_vectors(light: Float64, view: Float64) -> Float64:
    """H = (L + V) / |L + V|, (n, 3); zero where light and view are opposite."""
    total = np.asarray(light, np.float64) + view
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    half: Float64 = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    return half


@dataclass(frozen=True, slots=True, eq=False)
class BlinnPhong:
    """f = k_d (N.L) + k_s (N.H)^n where N.L > 0, else 0: radiance for unit irradiance at normal incidence.

    The cosine to the light is inside f. `diffuse` k_d and `specular` k_s are (3,), not negative, in 1/sr.
    Source: Ma et al. 2004, eq. 3, whose cos^n(N.H) means (N.H)^n.
    """

    diffuse: Float64
    specular: Float64
    exponent: float

    def evaluate(self, light: Float64, view: Float64) -> Float64:
        """f for unit directions (n, 3) away from the surface, in the tangent frame (normal = +z); (n, 3)."""
        cos_half = half_vectors(light, view)[:, 2]
        return self.evaluate_cosines(np.asarray(light, np.float64)[:, 2], cos_half)

    def evaluate_cosines(self, cos_light: Float64, cos_half: Float64) -> Float64:
        """f for N.L and N.H of any one shape; the three channels are the last axis of the result."""
        lobe = np.maximum(cos_half, 0.0) ** self.exponent
        return _lit(cos_light, lobe, self)

    def as_dict(self) -> dict[str, object]:
        """The parameters as JSON values."""
        return {
            "diffuse": [float(k) for k in self.diffuse],
            "specular": [float(k) for k in self.specular],
            "exponent": float(self.exponent),
        }


@dataclass(frozen=True, slots=True, eq=False)
class AnisotropicPhong:
    """Blinn-Phong whose exponent turns with H: n_u cos^2 + n_v sin^2 of the azimuth of H about the normal.

    `exponents` (n_u, n_v) hold along the axes that lie `turn_rad` from t toward b, and across them; else as
    `BlinnPhong`, which equal exponents give. Source: Ashikhmin and Shirley 2000, eq. 4, without its Fresnel factor.
    """

    diffuse: Float64
    specular: Float64
    exponents: Float64
    turn_rad: float

    def evaluate(self, light: Float64, view: Float64) -> Float64:
        """f for unit directions (n, 3) away from the surface, in the tangent frame (normal = +z); (n, 3)."""
        half = half_vectors(light, view)
        c, s = np.cos(self.turn_rad), np.sin(self.turn_rad)
        squares = np.stack([c * half[:, 0] + s * half[:, 1], c * half[:, 1] - s * half[:, 0]]) ** 2
        total = squares.sum(axis=0)
        exponent = np.divide(self.exponents @ squares, total, out=np.zeros(len(half)), where=total > 0)
        return _lit(np.asarray(light, np.float64)[:, 2], np.maximum(half[:, 2], 0.0) ** exponent, self)

    def as_dict(self) -> dict[str, object]:
        """The parameters as JSON values."""
        return {
            "diffuse": [float(k) for k in self.diffuse],
            "specular": [float(k) for k in self.specular],
            "exponents": [float(n) for n in self.exponents],
            "turn_rad": float(self.turn_rad),
        }


Lobe = BlinnPhong | AnisotropicPhong


def lobe_from_dict(values: dict[str, object]) -> Lobe:
    """The lobe of either kind that its `as_dict` wrote down."""
    diffuse, specular = (np.asarray(values[name], np.float64) for name in ("diffuse", "specular"))
    if "exponents" in values:
        exponents = np.asarray(values["exponents"], np.float64)
        return AnisotropicPhong(diffuse, specular, exponents, float(str(values["turn_rad"])))
    return BlinnPhong(diffuse, specular, float(str(values["exponent"])))


def _lit(cos_light: Float64, power: Float64, lobe: Lobe) -> Float64:
    """k_d (N.L) + k_s power, the channels as the last axis; 0 where the light is under the horizon."""
    value = np.maximum(cos_light, 0.0)[..., None] * lobe.diffuse + power[..., None] * lobe.specular
    return np.where((cos_light > 0)[..., None], value, 0.0)
