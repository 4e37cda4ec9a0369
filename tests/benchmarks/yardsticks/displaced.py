"""Truth of bodies covered with a sample: its own surface bent around them, as triangles, traced by Embree.

How it is bent is told in `covered`. Light is distant, meets the surface once, and is shadowed by all bodies.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from render.arrays import unit
from render.camera import Camera
from render.picture import Picture
from render.scene import Light
from simulators.light import radiance
from simulators.scene import Hits, Material
from tests.benchmarks.yardsticks.covered import Covered

Array = NDArray[Any]

_FAR = 1e6  # of lights, in lengths of the world
_STEEP = 0.15  # cosine to the macro surface over which a point counts as turned to the light
_CLEAR = 1e-3  # tiles above the reference plane, where ways to the light start that no relief of the place is on
_RAYS = 1 << 21  # at once
NOTHING = -1


@dataclass(frozen=True, eq=False)
class TruePicture:
    """Radiance and coverage; which body each pixel shows, and where bodies throw shadows.

    `body` (h, w) is `NOTHING` where most of the pixel shows none. `shadow` (h, w) is the share of the pixel that lies
    in a shadow from afar, not that of its own relief, of the first light; NaN where the body is turned away from it.
    """

    picture: Picture
    body: Array
    shadow: Array


@dataclass(frozen=True, eq=False)
class _Seen:
    """Hits of rays (n,) on bodies (n,): world `points` and unit `normals` (n, 3), `depth` (n,) in tiles, material.

    `upward` (n, 3) is the body's own normal, as long as a tile; shadow rays start `offset` (n,) off the surface.
    """

    ray: Array
    body: Array
    points: Array
    normals: Array
    upward: Array
    depth: Array
    offset: Array
    material: Material


class Displaced:
    """Covered bodies, as triangles in Embree."""

    def __init__(self, bodies: Sequence[Covered]) -> None:
        self.bodies = tuple(bodies)
        self._tiles = [(number, tile) for number, body in enumerate(bodies) for tile in np.ndindex(*body.tiles)]

    @cached_property
    def _embree(self) -> tuple[Any, list[Any]]:
        """The scene, and its meshes, one for each tile, which must live as long."""
        scene, meshes = EmbreeScene(), []
        for number, tile in self._tiles:
            body = self.bodies[number]
            vertices = body.points(body.sample.vertices, np.array([tile])).astype(np.float32)
            meshes.append(TriangleMesh(scene, vertices, body.sample.faces.astype(np.int32)))
        return scene, meshes

    def pieces(self) -> Iterator[tuple[Array, Array, Array, Array]]:
        """Vertices (v, 3), faces (f, 3), unit normals (v, 3) and albedo (v, 3) of one tile after another."""
        for number, tile in self._tiles:
            body, where = self.bodies[number], np.array([tile])
            sample = body.sample
            yield (
                body.points(sample.vertices, where),
                sample.faces,
                body.normals(sample.vertices, where, sample.normals),
                sample.surface[:, :3],
            )

    def seen(self, camera: Camera, lights: Sequence[Light], supersampling: int = 4) -> TruePicture:
        """The picture as the mean of `supersampling` squared rays to a pixel; every light's shadows are traced."""
        fine = camera.scaled(supersampling)
        width, height = fine.size
        layers = (
            np.zeros((height, width, 3), np.float32),
            np.full((height, width), NOTHING),
            np.full((height, width), np.nan),
        )
        rows = max(supersampling, _RAYS // width // supersampling * supersampling)
        for first in range(0, height, rows):
            part = slice(first, min(first + rows, height))
            self._draw(fine, lights, part, tuple(layer[part] for layer in layers))
        colour, body, shadow = layers
        picture = Picture(colour, (body != NOTHING).astype(np.float32)).averaged(supersampling)
        return TruePicture(picture, _most(body, supersampling), _mean(shadow, supersampling))

    def _draw(self, camera: Camera, lights: Sequence[Light], rows: slice, layers: tuple[Array, ...]) -> None:
        colour, body, shadow = layers
        width = camera.size[0]
        seen = self._first(camera.eye, _directions(camera, rows))
        if seen is None:
            return
        place = np.divmod(seen.ray, width)
        body[place] = seen.body
        total = np.zeros((len(seen.ray), 3))
        for number, light in enumerate(lights):
            lit = self._reached(seen, light)
            hits = Hits(seen.ray, seen.points, seen.normals.astype(np.float32), seen.material)
            total += light.irradiance * radiance(hits, lit, _FAR * light.direction, camera.eye, _FAR)
            if number == 0:
                shadow[place] = self._shadowed(seen, light)
        colour[place] = total

    def _first(self, eye: Array, directions: Array) -> _Seen | None:
        origins = np.broadcast_to(eye.astype(np.float32), directions.shape).copy()
        found = self._embree[0].run(origins, directions.astype(np.float32), query="INTERSECT", output=True)
        ray = np.flatnonzero(found["primID"] >= 0)
        if not len(ray):
            return None
        geometry, face = found["geomID"][ray], found["primID"][ray]
        u, v = found["u"][ray].astype(np.float64), found["v"][ray].astype(np.float64)
        share = np.column_stack([1 - u - v, u, v])
        owner = np.array([number for number, _ in self._tiles])[geometry]
        tile = np.array([tile for _, tile in self._tiles])[geometry]
        parts = [self._of(number, ray, (owner == number), (tile, face, share)) for number in np.unique(owner)]
        return _joined(parts)

    def _of(self, number: int, ray: Array, own: Array, where: tuple[Array, Array, Array]) -> _Seen:
        """Hits of one body."""
        body = self.bodies[number]
        tile, face, share = (values[own] for values in where)
        local, normal, material = body.sample.at(face, share)
        upward = body.upward(local, tile)
        return _Seen(
            ray[own],
            np.full(len(local), number),
            body.points(local, tile),
            body.normals(local, tile, normal),
            upward,
            -local[:, 2],
            body.sample.offset * np.linalg.norm(upward, axis=1),
            material,
        )

    def _reached(self, seen: _Seen, light: Light) -> Array:
        """Which hits face the light and are reached by it."""
        lit = seen.normals @ light.direction > 0
        starts = seen.points[lit] + seen.offset[lit, None] * seen.normals[lit]
        lit[lit] = ~self._blocked(starts, light)
        return lit

    def _shadowed(self, seen: _Seen, light: Light) -> Array:
        """1 where the light is kept away before it reaches the reference plane, 0 where not, NaN on the dark side."""
        tile = np.linalg.norm(seen.upward, axis=1)
        cosine = seen.upward @ light.direction / np.maximum(tile, 1e-12)
        shadow = np.full(len(cosine), np.nan)
        turned = cosine > _STEEP
        way = tile[turned] * (seen.depth[turned] / cosine[turned] + _CLEAR)
        shadow[turned] = self._blocked(seen.points[turned] + way[:, None] * light.direction, light)
        return shadow

    def _blocked(self, starts: Array, light: Light) -> Array:
        ways = np.broadcast_to(light.direction.astype(np.float32), starts.shape).copy()
        return np.asarray(self._embree[0].run(starts.astype(np.float32), ways, query="OCCLUDED") >= 0)


def _directions(camera: Camera, rows: slice) -> Array:
    """Unit vectors (n, 3) from the eye through all pixels of some rows."""
    v, u = np.meshgrid(np.arange(rows.start, rows.stop), np.arange(camera.size[0]), indexing="ij")
    image = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)])
    return unit(image @ np.linalg.inv(camera.matrix).T @ camera.camera_from_world[:3, :3])


