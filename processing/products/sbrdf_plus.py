"""A BTF as lobes and shadows of the points seen from the top, shifts toward them, and clusters of hidden points."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32, Float64
from processing.products.directions import DirectionMesh
from processing.products.lafortune import LafortuneTexels
from processing.products.provenance import Provenance
from processing.products.texture import bilinear_taps

Index = NDArray[Any]

KIND = "sbrdf_plus"


@dataclass(frozen=True, eq=False)
class SbrdfPlus:
    """BTF(x, L, V) = hidden(x, V) ? centre(x, V)(L) : lobes(x', L, V) shadow(x', L) with x' = x + shift(x, V).

    `shadow` (light, y, x) in 0 to 1 is that of the view from the top; `shift` (view, y, x, 2) float32 in texels, right
    and down; `hidden` (view, y, x) tells what no view from the top sees; `cluster` (view, y, x) is its index into
    `centres` (k, light, 3), reflectance in 1/sr without the cosine. The texture repeats. Source: Chen et al., eq. 2.3.
    """

    lobes: LafortuneTexels
    shadow: Float32
    shift: Float32
    hidden: NDArray[np.bool_]
    cluster: NDArray[np.uint16]
    centres: Float32
    lights: DirectionMesh
    views: DirectionMesh
    provenance: Provenance = field(default_factory=Provenance)

    def evaluate(self, uv: Float64, light: Float64, view: Float64) -> Float64:
        """Reflectance times the cosine to the light (n, 3), for texture coordinates (n, 2) and directions (n, 3).

        Lobes are asked at the directions themselves. Shifts, shadows and centres are interpolated over the measured
        views and lights (`DirectionMesh`) and over the four texels around a point: with weights w of texels and views,
        the hidden ones' centres count w each; of the others the mean shift leads to one place, whose lobes and shadows
        count the rest. So nothing jumps while eye, light or surface move. 0 under the horizon.
        """
        rows, columns, taps = bilinear_taps(uv, *self.lobes.shape, wrap=True)
        light_index, light_weight = self.lights.weights(light)
        view_index, view_weight = self.views.weights(view)
        place = (view_index[:, :, None], rows[:, None, :], columns[:, None, :])
        weight = view_weight[:, :, None] * taps[:, None, :]
        hidden = self.hidden[place]
        seen = np.where(hidden, 0.0, weight)
        total = seen.sum(axis=(1, 2))
        shift = np.einsum("nvt,nvti->ni", seen, self.shift[place]) / np.maximum(total, 1e-12)[:, None]
        moved = uv + shift / np.array(self.lobes.shape[::-1])
        centres = self._centres(place, light_index).astype(np.float64)
        unseen = np.einsum("nvt,nl,nvtlc->nc", weight - seen, light_weight, centres)
        reflectance = total[:, None] * self._shaded(moved, light, view) + unseen
        above = (light[:, 2:] > 0) & (view[:, 2:] > 0)
        return np.where(above, reflectance * light[:, 2:], 0.0)

    def _shaded(self, uv: Float64, light: Float64, view: Float64) -> Float64:
        """Lobes times shadow (n, 3) of the points seen from the top."""
        rows, columns, taps = bilinear_taps(uv, *self.lobes.shape, wrap=True)
        index, weight = self.lights.weights(light)
        shadow = np.einsum("nl,nlt->nt", weight, self.shadow[index[:, :, None], rows[:, None, :], columns[:, None, :]])
        lobes = self.lobes.evaluate(rows, columns, light[:, None], view[:, None])
        shaded: Float64 = np.einsum("nt,nt,ntc->nc", taps, shadow, lobes)
        return shaded

    def _centres(self, place: tuple[Index, ...], lights: Index) -> Float32:
        """Centres (n, view, texel, light, 3); of points that are not hidden any, as their weight is 0."""
        if len(self.centres) == 0:
            return np.zeros((*np.broadcast_shapes(*(axis.shape for axis in place)), lights.shape[1], 3), np.float32)
        found: Float32 = self.centres[self.cluster[place][..., None], lights[:, None, None, :]]
        return found
