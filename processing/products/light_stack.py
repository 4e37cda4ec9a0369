"""What a fixed camera sees of an object under one light after another."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from processing.errors import ImageError
from processing.products.arrays import Float32, Float64
from processing.products.directions import toward
from processing.products.provenance import Provenance, read_arrays, read_description, write_description

KIND = "light_stack"
_ARRAYS = ("reflectance_cos", "variance", "light_directions", "light_distances_m", "pixel_m")


@dataclass(frozen=True, eq=False)
class LightStack:
    """Radiance per light over the irradiance at normal incidence in the picture's middle; cosine inside, 1/sr.

    `reflectance_cos` and its `variance` are (light, y, x, 3) float32; NaN = not measured, or background. The view frame
    has x right, y up the picture (row 0 is the top) and z toward the camera, which sees nearly orthographically along
    -z; its origin is the picture's middle at depth 0. `light_directions` (light, 3) are unit vectors from there toward
    the lights, `light_distances_m` (light,) how far they are, inf = distant; a nearer light falls off with the squared
    distance. `pixel_m` is the side of a pixel on the object.
    Raises ImageError where the shapes do not belong together, a direction is no unit vector or a length not positive.
    """

    reflectance_cos: Float32
    variance: Float32
    light_directions: Float64
    light_distances_m: Float64
    pixel_m: float
    provenance: Provenance = field(default_factory=Provenance)

    def __post_init__(self) -> None:
        shape, lights = self.reflectance_cos.shape, len(self.light_directions)
        if len(shape) != 4 or shape[::3] != (lights, 3) or self.variance.shape != shape:
            raise ImageError(
                f"a stack of {lights} lights is (light, y, x, 3), not {shape} with variances {self.variance.shape}"
            )
        if self.light_directions.shape != (lights, 3) or self.light_distances_m.shape != (lights,):
            raise ImageError(
                f"directions {self.light_directions.shape} and distances {self.light_distances_m.shape} of {lights} "
                "lights; expected (light, 3) and (light,)"
            )
        if not np.allclose(np.linalg.norm(self.light_directions, axis=1), 1.0, atol=1e-6):
            raise ImageError("a light direction is no unit vector; divide each by its length")
        if not (self.light_distances_m > 0).all() or not 0 < self.pixel_m < np.inf:
            raise ImageError("the lights' distances and the pixel's side must be positive lengths in metres")

    def lights(self) -> Float64:
        """Unit vectors (light, y, x, 3) from each pixel's point at depth 0 to each light."""
        points = plane_points(self.reflectance_cos.shape[1:3], self.pixel_m)
        lights = zip(self.light_directions, self.light_distances_m, strict=True)
        return np.stack([toward(points, direction, distance_m) for direction, distance_m in lights])

    def save(self, folder: Path) -> None:
        """Write light_stack.npz and product.json into `folder`, which is made."""
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(folder / "light_stack.npz", **{name: getattr(self, name) for name in _ARRAYS})
        content = {"file": "light_stack.npz", "axes": "light y x channel", "unit": "1/sr, cosine inside"}
        write_description(folder, KIND, content, self.provenance)

    @classmethod
    def load(cls, folder: Path) -> "LightStack":
        """Read what `save` wrote; raises ImageError where the folder holds something else."""
        content, provenance = read_description(folder, KIND)
        reflectance, variance, directions, distances_m, pixel_m = read_arrays(folder / content["file"], _ARRAYS)
        return cls(reflectance, variance, directions, distances_m, float(pixel_m), provenance)


def plane_points(shape: tuple[int, int], pixel_m: float) -> Float64:
    """Points (y, x, 3) of the view frame at depth 0 that the pixels of a picture of this shape see, in metres."""
    rows, columns = shape
    x, y = np.arange(columns) - (columns - 1) / 2, (rows - 1) / 2 - np.arange(rows)
    return np.stack([*np.meshgrid(x * pixel_m, y * pixel_m), np.zeros(shape)], axis=-1)
