"""A bidirectional texture function as a short sum of products: maps over light and texel, times weights over view."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from processing.products.arrays import Float32, Float64
from processing.products.directions import DirectionMesh
from processing.products.provenance import Provenance, read_arrays, read_description, write_description
from processing.products.texture import bilinear_taps

KIND = "factored_btf"


@dataclass(frozen=True, eq=False)
class FactoredBtf:
    """BTF(x, y, L, V) = sum_k E_k(x, y, L) W_k(V): reflectance in 1/sr, without the cosine.

    `eigenmaps` (k, light, y, x, channel) and `weights` (k, view) are float32; `lights` and `views` interpolate
    between the measured directions, in the sample frame.
    """

    eigenmaps: Float32
    weights: Float32
    lights: DirectionMesh
    views: DirectionMesh
    provenance: Provenance = field(default_factory=Provenance)

    def evaluate(self, uv: Float64, light: Float64, view: Float64) -> Float64:
        """Reflectance (n, channel) for texture coordinates (n, 2), which repeat, and directions (n, 3)."""
        rows, columns, taps = bilinear_taps(uv, self.eigenmaps.shape[2], self.eigenmaps.shape[3], wrap=True)
        light_index, light_weight = self.lights.weights(light)
        view_index, view_weight = self.views.weights(view)
        total = np.zeros((len(uv), self.eigenmaps.shape[4]))
        for eigenmap, weight in zip(self.eigenmaps, self.weights, strict=True):
            texel = eigenmap[light_index[:, :, None], rows[:, None, :], columns[:, None, :]].astype(np.float64)
            lit = np.einsum("nj,nt,njtc->nc", light_weight, taps, texel)
            total += lit * (view_weight * weight[view_index]).sum(axis=1, keepdims=True)
        return total

    @cached_property
    def ambient_maps(self) -> Float64:
        """Each eigenmap times the cosine, integrated over the lights and divided by pi, (k, y, x, channel)."""
        return np.asarray(np.tensordot(self.lights.cosine_shares, self.eigenmaps.astype(np.float64), axes=(0, 1)))

    def ambient(self, uv: Float64, view: Float64) -> Float64:
        """Radiance (n, channel) toward `view` (n, 3) for unit irradiance that comes equally from everywhere.

        L_a of Wang et al. 2005 with the cosine, over pi: of a matt surface it is the reflectance.
        """
        rows, columns, taps = bilinear_taps(uv, self.eigenmaps.shape[2], self.eigenmaps.shape[3], wrap=True)
        view_index, view_weight = self.views.weights(view)
        weight = np.einsum("nj,knj->nk", view_weight, self.weights[:, view_index])
        return np.asarray(np.einsum("nk,nt,kntc->nc", weight, taps, self.ambient_maps[:, rows, columns]))

    def save(self, folder: Path) -> None:
        """Write factors.npz and product.json into `folder`, which is made."""
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(
            folder / "factors.npz",
            eigenmaps=self.eigenmaps,
            weights=self.weights,
            light_directions=self.lights.directions,
            view_directions=self.views.directions,
        )
        content = {"file": "factors.npz", "rank": len(self.weights), "axes": "k light y x channel"}
        write_description(folder, KIND, content, self.provenance)

    @classmethod
    def load(cls, folder: Path) -> "FactoredBtf":
        """Read what `save` wrote; raises ImageError where the folder holds something else."""
        content, provenance = read_description(folder, KIND)
        names = ("eigenmaps", "weights", "light_directions", "view_directions")
        eigenmaps, weights, lights, views = read_arrays(folder / content["file"], names)
        return cls(
            eigenmaps,
            weights,
            DirectionMesh.from_directions(lights),
            DirectionMesh.from_directions(views),
            provenance,
        )
