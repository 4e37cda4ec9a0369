"""The scenes of the paper's figures (Wang et al. 2005): which body is covered with which sample, camera and light.

Two tori of weave on a floor of peanuts (Fig. 12), a knot of grass on a floor of brick (Fig. 13), a torus of brick in
four texture scales (Fig. 11), a cylinder (Fig. 10), and a statue of 84 668 triangles. The others have about as many as
Table 2 says, 3 208 to 11 960.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from render.camera import Camera, look_at
from render.materials import Material
from render.mesh import Mesh, Surface, grid_mesh
from render.scene import Body, Light, Scene, framed, light
from render.shapes import (
    cylinder,
    cylinder_surface,
    knot_surface,
    placed,
    plane_surface,
    statue_surface,
    torus_surface,
)

SIZE = (800, 600)
TORUS_TILES = ((8, 3), (6, 2), (3, 1), (2, 1))
_TRIANGLES_14 = (18, 119)  # 4284; the paper has 4276


@dataclass(frozen=True, eq=False)
class CoveredMesh:
    """A sample on a body, `tiles` times along u and v: its mesh, and the smooth surface that the mesh stands for."""

    mesh: Mesh
    surface: Surface
    tiles: tuple[int, int]
    sample: str


@dataclass(frozen=True, eq=False)
class FigureScene:
    """Bodies, camera and lights; no material yet."""

    bodies: tuple[CoveredMesh, ...]
    camera: Camera
    lights: tuple[Light, ...]

    @property
    def samples(self) -> tuple[str, ...]:
        """Names of the samples, each once."""
        return tuple(dict.fromkeys(body.sample for body in self.bodies))

    @property
    def triangles(self) -> int:
        """How many triangles all bodies have."""
        return sum(len(body.mesh.triangles) for body in self.bodies)

    def scene(self, materials: Mapping[str, Material]) -> Scene:
        """The scene with a material for each sample."""
        bodies = tuple(Body(body.mesh, materials[body.sample]) for body in self.bodies)
        return Scene(bodies, self.camera, self.lights)


def figure_scene(name: str, size: tuple[int, int] = SIZE) -> FigureScene:
    """One of `NAMES` in a picture of that size; raises KeyError for another."""
    return _SCENES[name](size)


def torus_scene(tiles: tuple[int, int], size: tuple[int, int] = SIZE, sample: str = "brick") -> FigureScene:
    """The torus alone, from obliquely above: it hides a part of itself."""
    body = _covered(torus_surface(), tiles, sample, _TRIANGLES_14)
    return _alone(body, size, azimuth_deg=-35.0, elevation_deg=35.0)


def cylinder_scene(size: tuple[int, int] = SIZE, sample: str = "brick", tiles: tuple[int, int] = (6, 6)) -> FigureScene:
    """A part of a cylinder's side, upright between left and right border; its ends lie far outside the picture."""
    radius, height = 0.5, np.pi
    mesh = cylinder(radius, height, tiles=tiles, shape=(32, 64))
    body = CoveredMesh(mesh, cylinder_surface(radius, height), tiles, sample)
    camera = look_at([6.0, 0.0, 0.6], [0.0, 0.0, 0.0], size, field_of_view_rad=0.2)
    return FigureScene((body,), camera, (_KEY,))


def knot_scene(size: tuple[int, int] = SIZE, sample: str = "weave") -> FigureScene:
    """The knot alone: its strands hide and shade each other."""
    body = _covered(knot_surface(), (24, 2), sample, (18, 332))
    return _alone(body, size, azimuth_deg=-35.0, elevation_deg=50.0)


def two_tori(size: tuple[int, int] = SIZE, sample: str = "weave", floor: str = "peanut") -> FigureScene:
    """One torus lies on the floor, the other stands behind it, a little askew; both throw shadows on the floor."""
    tube = 0.36
    ring = torus_surface(1.0, tube)
    lying = placed(ring, _world_from_body(0.0, (1.1, -0.7, tube)))
    standing = placed(ring, _world_from_body(80.0, (-1.1, 0.5, 1.0 + tube)))
    bodies = (
        _covered(plane_surface(8.0), (8, 8), floor, (2, 2)),
        _covered(lying, (6, 2), sample, (20, 40)),
        _covered(standing, (6, 2), sample, (20, 40)),
    )
    return FigureScene(bodies, look_at([7.8, -2.5, 4.8], [-0.1, -0.1, 0.75], size, field_of_view_rad=0.5), (_KEY,))


def knot_on_floor(size: tuple[int, int] = SIZE, sample: str = "grass", floor: str = "brick") -> FigureScene:
    """A knot above a floor, which takes its shadow."""
    above = placed(knot_surface(), _world_from_body(0.0, (0.0, 0.0, 0.85)))
    bodies = (_covered(plane_surface(10.0), (6, 6), floor, (2, 2)), _covered(above, (12, 1), sample, (18, 332)))
    return FigureScene(bodies, look_at([6.6, -2.2, 5.2], [0.0, 0.1, 0.45], size, field_of_view_rad=0.5), (_KEY,))


def statue_scene(size: tuple[int, int] = SIZE, sample: str = "weave") -> FigureScene:
    """The statue alone, 84 668 triangles."""
    body = _covered(statue_surface(), (6, 10), sample, (348, 122))
    return _alone(body, size, azimuth_deg=-35.0, elevation_deg=15.0)


_KEY = light(np.radians(-65.0), np.radians(42.0), 3.0)

_SCENES: Mapping[str, Callable[[tuple[int, int]], FigureScene]] = {
    "two tori": two_tori,
    "knot on floor": knot_on_floor,
    **{f"torus {u} x {v}": lambda size, tiles=(u, v): torus_scene(tiles, size) for u, v in TORUS_TILES},
    "cylinder": cylinder_scene,
    "knot": knot_scene,
    "statue": statue_scene,
}
NAMES = tuple(_SCENES)


def _covered(surface: Surface, tiles: tuple[int, int], sample: str, shape: tuple[int, int]) -> CoveredMesh:
    return CoveredMesh(grid_mesh(surface, shape, tiles), surface, tiles, sample)


def _alone(body: CoveredMesh, size: tuple[int, int], *, azimuth_deg: float, elevation_deg: float) -> FigureScene:
    angles = {"azimuth_rad": np.radians(azimuth_deg), "elevation_rad": np.radians(elevation_deg)}
    return FigureScene((body,), framed(body.mesh, size, **angles), (_KEY,))


def _world_from_body(tilt_deg: float, middle: tuple[float, float, float]) -> NDArray[np.float64]:
    """Turned about Y, then moved."""
    cos, sin = np.cos(np.radians(tilt_deg)), np.sin(np.radians(tilt_deg))
    matrix = np.eye(4)
    matrix[:3:2, :3:2] = [[cos, sin], [-sin, cos]]
    matrix[:3, 3] = middle
    return matrix
