"""The mesostructure distance function: how far below the reference plane the surface lies along each view."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.geometry import texel_grid
from processing.products.arrays import Float32, Float64
from processing.products.provenance import Provenance, read_arrays, read_description, write_description

KIND = "mdf"
MISSING_CODE = 255


@dataclass(frozen=True, eq=False)
class Mdf:
    """D(view, y, x) in metres along the view ray from the reference plane down to the surface; NaN = not seen.

    `displacement_m` and its `variance_m2` are float32, `view_directions` (view, 3) unit vectors of the sample
    frame from its centre, `side_m` the edge of the square that the texels divide (row 0 at +Y). Not negative where the
    reference plane lies above the sample; measured values may undershoot 0 by their noise.
    A texel stands for the ray that crosses the plane `plane_m` under the reference plane there. `distances_m` (view,)
    is how far the eye was from the sample's centre; left out, so far that all rays of a view are parallel.
    """

    displacement_m: Float32
    variance_m2: Float32
    view_directions: Float64
    side_m: float
    provenance: Provenance = field(default_factory=Provenance)
    plane_m: float = 0.0
    distances_m: Float64 | None = None

    def depth_m(self) -> Float64:
        """How far under the reference plane (view, y, x) the points lie: D times its ray's cosine."""
        texels = texel_grid(self.displacement_m.shape[1], self.side_m, -self.plane_m)
        far = np.full(len(self.view_directions), np.inf) if self.distances_m is None else self.distances_m
        toward = self.view_directions[:, None, None] - texels / far[:, None, None, None]
        cosine = toward[..., 2] / np.linalg.norm(toward, axis=-1)
        return np.asarray(self.displacement_m * cosine, np.float64)

    def pack8(self) -> tuple[NDArray[np.uint8], float]:
        """One byte per sample and the metres per step: value = code * scale_m, 255 = missing.

        The scale maps the deepest sample to 254; values under 0 become 0.
        """
        deepest = float(np.nanmax(self.displacement_m, initial=0.0))
        scale_m = deepest / (MISSING_CODE - 1) if deepest > 0 else 1.0
        missing = np.isnan(self.displacement_m)
        code = np.rint(np.clip(np.where(missing, 0.0, self.displacement_m), 0.0, None) / scale_m)
        return np.where(missing, MISSING_CODE, code).astype(np.uint8), scale_m

    def save(self, folder: Path, told: Mapping[str, Any] | None = None) -> None:
        """Write mdf.npz and product.json, with what else is `told` of it for people, into `folder`, which is made."""
        folder.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(
            folder / "mdf.npz",
            displacement_m=self.displacement_m,
            variance_m2=self.variance_m2,
            view_directions=self.view_directions,
        )
        eyes = {} if self.distances_m is None else {"distances_m": list(map(float, self.distances_m))}
        where = {"side_m": self.side_m, "plane_m": self.plane_m, **eyes}
        content = {"file": "mdf.npz", "axes": "view y x", **where, **(told or {})}
        write_description(folder, KIND, content, self.provenance)

    @classmethod
    def load(cls, folder: Path) -> "Mdf":
        """Read what `save` wrote; raises ImageError where the folder holds something else."""
        content, provenance = read_description(folder, KIND)
        names = ("displacement_m", "variance_m2", "view_directions")
        displacement_m, variance_m2, directions = read_arrays(folder / content["file"], names)
        distances = content.get("distances_m")
        return cls(
            displacement_m,
            variance_m2,
            directions,
            float(content["side_m"]),
            provenance,
            float(content.get("plane_m", 0.0)),
            None if distances is None else np.asarray(distances, np.float64),
        )


def unpack8(code: NDArray[np.uint8], scale_m: float) -> Float32:
    """Metres, float32 with NaN where missing: the inverse of `Mdf.pack8` to half a step."""
    return np.where(code == MISSING_CODE, np.nan, code * scale_m).astype(np.float32)
