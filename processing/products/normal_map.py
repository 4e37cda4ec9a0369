"""A normal and an albedo per pixel of a fixed camera, with what is known about each."""

from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.products.arrays import Float32
from processing.products.provenance import Provenance, read_arrays, read_description, write_description

KIND = "normals"
_ARRAYS = ("normals", "albedo", "variance", "status", "pixel_m", "depth_m")


class NormalStatus(IntEnum):
    """What became of a pixel."""

    MEASURED = 0  # normal, albedo and variance hold
    NO_SAMPLES = 1  # nothing was measured there: background
    TOO_FEW = 2  # fewer than four lights reach it
    RANK_DEFICIENT = 3  # the lights that reach it lie in one plane: a component of the normal is not determined
    INCONSISTENT = 4  # no normal explains what was measured: more shadow or highlight than matt light


@dataclass(frozen=True, eq=False)
class NormalMap:
    """Unit normals (y, x, 3) in the view frame of `LightStack`: x right, y up the picture, z toward the camera.

    `albedo` (y, x, 3) is the share of light that a matt surface returns (pi times the reflectance), `variance` (y, x)
    the mean squared angle of the normal's error in rad^2; all three float32 and NaN where `status` (y, x) uint8 is not
    `NormalStatus.MEASURED`. `pixel_m` is the side of a pixel on the object. `depth_m` (y, x) float32 is where along z
    the surface was taken to lie to know where near lights come from: 0, the default, where all lights are distant.
    Raises ImageError where the shapes do not belong together.
    """

    normals: Float32
    albedo: Float32
    variance: Float32
    status: NDArray[np.uint8]
    pixel_m: float
    provenance: Provenance = field(default_factory=Provenance)
    depth_m: Float32 = field(default_factory=lambda: np.zeros((1, 1), np.float32))

    def __post_init__(self) -> None:
        shape = self.status.shape
        found = (self.normals.shape, self.albedo.shape, self.variance.shape)
        if len(shape) != 2 or found != ((*shape, 3), (*shape, 3), shape):
            raise ImageError(f"normals, albedo and variance {found} do not belong to a status per pixel of {shape}")
        if self.depth_m.shape not in (shape, (1, 1)):
            raise ImageError(f"a depth per pixel is {shape}, or (1, 1) for all alike, not {self.depth_m.shape}")

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Where there is a normal, (y, x)."""
        return np.asarray(self.status == NormalStatus.MEASURED, np.bool_)

    def save(self, folder: Path) -> None:
        """Write normals.npz and product.json into `folder`, which is made."""
        folder.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(folder / "normals.npz", **{name: getattr(self, name) for name in _ARRAYS})
        write_description(folder, KIND, {"file": "normals.npz", "axes": "y x"}, self.provenance)

    @classmethod
    def load(cls, folder: Path) -> "NormalMap":
        """Read what `save` wrote; raises ImageError where the folder holds something else."""
        content, provenance = read_description(folder, KIND)
        normals, albedo, variance, status, pixel_m, depth_m = read_arrays(folder / content["file"], _ARRAYS)
        return cls(normals, albedo, variance, status, float(pixel_m), provenance, depth_m)
