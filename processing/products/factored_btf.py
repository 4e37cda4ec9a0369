"""A bidirectional texture function as a short sum of products: maps over light and texel, times weights over view."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from processing.products.arrays import Float32, Float64
from processing.products.directions import DirectionMesh
from processing.products.map_coding import MapCoding, Maps, encode
from processing.products.provenance import Provenance, read_arrays, read_description, write_description
from processing.products.texture import bilinear_taps

KIND = "factored_btf"
_FILE = "factors.npz"
_NAMES = ("eigenmaps", "weights", "light_directions", "view_directions")


@dataclass(frozen=True, eq=False)
class FactoredBtf:
    """BTF(x, y, L, V) = sum_k E_k(x, y, L) W_k(V): reflectance in 1/sr, without the cosine.

    `eigenmaps` (k, light, y, x, channel) and `weights` (k, view) are float32; or the maps are grey, of one channel, and
    `weights` (k, view, channel) carry the colour. With a `coding` the maps are its codes, uint8 or float16. `lights`
    and `views` interpolate between the measured directions, in the sample frame.
    """

    eigenmaps: Maps
    weights: Float32
    lights: DirectionMesh
    views: DirectionMesh
    provenance: Provenance = field(default_factory=Provenance)
    coding: MapCoding | None = None

    @property
    def channels(self) -> int:
        """Channels of the reflectance."""
        return int(max(self.eigenmaps.shape[4], self.colours.shape[2]))

    @property
    def colours(self) -> Float32:
        """Weights (k, view, 1 or channel)."""
        return self.weights if self.weights.ndim == 3 else self.weights[:, :, None]

    @property
    def nbytes(self) -> int:
        """Bytes of maps, weights and coding."""
        coding = self.coding.least.nbytes + self.coding.step.nbytes if self.coding else 0
        return self.eigenmaps.nbytes + self.weights.nbytes + coding

    def coded(self, kind: type[np.uint8] | type[np.float16]) -> "FactoredBtf":
        """The same with maps as codes of one byte or two."""
        maps = np.stack([self.values(k) for k in range(len(self.eigenmaps))])
        codes, coding = encode(maps, kind)
        return replace(self, eigenmaps=codes, coding=coding)

    def values(self, k: int, lights: slice = slice(None)) -> Float32:
        """Eigenmap `k` (light, y, x, channel) as float32."""
        if self.coding is None:
            return np.asarray(self.eigenmaps[k, lights], np.float32)
        return self.coding.decode(self.eigenmaps[k, lights], k, lights)

    def under(self, light: int) -> Float32:
        """What all measured views see under one measured light, (view, y, x, channel)."""
        maps = np.stack([self.values(k, slice(light, light + 1))[0] for k in range(len(self.weights))])
        seen = [np.tensordot(self.colours[..., c % self.colours.shape[2]], maps[..., c % maps.shape[3]], (0, 0))
                for c in range(self.channels)]  # fmt: skip
        return np.asarray(np.stack(seen, axis=-1), np.float32)

    def evaluate(self, uv: Float64, light: Float64, view: Float64) -> Float64:
        """Reflectance (n, channel) for texture coordinates (n, 2), which repeat, and directions (n, 3)."""
        rows, columns, taps = bilinear_taps(uv, self.eigenmaps.shape[2], self.eigenmaps.shape[3], wrap=True)
        light_index, light_weight = self.lights.weights(light)
        total = np.zeros((len(uv), self.channels))
        for k, weight in enumerate(self._seen(view)):
            texel = self.eigenmaps[k][light_index[:, :, None], rows[:, None, :], columns[:, None, :]]
            if self.coding is not None:
                texel = self.coding.decode(texel, k, light_index[:, :, None])
            total += weight * np.einsum("nj,nt,njtc->nc", light_weight, taps, texel.astype(np.float64))
        return total

    @cached_property
    def ambient_maps(self) -> Float64:
        """Each eigenmap times the cosine, integrated over the lights and divided by pi, (k, y, x, channel)."""
        shares = self.lights.cosine_shares
        return np.stack([np.tensordot(shares, self.values(k), axes=1) for k in range(len(self.eigenmaps))])

    def ambient(self, uv: Float64, view: Float64) -> Float64:
        """Radiance (n, channel) toward `view` (n, 3) for unit irradiance that comes equally from everywhere.

        L_a of Wang et al. 2005 with the cosine, over pi: of a matt surface it is the reflectance.
        """
        rows, columns, taps = bilinear_taps(uv, self.eigenmaps.shape[2], self.eigenmaps.shape[3], wrap=True)
        maps = np.einsum("nt,kntc->knc", taps, self.ambient_maps[:, rows, columns])
        return np.asarray((self._seen(view) * maps).sum(axis=0))

    def _seen(self, view: Float64) -> Float64:
        """Weights (k, n, 1 or channel) toward views (n, 3)."""
        index, weight = self.views.weights(view)
        return np.asarray(np.einsum("nj,knjc->knc", weight, self.colours[:, index].astype(np.float64)))

    def save(self, folder: Path) -> None:
        """Write factors.npz and product.json into `folder`, which is made."""
        folder.mkdir(parents=True, exist_ok=True)
        values = (self.eigenmaps, self.weights, self.lights.directions, self.views.directions)
        arrays: dict[str, Any] = dict(zip(_NAMES, values, strict=True))
        content = {"file": _FILE, "rank": len(self.weights), "axes": "k light y x channel"}
        if self.coding is None:
            np.savez(folder / _FILE, **arrays)
        else:
            np.savez_compressed(folder / _FILE, least=self.coding.least, step=self.coding.step, **arrays)
            content["coding"] = str(self.eigenmaps.dtype)
        write_description(folder, KIND, content, self.provenance)

    @classmethod
    def load(cls, folder: Path) -> "FactoredBtf":
        """Read what `save` wrote; raises ImageError where the folder holds something else."""
        content, provenance = read_description(folder, KIND)
        eigenmaps, weights, *ways = read_arrays(folder / content["file"], _NAMES)
        lights, views = (DirectionMesh.from_directions(directions) for directions in ways)
        coding = None
        if "coding" in content:
            coding = MapCoding(*read_arrays(folder / content["file"], ("least", "step")))
        return cls(eigenmaps, weights, lights, views, provenance, coding)
