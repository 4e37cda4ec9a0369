"""Bodies by the radiance of their vertices in NumPy: what `RelitView` is held equal to."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from render.arrays import Float32, Float64, Int32, Rows
from render.camera import Camera
from render.environment import Environment
from render.mesh import Mesh, plain_mesh
from render.picture import Picture
from render.rasteriser import Fragments, rasterise
from render.reference import NAME
from render.relit_bodies import Background, RelitBodies


class RelitReference:
    """As `RelitView`, without any graphics library."""

    name = NAME

    def __init__(self, meshes: Sequence[Mesh], supersampling: int = 2) -> None:
        self.bodies = RelitBodies.of(meshes)
        self._supersampling = supersampling

    def visible(self, camera: Camera, poses: Sequence[Float64]) -> NDArray[np.int64]:
        """Ascending numbers of the vertices of all triangles that a picture from here shows."""
        return self.bodies.vertices_in(self.triangles(camera.scaled(self._supersampling), poses))

    def triangles(self, camera: Camera, poses: Sequence[Float64]) -> Int32:
        """Which triangle each pixel's middle sees, (h, w); -1 where none."""
        _, fragments = self._seen(camera, poses)
        found = np.full(camera.size[0] * camera.size[1], -1, np.int32)
        found[fragments.pixel] = fragments.triangle
        return found.reshape(camera.size[::-1])

    def draw(
        self, camera: Camera, poses: Sequence[Float64], radiance: Float32, background: Background | None = None
    ) -> Picture:
        """The bodies in the radiance (all vertices, 3)."""
        camera = camera.scaled(self._supersampling)
        width, height = camera.size
        found = np.zeros((height * width, 4), np.float32)
        if background is not None:
            found[:, :3], found[:, 3] = _behind(background, camera), 1.0
        mesh, fragments = self._seen(camera, poses)
        found[fragments.pixel, :3] = fragments.interpolate(mesh, self.bodies.checked_radiance(radiance))
        found[fragments.pixel, 3] = 1.0
        image = found.reshape(height, width, 4)
        return Picture(image[:, :, :3], image[:, :, 3]).averaged(self._supersampling)

    def release(self) -> None:
        """Nothing is held."""

    def _seen(self, camera: Camera, poses: Sequence[Float64]) -> tuple[Mesh, Fragments]:
        """All bodies as one mesh in the world, and what each pixel sees of it."""
        positions = self.bodies.in_world(self.bodies.checked_poses(poses))
        mesh = plain_mesh(positions, np.zeros_like(positions), self.bodies.triangles)
        return mesh, rasterise(mesh, camera)


def _behind(background: Background, camera: Camera) -> Float64:
    """Radiance (pixels, 3) of the environment along the ray of each pixel, linear between its pixels."""
    width, height = camera.size
    v, u = np.divmod(np.arange(height * width), width)
    rays = np.stack([u, v, np.ones_like(u)], axis=1) @ np.linalg.inv(camera.matrix).T @ camera.camera_from_world[:3, :3]
    x, y, z = (rays / np.linalg.norm(rays, axis=1, keepdims=True) @ background.world_from_light).T
    environment = background.environment
    rows, columns = environment.radiance.shape[:2]
    column = (0.5 + (environment.azimuth_rad - np.arctan2(y, x)) / (2 * np.pi)) * columns - 0.5
    return _bilinear(environment, np.arccos(np.clip(z, -1.0, 1.0)) / np.pi * rows - 0.5, column)


def _bilinear(environment: Environment, row: Rows, column: Rows) -> Float64:
    """Between four pixels; columns go round."""
    rows, columns = environment.radiance.shape[:2]
    found = np.zeros((len(row), 3))
    top, left = np.floor(row).astype(np.int64), np.floor(column).astype(np.int64)
    for down in (0, 1):
        for right in (0, 1):
            share = np.abs(1 - down - (row - top)) * np.abs(1 - right - (column - left))
            corner = environment.radiance[np.clip(top + down, 0, rows - 1), (left + right) % columns]
            found += share[:, None] * corner
    return found
