"""Reflectance maps: what a sphere shows under each light, over gradient space."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from processing.products.arrays import Float32, Float64
from processing.products.directions import toward
from processing.products.provenance import Provenance, read_arrays, read_description, write_description
from processing.products.sphere import sphere_normals

KIND = "reflectance_maps"


@dataclass(frozen=True, eq=False)
class ReflectanceMaps:
    """R(p, q) per light: radiance over the irradiance at normal incidence, so the cosine is inside; 1/sr.

    `reflectance_cos` and its `variance` are (light, q, p, channel) float32, q and p at texel centres over [-1, 1];
    NaN = not measured. Directions are unit vectors away from the sphere's centre in the frame of `sphere.py`.
    Distances from the centre are in sphere radii; infinite means distant light, or orthographic view. The view
    direction of the centre is (0, 0, -1).
    """

    reflectance_cos: Float32
    variance: Float32
    light_directions: Float64
    light_distances: Float64
    view_distance: float
    provenance: Provenance = field(default_factory=Provenance)

    def lights(self) -> Float64:
        """Unit vectors (light, q, p, 3) from each point of the sphere to each light."""
        normal = sphere_normals(self.reflectance_cos.shape[1])
        return np.stack(
            [toward(normal, d, r) for d, r in zip(self.light_directions, self.light_distances, strict=True)]
        )

    def views(self) -> Float64:
        """Unit vectors (q, p, 3) from each point of the sphere to the camera."""
        normal = sphere_normals(self.reflectance_cos.shape[1])
        return toward(normal, np.array([0.0, 0.0, -1.0]), self.view_distance)

    def save(self, folder: Path) -> None:
        """Write reflectance_maps.npz and product.json into `folder`, which is made."""
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(
            folder / "reflectance_maps.npz",
            reflectance_cos=self.reflectance_cos,
            variance=self.variance,
            light_directions=self.light_directions,
            light_distances=self.light_distances,
            view_distance=self.view_distance,
        )
        content = {"file": "reflectance_maps.npz", "axes": "light q p channel", "unit": "1/sr, cosine inside"}
        write_description(folder, KIND, content, self.provenance)

    @classmethod
    def load(cls, folder: Path) -> "ReflectanceMaps":
        """Read what `save` wrote; raises ImageError where the folder holds something else."""
        content, provenance = read_description(folder, KIND)
        names = ("reflectance_cos", "variance", "light_directions", "light_distances", "view_distance")
        reflectance, variance, lights, distances, view_distance = read_arrays(folder / content["file"], names)
        return cls(reflectance, variance, lights, distances, float(view_distance), provenance)
