"""Generalised cosine lobes per texel: the SBRDF (McAllister et al. 2002) of Lafortune et al. 1997."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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

    def evaluate(self, rows: Index, columns: Index, light: Float64, view: Float64) -> Float64:
        """f (..., 3) of the texels at rows and columns (...), for unit vectors (..., 3); 0 under the horizon."""
        product = np.asarray(light, np.float64) * view
        axis, exponent = self.axis[rows, columns], self.exponent[rows, columns].astype(np.float64)
        base = np.maximum(np.einsum("...ji,...i->...j", axis.astype(np.float64), product), 0.0)
        lobes = np.einsum("...j,...jc->...c", base**exponent, self.albedo[rows, columns].astype(np.float64))
        above = (np.asarray(light)[..., 2:] > 0) & (np.asarray(view)[..., 2:] > 0)
        return np.where(above, self.diffuse[rows, columns] + lobes, 0.0)
