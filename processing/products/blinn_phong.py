"""The Blinn-Phong lobe: one set of parameters for a whole material."""

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
        value = np.maximum(cos_light, 0.0)[..., None] * self.diffuse + lobe[..., None] * self.specular
        return np.where((cos_light > 0)[..., None], value, 0.0)

    def as_dict(self) -> dict[str, object]:
        """The parameters as JSON values."""
        return {
            "diffuse": [float(k) for k in self.diffuse],
            "specular": [float(k) for k in self.specular],
            "exponent": float(self.exponent),
        }

    @classmethod
    def from_dict(cls, values: dict[str, object]) -> "BlinnPhong":
        """The lobe that `as_dict` wrote down."""
        return cls(
            np.asarray(values["diffuse"], np.float64),
            np.asarray(values["specular"], np.float64),
            float(str(values["exponent"])),
        )
