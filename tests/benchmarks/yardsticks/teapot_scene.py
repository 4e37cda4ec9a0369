"""A teapot on a floor, as in fig. 8 of Iwasaki et al., white under the light of windows; lengths in belly radii.

Both throw shadows: the floor, which is flat, by its outline.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from processing.lighting.brdfs import Brdf, lambert
from processing.lighting.cuts import Cuts
from processing.lighting.directions import SampleDirections
from processing.lighting.field import VisibilityField
from processing.lighting.light import EnvironmentLight
from processing.lighting.outline import flat_outline
from processing.lighting.relighting import Relighting
from processing.lighting.shells import ShellPlan
from processing.lighting.surroundings import RelitBody
from processing.lighting.triangle_body import TriangleBody
from processing.products.arrays import Float64
from processing.products.light_environment import Environment
from render.camera import Camera, look_at
from render.mesh import Mesh
from render.shapes import plane
from render.teapot import teapot
from service.relit_bodies import body_of
from tests.benchmarks.yardsticks.sparse_fields import cuts_of, field_around
from tests.reference.relit import DirectLight

TEAPOT, FLOOR = 0, 1
EYE = np.array([1.6, -4.6, 3.4])
WHITE = lambert(np.full(3, 0.7))
_FLOOR_SIDE = 7.0
CLEARANCE = 1e-3
_FIELD_OF_VIEW_RAD = 0.6
_LOOKED_AT = np.array([0.0, 0.1, 0.45])


@dataclass(frozen=True, eq=False)
class TeapotScene:
    """Meshes and bodies of teapot and floor, vertex by vertex the same, and where they stand."""

    meshes: tuple[Mesh, Mesh]
    bodies: tuple[TriangleBody, TriangleBody]
    poses: tuple[Float64, Float64]

    @property
    def first(self) -> NDArray[np.int64]:
        """Number of each body's first vertex, and how many there are in all."""
        return np.cumsum([0, *(len(body.vertices) for body in self.bodies)])

    def direct(
        self, vertices: NDArray[np.int64], sampled: SampleDirections, environment: Environment, brdfs: tuple[Brdf, Brdf]
    ) -> Float64:
        """Radiance (n, 3) of vertices toward the eye by direct summation over all directions, each one traced."""
        light = EnvironmentLight(environment, sampled).turned(np.eye(3)).values
        truth = DirectLight(self.bodies, self.poses, sampled)
        return np.array([truth.radiance(vertex, light, EYE, brdfs) for vertex in vertices])

    def field(self, vertices: NDArray[np.int64], sampled: SampleDirections, plan: ShellPlan) -> VisibilityField:
        """That of the teapot, as far as some vertices need it."""
        pot, floor = self.bodies
        around = floor.origins[self._own(vertices, FLOOR)] - self.poses[TEAPOT][:3, 3]
        return field_around(pot, sampled, plan.around(pot.centre, pot.radius), around)

    def cuts(self, vertices: NDArray[np.int64], sampled: SampleDirections, tolerance: float) -> list[Cuts]:
        """Those of some vertices, of both bodies."""
        return [
            cuts_of(body, sampled, self._own(vertices, number), tolerance) for number, body in enumerate(self.bodies)
        ]

    def _own(self, vertices: NDArray[np.int64], number: int) -> NDArray[np.int64]:
        first, after = self.first[number : number + 2]
        return vertices[(vertices >= first) & (vertices < after)] - first

    def relit(self, cuts: list[Cuts], field: VisibilityField) -> list[RelitBody]:
        """Both bodies, ready to be relit."""
        fields = field, flat_outline(self.bodies[FLOOR])
        return [RelitBody(body, own, cast) for body, own, cast in zip(self.bodies, cuts, fields, strict=True)]

    def relighting(
        self, bodies: list[RelitBody], sampled: SampleDirections, environment: Environment, brdfs: tuple[Brdf, Brdf]
    ) -> Relighting:
        """The bodies in place, painted, before the eye."""
        scene = Relighting(bodies, sampled, environment)
        for number, (pose, brdf) in enumerate(zip(self.poses, brdfs, strict=True)):
            scene.move(number, pose)
            scene.paint(number, brdf)
        scene.look_from(EYE)
        return scene

    def camera(self, size: tuple[int, int]) -> Camera:
        """The view of the pictures (width, height)."""
        return look_at(EYE, _LOOKED_AT, size, field_of_view_rad=_FIELD_OF_VIEW_RAD)


@lru_cache(maxsize=4)
def teapot_scene(detail: float, floor: int) -> TeapotScene:
    """With a teapot of this detail, and a floor of so many squares along each side."""
    meshes = teapot(detail), plane(_FLOOR_SIDE, shape=(floor, floor))
    bodies = body_of(meshes[0])[0], body_of(meshes[1])[0]
    poses = np.eye(4), np.eye(4)
    poses[TEAPOT][2, 3] = CLEARANCE
    return TeapotScene(meshes, bodies, poses)
