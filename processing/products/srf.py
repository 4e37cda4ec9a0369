"""The spatially varying residual function: one Blinn-Phong lobe plus a residual vector per texel and channel."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import OpenEXR

from processing.errors import ImageError
from processing.products.arrays import Float32, Float64
from processing.products.blinn_phong import BlinnPhong, half_vectors
from processing.products.provenance import Provenance, read_description, write_description
from processing.products.texture import bilinear_taps

KIND = "srf"


@dataclass(frozen=True, eq=False)
class Srf:
    """f*(P, V, L) = Blinn-Phong + s(P) . H, in the tangent frame; the cosine to the light is inside.

    `residual` s is (channel 3, y, x, 3) float32 along (t, b, n): t runs along +u, b against +v, n = t x b.
    `wrap` tells a texture that repeats from one that ends (a sphere's map). NaN: not determined, counted as 0.
    Source: Ma et al. 2004, eq. 5 and 6.
    """

    residual: Float32
    phong: BlinnPhong
    wrap: bool
    provenance: Provenance = field(default_factory=Provenance)

    def evaluate(self, uv: Float64, light: Float64, view: Float64) -> Float64:
        """f* (n, 3) for texture coordinates (n, 2) and tangent-frame directions (n, 3); 0 under the horizon."""
        rows, columns, taps = bilinear_taps(uv, self.residual.shape[1], self.residual.shape[2], wrap=self.wrap)
        texels = np.nan_to_num(self.residual[:, rows, columns].astype(np.float64))
        vectors = np.einsum("nt,cnti->nci", taps, texels)
        residual = np.einsum("nci,ni->nc", vectors, half_vectors(light, view))
        lit = np.asarray(light)[:, 2:3] > 0
        return np.where(lit, self.phong.evaluate(light, view) + residual, 0.0)

    def packed(self) -> Float32:
        """The three channels' maps side by side, (n, 3 m, 3) float32: the paper's 3m x n texture."""
        return np.ascontiguousarray(np.concatenate(list(self.residual), axis=1))

    def save(self, folder: Path) -> None:
        """Write srf.exr (the packed texture: R, G, B hold s_t, s_b, s_n) and product.json into `folder`."""
        folder.mkdir(parents=True, exist_ok=True)
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        with OpenEXR.File(header, {"RGB": self.packed()}) as image:
            image.write(str(folder / "srf.exr"))
        content = {"file": "srf.exr", "phong": self.phong.as_dict(), "wrap": self.wrap}
        write_description(folder, KIND, content, self.provenance)

    @classmethod
    def load(cls, folder: Path) -> "Srf":
        """Read what `save` wrote; raises ImageError where the folder holds something else."""
        content, provenance = read_description(folder, KIND)
        try:
            with OpenEXR.File(str(folder / content["file"])) as image:
                packed = np.array(image.channels()["RGB"].pixels, np.float32)
            residual = np.stack(np.split(packed, 3, axis=1))
        except (OSError, RuntimeError, ValueError, KeyError) as error:
            raise ImageError(f"{folder / content['file']}: not a whole image; process the session again") from error
        return cls(residual, BlinnPhong.from_dict(content["phong"]), content["wrap"], provenance)
