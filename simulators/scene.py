"""What a scene is to light: where rays first hit it, of what it is made there, and what shades it."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Material:
    """Diffuse and glossy reflectance of n surface points: `albedo` (n, 3), `specular` (n,), `roughness` (n,).

    `specular` is the Fresnel reflectance at normal incidence, `roughness` the width of the glossy lobe in (0, 1].
    """

    albedo: Floats
    specular: Floats
    roughness: Floats


@dataclass(frozen=True)
class Hits:
    """First hits of rays: `ray` (n,) int64 says of which, `points` and `normals` (n, 3) lie in the scene's frame."""

    ray: NDArray[np.int64]
    points: Array
    normals: Floats
    material: Material

    @property
    def nbytes(self) -> int:
        """Memory that the arrays take."""
        material = self.material
        arrays = (self.ray, self.points, self.normals, material.albedo, material.specular, material.roughness)
        return sum(array.nbytes for array in arrays)


class Scene(Protocol):
    """A sample and what it lies in, in its own frame, metres."""

    def trace(self, origin: Array, directions: Array) -> Hits:
        """First hits of rays from one origin (3,) along unit directions (n, 3)."""
        ...

    def lit(self, hits: Hits, source: Array) -> Mask:
        """Which hits (n,) see the point source (3,); surfaces turned away from it need not be told."""
        ...


class Sample(Protocol):
    """What fills the holder's opening, in the sample frame, metres: it closes the opening at the bottom.

    Both questions are about straight ways (n, 3) from points (n, 3); they start outside the sample.
    """

    @property
    def offset_m(self) -> float:
        """How far off its surface shadow rays start: more than its pieces sag under the curves they stand for."""
        ...

    def trace(self, starts: Array, ways: Array) -> Hits:
        """First hits on the ways."""
        ...

    def blocks(self, starts: Array, ways: Array) -> Mask:
        """Which ways (n,) are not free."""
        ...


def matt(count: int, albedo: float) -> Material:
    """`count` points of a Lambertian material, the same in all channels."""
    return Material(
        np.full((count, 3), albedo, np.float32), np.zeros(count, np.float32), np.ones(count, np.float32)
    )  # fmt: skip
