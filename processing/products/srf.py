"""The spatially varying residual function: one lobe for all plus a residual per texel and channel."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import OpenEXR

from processing.errors import ImageError
from processing.products.arrays import Float32, Float64
from processing.products.blinn_phong import Lobe, lobe_from_dict
from processing.products.provenance import Provenance, read_description, write_description
from processing.products.residual_basis import ResidualBasis
from processing.products.texture import bilinear_taps

KIND = "srf"


@dataclass(frozen=True, eq=False)
class Srf:
    """f*(P, V, L) = lobe + s(P) . basis(L, V), in the tangent frame; the cosine to the light is inside.

    `residual` s is (channel 3, y, x, k) float32, one coefficient for each function of `basis`, whose H and L lie along
    (t, b, n): t runs along +u, b against +v, n = t x b. `wrap` tells a texture that repeats from one that ends (a
    sphere's map). NaN: not determined, counted as 0. Source: Ma et al. 2004, eq. 5 and 6, whose basis is H.
    """

    residual: Float32
    phong: Lobe
    wrap: bool
    provenance: Provenance = field(default_factory=Provenance)
    basis: ResidualBasis = ResidualBasis.HALF

    def __post_init__(self) -> None:
        if self.residual.ndim != 4 or self.residual.shape[::3] != (3, self.basis.size):
            raise ImageError(f"an SRF over {self.basis} is (3, y, x, {self.basis.size}), not {self.residual.shape}")

    def evaluate(self, uv: Float64, light: Float64, view: Float64) -> Float64:
        """f* (n, 3) for texture coordinates (n, 2) and tangent-frame directions (n, 3); 0 under the horizon."""
        rows, columns, taps = bilinear_taps(uv, self.residual.shape[1], self.residual.shape[2], wrap=self.wrap)
        texels = np.nan_to_num(self.residual[:, rows, columns].astype(np.float64))
        coefficients = np.einsum("nt,cnti->nci", taps, texels)
        residual = np.einsum("nci,ni->nc", coefficients, self.basis.evaluate(light, view))
        lit = np.asarray(light)[:, 2:3] > 0
        return np.where(lit, self.phong.evaluate(light, view) + residual, 0.0)

    def packed(self) -> Float32:
        """The three channels' maps side by side, (n, 3 m, k) float32: the paper's 3m x n texture."""
        return np.ascontiguousarray(np.concatenate(list(self.residual), axis=1))

    def save(self, folder: Path) -> None:
        """Write srf.exr (the packed texture, one layer for each function of the basis) and product.json.

        The layers of H are called R, G and B, so that any viewer shows them as a normal map; others have their names.
        """
        folder.mkdir(parents=True, exist_ok=True)
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        layers = dict(zip(_layers(self.basis), np.moveaxis(self.packed(), -1, 0), strict=True))
        channels = {name: np.ascontiguousarray(layer) for name, layer in layers.items()}
        with OpenEXR.File(header, channels) as image:
            image.write(str(folder / "srf.exr"))
        content = {"file": "srf.exr", "phong": self.phong.as_dict(), "wrap": self.wrap, "basis": str(self.basis)}
        write_description(folder, KIND, content, self.provenance)

    @classmethod
    def load(cls, folder: Path) -> "Srf":
        """Read what `save` wrote; raises ImageError where the folder holds something else."""
        content, provenance = read_description(folder, KIND)
        try:
            basis = ResidualBasis(content.get("basis", ResidualBasis.HALF))
            with OpenEXR.File(str(folder / content["file"]), separate_channels=True) as image:
                channels = image.channels()
                packed = np.stack([np.array(channels[name].pixels, np.float32) for name in _layers(basis)], axis=-1)
            residual = np.stack(np.split(packed, 3, axis=1))
        except (OSError, RuntimeError, ValueError, KeyError) as error:
            raise ImageError(f"{folder / content['file']}: not a whole image; process the session again") from error
        return cls(residual, lobe_from_dict(content["phong"]), content["wrap"], provenance, basis)


def _layers(basis: ResidualBasis) -> tuple[str, ...]:
    return ("R", "G", "B") if basis is ResidualBasis.HALF else basis.names