def _joined(parts: Sequence[_Seen]) -> _Seen:
    """Hits of all bodies."""

    def of(name: str) -> Array:
        return np.concatenate([getattr(part, name) for part in parts])

    surface = ("albedo", "specular", "roughness")
    materials = [part.material for part in parts]
    material = Material(*(np.concatenate([getattr(some, name) for some in materials]) for name in surface))
    return _Seen(*map(of, ("ray", "body", "points", "normals", "upward", "depth", "offset")), material)


def _blocks(values: Array, factor: int) -> Array:
    """Pixels' samples (h, w, factor^2)."""
    height, width = (length // factor for length in values.shape)
    split = values.reshape(height, factor, width, factor)
    return split.transpose(0, 2, 1, 3).reshape(height, width, factor * factor)


def _most(body: Array, factor: int) -> Array:
    """The body that most samples show: the middle one by number, which is right where a pixel has two."""
    return np.asarray(np.sort(_blocks(body, factor), axis=2)[..., factor * factor // 2])


def _mean(values: Array, factor: int) -> Array:
    """Mean of the samples that are numbers; NaN where most are none."""
    samples = _blocks(values, factor)
    known = np.isfinite(samples).sum(axis=2)
    return np.where(known > samples.shape[2] // 2, np.nansum(samples, axis=2) / np.maximum(known, 1), np.nan)
