"""The picture in NumPy: slow, plain, and what the shaders are held equal to. Draws where there is no OpenGL."""

import numpy as np

from render.arrays import Float64, Rows, unit
from render.camera import Camera
from render.frames import gradient_frames, vertex_frames
from render.materials import outgoing
from render.mesh import Mesh
from render.picture import Picture
from render.rasteriser import Fragments, rasterise
from render.scene import Scene

NAME = "NumPy reference"

# Pixels that are shaded at once: bounds the memory of a material's texel taps.
_CHUNK = 32_768


class ReferenceRenderer:
    """Draws scenes without any graphics library."""

    name = NAME
    affordable_supersampling = 1

    def draw(self, scene: Scene) -> Picture:
        """The scene as its camera sees it; pixels that show nothing are 0 in radiance and coverage."""
        width, height = scene.camera.size
        fragments = rasterise(scene.mesh, scene.camera)
        radiance = np.zeros((height * width, 3), dtype=np.float32)
        radiance[fragments.pixel] = shade(scene, fragments)
        coverage = np.zeros(height * width, dtype=np.float32)
        coverage[fragments.pixel] = 1.0
        return Picture(radiance.reshape(height, width, 3), coverage.reshape(height, width))

    def release(self) -> None:
        """Nothing is held."""


def shade(scene: Scene, fragments: Fragments) -> Float64:
    """Radiance (n, 3) of the fragments under all lights."""
    uv, frames, view = surface(scene.mesh, scene.camera, fragments)
    radiance = np.zeros((len(uv), 3))
    for start in range(0, len(uv), _CHUNK):
        part = slice(start, start + _CHUNK)
        for light in scene.lights:
            local = unit(frames[part] @ light.direction)
            radiance[part] += light.irradiance * outgoing(scene.material, uv[part], local, view[part])
        if any(scene.ambient):
            straight = np.broadcast_to([0.0, 0.0, 1.0], view[part].shape)
            radiance[part] += np.array(scene.ambient) * outgoing(scene.material, uv[part], straight, view[part])
    return radiance


def surface(mesh: Mesh, camera: Camera, fragments: Fragments) -> tuple[Float64, Float64, Float64]:
    """Texture coordinates (n, 2), rows t, b, n (n, 3, 3) in the world frame, and the view in that frame (n, 3)."""
    normal = fragments.interpolate(mesh, mesh.normals)
    if mesh.map_from_world is not None:
        uv, frames = gradient_frames(normal, mesh.map_from_world)
    else:
        uv = fragments.interpolate(mesh, mesh.uv)
        frames = vertex_frames(normal, fragments.interpolate(mesh, mesh.tangents))
    return uv, frames, unit(_rotated(frames, camera.eye - fragments.interpolate(mesh, mesh.positions)))


def _rotated(frames: Rows, vectors: Rows) -> Float64:
    """World vectors (n, 3) along the frames' rows."""
    return np.asarray(np.einsum("nij,nj->ni", frames, vectors))
