"""Generalised cosine lobes per texel: the SBRDF (McAllister et al. 2002) of Lafortune et al. 1997."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.products.arrays import Float32, Float64

Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class LafortuneTexels:
    """f(x, L, V) = rho_d + sum_j rho_j max(0, C_x L_x V_x + C_y L_y V_y + C_z L_z V_z)^n_j, in 1/sr without the cosine.

    `diffuse` rho_d is (y, x, 3), `axis` C (y, x, lobe, 3), `exponent` n (y, x, lobe), `albedo` rho (y, x, lobe, 3), all
    float32, in the tangent frame. The largest |C_i| of a lobe is 1, so that rho is its value at its peak and no power
    overflows; an absent lobe has C = 0, n = 1 and rho = 0.
    """

    diffuse: Float32
    axis: Float32
    exponent: Float32
    albedo: Float32

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the texels."""
        return self.diffuse.shape[0], self.diffuse.shape[1]

    @property
    def lobes(self) -> int:
        """Lobes of each texel, absent ones among them."""
        return int(self.exponent.shape[2])

    @property
    def shared(self) -> bool:
        """Whether all lobes of a texel have one C and its diffuse term is grey: what the paper's layout can hold."""
        present = self.axis.any(axis=-1, keepdims=True)
        return bool(
            (self.diffuse == self.diffuse[..., :1]).all() and (~present | (self.axis == _shared_axis(self.axis))).all()
        )

    def packed(self) -> Float32:
        """Parameters side by side (y, x, floats): 4 + 4 lobes of them where they are `shared`, else 3 + 7 lobes.

        Shared: C, rho_d, then n and rho of each lobe, the four RGBA32F textures of Chen et al. 2008. Else rho_d, then
        C, n and rho of each lobe.
        """
        lobes = [self.exponent[..., None], self.albedo]
        if self.shared:
            first = [_shared_axis(self.axis)[:, :, 0], self.diffuse[..., :1]]
        else:
            first, lobes = [self.diffuse], [self.axis, *lobes]
        each = np.concatenate(lobes, axis=-1).reshape(*self.shape, -1)
        return np.concatenate([*first, each], axis=-1)

    @classmethod
    def unpacked(cls, packed: Float32, lobes: int) -> "LafortuneTexels":
        """Inverse of `packed`; lobes without albedo are absent. Raises ImageError for another number of floats."""
        height, width, floats = packed.shape
        if floats == 3 + 7 * lobes:
            each = packed[..., 3:].reshape(height, width, lobes, 7)
            return cls(packed[..., :3], each[..., :3], each[..., 3], each[..., 4:])
        if floats != 4 + 4 * lobes:
            raise ImageError(f"{lobes} lobes have {3 + 7 * lobes} or {4 + 4 * lobes} floats a texel, not {floats}")
        each = packed[..., 4:].reshape(height, width, lobes, 4)
        axis = np.where(each[..., 1:].any(axis=-1, keepdims=True), packed[:, :, None, :3], np.float32(0))
        return cls(np.repeat(packed[..., 3:4], 3, axis=-1), axis, each[..., 0], each[..., 1:])

    def evaluate(self, rows: Index, columns: Index, light: Float64, view: Float64) -> Float64:
        """f (..., 3) of the texels at rows and columns (...), for unit vectors (..., 3); 0 under the horizon."""
        product = np.asarray(light, np.float64) * view
        axis, exponent = self.axis[rows, columns], self.exponent[rows, columns].astype(np.float64)
        base = np.maximum(np.einsum("...ji,...i->...j", axis.astype(np.float64), product), 0.0)
        lobes = np.einsum("...j,...jc->...c", base**exponent, self.albedo[rows, columns].astype(np.float64))
        above = (np.asarray(light)[..., 2:] > 0) & (np.asarray(view)[..., 2:] > 0)
        return np.where(above, self.diffuse[rows, columns] + lobes, 0.0)


def _shared_axis(axis: Float32) -> Float32:
    """C (y, x, 1, 3) of each texel's first lobe that there is."""
    if axis.shape[2] == 0:
        return np.zeros((*axis.shape[:2], 1, 3), np.float32)
    first = axis.any(axis=-1).argmax(axis=2)
    return np.take_along_axis(axis, first[:, :, None, None], axis=2)
