"""What a scene is to light: where rays first hit it, of what it is made there, and what shades it."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Below:
    """What light meets that has entered n points through their glossy surface: `albedo` (n, 3), `spread` (n, 3).

    `spread` is how far it goes under the surface before it leaves, as the cosine below the horizon of the light down to
    which a curved body still shines: 0 where it leaves at once.
    """

    albedo: Floats
    spread: Floats


@dataclass(frozen=True)
class Grain:
    """Grooves of bare metal: `along` (n, 3) are unit tangents, `roughness` (n, 2) that along and that across them.

    `reflectance` (n, 3) is the Fresnel reflectance at normal incidence, which gives the metal its colour. 0 in both is
    no grain.
    """

    along: Floats
    roughness: Floats
    reflectance: Floats


@dataclass(frozen=True)
class Material:
    """Diffuse and glossy reflectance of n surface points: `albedo` (n, 3), `specular` (n,), `roughness` (n,).

    `specular` is the Fresnel reflectance at normal incidence, `roughness` the width of the glossy lobe in (0, 1].
    `sheen` (n,) is what upright fibres add at grazing angles, in [0, 1], `grain` what grooves of metal add.
    """

    albedo: Floats
    specular: Floats
    roughness: Floats
    below: Below | None = None
    sheen: Floats | None = None
    grain: Grain | None = None

    @property
    def diffuse(self) -> Floats:
        """All that leaves in every direction alike (n, 3), of the surface and of what is below it."""
        return self.albedo if self.below is None else self.albedo + self.below.albedo

    @property
    def nbytes(self) -> int:
        """Memory that the arrays take."""
        below = () if self.below is None else (self.below.albedo, self.below.spread)
        sheen = () if self.sheen is None else (self.sheen,)
        grain = () if self.grain is None else (self.grain.along, self.grain.roughness, self.grain.reflectance)
        return sum(array.nbytes for array in (self.albedo, self.specular, self.roughness, *below, *sheen, *grain))


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
        return sum(array.nbytes for array in (self.ray, self.points, self.normals)) + self.material.nbytes


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


def among_matt(count: int, albedo: float, where: Mask | NDArray[np.int64], inside: Material) -> Material:
    """`count` points, of which those at `where` are of the material inside and the others Lambertian of this albedo."""

    def spread_out(values: Floats) -> Floats:
        whole = np.zeros((count, *values.shape[1:]), np.float32)
        whole[where] = values
        return whole

    around = matt(count, albedo)
    around.albedo[where], around.specular[where] = inside.albedo, inside.specular
    around.roughness[where] = inside.roughness
    below, sheen, grain = inside.below, inside.sheen, inside.grain
    return Material(
        around.albedo,
        around.specular,
        around.roughness,
        None if below is None else Below(spread_out(below.albedo), spread_out(below.spread)),
        None if sheen is None else spread_out(sheen),
        None if grain is None else Grain(*map(spread_out, (grain.along, grain.roughness, grain.reflectance))),
    )
