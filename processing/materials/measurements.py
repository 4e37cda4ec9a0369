"""The samples of a material by direction and texel, in the form that lobes and residuals are fitted to."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.materials.phong import LobeSamples
from processing.products import BlinnPhong, ReflectanceMaps, half_vectors, sphere_normals
from processing.products.arrays import Float64


@dataclass(frozen=True, eq=False)
class Measurements:
    """Samples (direction, texel): `value` f with the cosine inside and its `variance` (..., 3), NaN = none.

    `cos_light` N.L and `cos_half` N.H are (direction, texel); `half` (direction, texel, 3) is H in the frame that the
    residual is to be fitted in.
    """

    value: Float64
    variance: Float64
    cos_light: Float64
    cos_half: Float64
    half: Float64

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Lit samples with a value and a variance, (direction, texel, 3)."""
        measured = np.isfinite(self.value) & np.isfinite(self.variance) & (self.variance > 0)
        return np.asarray(measured & (self.cos_light > 0)[..., None], np.bool_)

    def delta(self, phong: BlinnPhong) -> Float64:
        """R - f (the paper's eq. 4), NaN where there is no sample."""
        return self.value - phong.evaluate_cosines(self.cos_light, self.cos_half)

    def lobe_samples(self, model_variance: Float64) -> LobeSamples:
        """All samples in one list; `model_variance` (3,) is what the lobe cannot follow, on top of the noise."""
        return LobeSamples(
            self.value.reshape(-1, 3),
            self.cos_light.ravel(),
            self.cos_half.ravel(),
            (self.variance + model_variance).reshape(-1, 3),
        )

    def direction(self, index: int) -> "Measurements":
        """The samples of one direction."""
        one = slice(index, index + 1)
        return Measurements(
            self.value[one], self.variance[one], self.cos_light[one], self.cos_half[one], self.half[one]
        )

    def excess_variance(self, error: Float64) -> Float64:
        """Mean squared `error` (direction, texel, 3) beyond the samples' own noise, per channel, at least 0."""
        valid = self.valid
        count = np.maximum(valid.sum(axis=(0, 1)), 1)
        beyond = np.where(valid, error**2 - self.variance, 0.0).sum(axis=(0, 1)) / count
        return np.asarray(np.maximum(beyond, 0.0), np.float64)


def sphere_measurements(maps: ReflectanceMaps) -> Measurements:
    """The samples of a sphere, H in the camera frame; raises ImageError where the maps have not three channels."""
    lights, count = len(maps.reflectance_cos), maps.reflectance_cos.shape[1] ** 2
    if maps.reflectance_cos.shape[-1] != 3:
        raise ImageError(f"reflectance maps have {maps.reflectance_cos.shape[-1]} channels, an SRF has 3")
    normal = sphere_normals(maps.reflectance_cos.shape[1]).reshape(count, 3)
    light = maps.lights().reshape(lights, count, 3)
    half = half_vectors(light, maps.views().reshape(count, 3))
    return Measurements(
        maps.reflectance_cos.reshape(lights, count, 3).astype(np.float64),
        maps.variance.reshape(lights, count, 3).astype(np.float64),
        (light * normal).sum(axis=-1),
        (half * normal).sum(axis=-1),
        half,
    )
