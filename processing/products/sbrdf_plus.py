"""A BTF as lobes and shadows of the points seen from the top, shifts toward them, and clusters of hidden points."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from processing.errors import ImageError
from processing.products.arrays import Float32, Float64
from processing.products.directions import DirectionMesh
from processing.products.lafortune import LafortuneTexels
from processing.products.provenance import Provenance, read_arrays, read_description, write_description
from processing.products.sbrdf_packing import PackedMaps, SbrdfMaps, TextureLayout, pack, unpack
from processing.products.texture import bilinear_taps

Index = NDArray[Any]

KIND = "sbrdf_plus"
_TEXTURE, _ARRAYS = "sbrdf_plus.png", "sbrdf_plus.npz"


@dataclass(frozen=True, eq=False)
class SbrdfPlus:
    """BTF(x, L, V) = hidden(x, V) ? centre(x, V)(L) : lobes(x', L, V) shadow(x', L) with x' = x + shift(x, V).

    `shadow` (light, y, x) in 0 to 1 is that of the view from the top; `shift` (view, y, x, 2) float32 in texels, right
    and down; `hidden` (view, y, x) tells what no view from the top sees; `cluster` (view, y, x) is its index into
    `centres` (k, light, 3), reflectance in 1/sr without the cosine. The texture repeats. Source: Chen et al., eq. 2.3.

    `coarser` are the same surface at half the texels along each side, a quarter and so on, finest first: what stands
    for it where a pixel covers several texels.
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
    coarser: tuple["SbrdfPlus", ...] = ()

    @property
    def size_bytes(self) -> int:
        """Bytes on a graphics card, without the coarser levels: one RGBA8 texture and float32 lobes.

        2 490 368 for 81 x 81 directions, 64 x 64 texels and three lobes of 24 floats, 2 359 296 for 16 floats. The
        paper's 0.596 MB for lobes and 1.008 MB with shadows do not follow from its own layout: 16 floats for each of
        64 x 64 texels are 0.262 MB, and 81 shadow maps of a byte 0.332 MB more.
        """
        rows, columns = self._maps().layout.shape
        return rows * columns * 4 + self.lobes.packed().nbytes

    def packed(self) -> PackedMaps:
        """All but the lobes in one texture. Raises ImageError for centres that it has no room for."""
        return pack(self._maps())

    def quantised(self) -> "SbrdfPlus":
        """What `load` gives back after `save`, without the coarser levels."""
        lobes = LafortuneTexels.unpacked(self.lobes.packed(), self.lobes.lobes)
        return replace(_unpacked(self.packed(), lobes, self.lights, self.views), provenance=self.provenance)

    def save(self, folder: Path) -> None:
        """Write sbrdf_plus.png (the packed texture), sbrdf_plus.npz (lobes, directions) and product.json.

        Coarser levels go into folders level_1, level_2 ... Raises ImageError for more centres than there is room for.
        """
        folder.mkdir(parents=True, exist_ok=True)
        for number, level in enumerate(self.coarser, start=1):
            level.save(folder / f"level_{number}")
        packed = self.packed()
        Image.fromarray(packed.texture).save(folder / _TEXTURE)
        light, view = self.lights.directions, self.views.directions
        np.savez(folder / _ARRAYS, lobes=self.lobes.packed(), light=light, view=view)
        content = {
            "texture": _TEXTURE,
            "arrays": _ARRAYS,
            "lobes": self.lobes.lobes,
            "centres": packed.centres,
            "centre_scale": packed.scale,
            "coarser": len(self.coarser),
        }
        write_description(folder, KIND, content, self.provenance)

    @classmethod
    def load(cls, folder: Path) -> "SbrdfPlus":
        """The product as its bytes in `folder` tell it; raises ImageError that names the folder of anything else."""
        content, provenance = read_description(folder, KIND)
        try:
            packed, light, view = read_arrays(folder / content["arrays"], ("lobes", "light", "view"))
            lobes = LafortuneTexels.unpacked(packed, content["lobes"])
            layout = TextureLayout(len(light), len(view), *lobes.shape)
            maps = PackedMaps(_read_texture(folder / _TEXTURE), layout, content["centres"], content["centre_scale"])
            meshes = DirectionMesh.from_directions(light), DirectionMesh.from_directions(view)
            product = _unpacked(maps, lobes, *meshes)
            coarser = tuple(cls.load(folder / f"level_{number + 1}") for number in range(content["coarser"]))
        except (ImageError, KeyError, TypeError, ValueError) as error:
            raise ImageError(f"{folder}: not a whole {KIND}; analyse the BTF again ({error})") from error
        return replace(product, provenance=provenance, coarser=coarser)

    def evaluate(self, uv: Float64, light: Float64, view: Float64) -> Float64:
        """Reflectance times the cosine to the light (n, 3), for texture coordinates (n, 2) and directions (n, 3).

        Lobes are asked at the directions themselves, but no lower than the lowest measured ones, beyond which nothing
        holds them. Shifts, shadows and centres are interpolated over the measured
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

    def _maps(self) -> SbrdfMaps:
        """What goes into the texture; centres have the cosine inside, as the eye weighs them."""
        values = self.centres * _cosine(self.lights)
        return SbrdfMaps(self.shadow, self.shift, self.hidden, self.cluster, values)

    def _shaded(self, uv: Float64, light: Float64, view: Float64) -> Float64:
        """Lobes times shadow (n, 3) of the points seen from the top."""
        rows, columns, taps = bilinear_taps(uv, *self.lobes.shape, wrap=True)
        index, weight = self.lights.weights(light)
        shadow = np.einsum("nl,nlt->nt", weight, self.shadow[index[:, :, None], rows[:, None, :], columns[:, None, :]])
        lobes = self.lobes.evaluate(rows, columns, self.lights.raised(light)[:, None], self.views.raised(view)[:, None])
        shaded: Float64 = np.einsum("nt,nt,ntc->nc", taps, shadow, lobes)
        return shaded

    def _centres(self, place: tuple[Index, ...], lights: Index) -> Float32:
        """Centres (n, view, texel, light, 3); of points that are not hidden any, as their weight is 0."""
        if len(self.centres) == 0:
            return np.zeros((*np.broadcast_shapes(*(axis.shape for axis in place)), lights.shape[1], 3), np.float32)
        found: Float32 = self.centres[self.cluster[place][..., None], lights[:, None, None, :]]
        return found


def _unpacked(packed: PackedMaps, lobes: LafortuneTexels, lights: DirectionMesh, views: DirectionMesh) -> SbrdfPlus:
    maps, cosine = unpack(packed), _cosine(lights)
    centres = np.divide(maps.centres, cosine, out=np.zeros_like(maps.centres), where=cosine > 0)
    return SbrdfPlus(lobes, maps.shadow, maps.shift, maps.hidden, maps.cluster, centres, lights, views)


def _cosine(lights: DirectionMesh) -> Float32:
    """Cosine to each light (light, 1), 0 under the horizon."""
    return np.maximum(lights.directions[:, 2:], 0).astype(np.float32)


def _read_texture(path: Path) -> NDArray[np.uint8]:
    try:
        with Image.open(path) as image:
            return np.asarray(image, np.uint8)
    except (OSError, SyntaxError, Image.DecompressionBombError) as error:  # the second for a broken chunk
        raise ImageError(f"{path}: not a whole image") from error
