"""A BTF with the mesostructure distance function of the same square: what it looks like, and where its surface lies."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float64
from processing.products.directions import DirectionMesh
from processing.products.factored_btf import FactoredBtf
from processing.products.provenance import Provenance, read_arrays, read_description, write_description
from processing.products.texture import bilinear_taps

KIND = "mesostructure"
_BTF = "factored_btf"


@dataclass(frozen=True, eq=False)
class Mesostructure:
    """Reflectance and depth of a periodic square. Lengths are in sides of the square, depths count downward.

    The reference plane lies on top of the sample, and the texels of `btf` and `depths` on a plane `plane` below it: a
    texel stands for the ray that crosses that plane there. `depths` (view, y, x) times `step` is how far under the
    reference plane the point lies that such a ray toward `views` meets first. The depth is kept instead of the distance
    D along the ray (Wang et al. 2005), which is depth over cosine: between measured views it is smooth.
    """

    btf: FactoredBtf
    depths: NDArray[np.uint8]
    step: float
    views: DirectionMesh
    plane: float = 0.0
    provenance: Provenance = field(default_factory=Provenance)

    @property
    def deepest(self) -> float:
        """Depth of the lowest point."""
        return float(self.depths.max(initial=0)) * self.step

    def depth(self, uv: Float64, view: Float64) -> Float64:
        """Depth (n,) of what is seen toward `view` (n, 3) in points `uv` (n, 2) of the texels' plane, which repeat."""
        rows, columns, taps = bilinear_taps(uv, self.depths.shape[1], self.depths.shape[2], wrap=True)
        index, weight = self.views.weights(view)
        codes = self.depths[index[:, :, None], rows[:, None, :], columns[:, None, :]].astype(np.float64)
        return np.asarray(self.step * np.einsum("nj,nt,njt->n", weight, taps, codes))

    def save(self, folder: Path) -> None:
        """Write depths.npz, the factored BTF in a folder of its own, and product.json into `folder`, which is made."""
        folder.mkdir(parents=True, exist_ok=True)
        self.btf.save(folder / _BTF)
        np.savez_compressed(folder / "depths.npz", depths=self.depths, view_directions=self.views.directions)
        content = {"file": "depths.npz", "axes": "view y x", "step": self.step, "plane": self.plane, "btf": _BTF}
        write_description(folder, KIND, content, self.provenance)

    @classmethod
    def load(cls, folder: Path) -> "Mesostructure":
        """Read what `save` wrote; raises ImageError where the folder holds something else."""
        content, provenance = read_description(folder, KIND)
        depths, views = read_arrays(folder / content["file"], ("depths", "view_directions"))
        btf = FactoredBtf.load(folder / content["btf"])
        mesh = DirectionMesh.from_directions(views)
        return cls(btf, depths, float(content["step"]), mesh, float(content["plane"]), provenance)
