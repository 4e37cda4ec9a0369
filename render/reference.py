"""The picture in NumPy: slow, plain, and what the shaders are held equal to. Draws where there is no OpenGL."""

from collections.abc import Iterator

import numpy as np

from render.arrays import Float64, Rows, unit
from render.camera import Camera
from render.frames import gradient_frames, vertex_frames
from render.materials import has_levels, outgoing
from render.mesh import Mesh
from render.picture import Picture
from render.rasteriser import Fragments, rasterise
from render.scene import Body, Scene

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
        radiance = np.zeros((height * width, 3), dtype=np.float32)
        coverage = np.zeros(height * width, dtype=np.float32)
        for body, fragments in visible(scene):
            radiance[fragments.pixel] = shade(scene, body, fragments)
            coverage[fragments.pixel] = 1.0
        return Picture(radiance.reshape(height, width, 3), coverage.reshape(height, width))

    def release(self) -> None:
        """Nothing is held."""


def visible(scene: Scene) -> Iterator[tuple[Body, Fragments]]:
    """Each body with the fragments of it that no other body hides."""
    found = [rasterise(body.mesh, scene.camera) for body in scene.bodies]
    nearest = np.full(scene.camera.size[0] * scene.camera.size[1], np.inf)
    for fragments in found:
        np.minimum.at(nearest, fragments.pixel, fragments.depth)
    for body, fragments in zip(scene.bodies, found, strict=True):
        yield body, fragments.chosen(fragments.depth <= nearest[fragments.pixel])


def shade(scene: Scene, body: Body, fragments: Fragments) -> Float64:
    """Radiance (n, 3) of the body's fragments under all lights."""
    uv, frames, view = surface(body.mesh, scene.camera, fragments)
    footprint = footprints(body.mesh, scene.camera, fragments) if has_levels(body.material) else None
    radiance = np.zeros((len(uv), 3))
    for start in range(0, len(uv), _CHUNK):
        part = slice(start, start + _CHUNK)
        covered = None if footprint is None else footprint[part]
        for light in scene.lights:
            local = unit(frames[part] @ light.direction)
            radiance[part] += light.irradiance * outgoing(body.material, uv[part], local, view[part], covered)
        if any(scene.ambient):
            straight = np.broadcast_to([0.0, 0.0, 1.0], view[part].shape)
            glow = outgoing(body.material, uv[part], straight, view[part], covered)
            radiance[part] += np.array(scene.ambient) * glow
    return radiance


def surface(mesh: Mesh, camera: Camera, fragments: Fragments) -> tuple[Float64, Float64, Float64]:
    """Texture coordinates (n, 2), rows t, b, n (n, 3, 3) in the world frame, and the view in that frame (n, 3)."""
    uv, frames = _textured(mesh, fragments)
    return uv, frames, unit(_rotated(frames, camera.eye - fragments.interpolate(mesh, mesh.positions)))


def footprints(mesh: Mesh, camera: Camera, fragments: Fragments) -> Float64:
    """How texture coordinates change to the next pixel right and below on the same triangle, (n, 2, 2)."""
    here, _ = _textured(mesh, fragments)
    ways = [_textured(mesh, moved)[0] - here for moved in fragments.next_pixels(mesh, camera)]
    return np.stack(ways, axis=1)


def _textured(mesh: Mesh, fragments: Fragments) -> tuple[Float64, Float64]:
    """Texture coordinates (n, 2) and rows t, b, n (n, 3, 3) in the world frame."""
    normal = fragments.interpolate(mesh, mesh.normals)
    if mesh.map_from_world is not None:
        return gradient_frames(normal, mesh.map_from_world)
    return fragments.interpolate(mesh, mesh.uv), vertex_frames(normal, fragments.interpolate(mesh, mesh.tangents))


def _rotated(frames: Rows, vectors: Rows) -> Float64:
    """World vectors (n, 3) along the frames' rows."""
    return np.asarray(np.einsum("nij,nj->ni", frames, vectors))
