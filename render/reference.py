"""The picture in NumPy: slow, plain, and what the shaders are held equal to. Draws where there is no OpenGL."""

from collections.abc import Iterator, Sequence

import numpy as np

from processing.products import FactoredBtf, Mesostructure
from render.arrays import Float64, unit
from render.camera import Camera
from render.light_view import SIDE_PX
from render.materials import has_levels, outgoing
from render.mesh import Mesh
from render.picture import Picture
from render.rasteriser import Fragments
from render.scene import Body, Light, Scene
from render.shadow_map import ShadowMap, shadow_map
from render.sights import Sight, plain_sight, relief_sight, rotated, textured

NAME = "NumPy reference"

# Pixels that are shaded at once: bounds the memory of a material's texel taps.
_CHUNK = 32_768


class ReferenceRenderer:
    """Draws scenes without any graphics library; shadow maps have `shadow_px` pixels along each side."""

    name = NAME
    affordable_supersampling = 1

    def __init__(self, shadow_px: int = SIDE_PX) -> None:
        self.shadow_px = shadow_px

    def draw(self, scene: Scene) -> Picture:
        """The scene as its camera sees it; pixels that show nothing are 0 in radiance and coverage."""
        width, height = scene.camera.size
        radiance = np.zeros((height * width, 3), dtype=np.float32)
        coverage = np.zeros(height * width, dtype=np.float32)
        maps = self._shadow_maps(scene)
        for body, sight, footprint in visible(scene):
            lit = [np.ones(len(sight.pixel)) if each is None else each.lit(sight.point) for each in maps]
            radiance[sight.pixel] = shade(scene, body, sight, footprint, lit)
            coverage[sight.pixel] = 1.0
        return Picture(radiance.reshape(height, width, 3), coverage.reshape(height, width))

    def release(self) -> None:
        """Nothing is held."""

    def _shadow_maps(self, scene: Scene) -> list[ShadowMap | None]:
        """One for each light; none where bodies throw no shadows."""
        if not scene.shadows:
            return [None] * len(scene.lights)
        return [shadow_map(scene.bodies, light.direction, self.shadow_px) for light in scene.lights]


def visible(scene: Scene) -> Iterator[tuple[Body, Sight, Float64 | None]]:
    """Each body with what it shows and no other body hides, and the footprints of its pixels if its material asks."""
    found = [_seen(body, scene.camera) for body in scene.bodies]
    nearest = np.full(scene.camera.size[0] * scene.camera.size[1], np.inf)
    for sight, _ in found:
        np.minimum.at(nearest, sight.pixel, sight.distance)
    for body, (sight, footprint) in zip(scene.bodies, found, strict=True):
        seen = np.flatnonzero(sight.distance <= nearest[sight.pixel])
        yield body, sight.chosen(seen), None if footprint is None else footprint[seen]


def shade(scene: Scene, body: Body, sight: Sight, footprint: Float64 | None, lit: Sequence[Float64]) -> Float64:
    """Radiance (n, 3) of what the body shows under all lights, of each of which a share `lit` (n,) arrives."""
    radiance = np.zeros((len(sight.pixel), 3))
    for start in range(0, len(radiance), _CHUNK):
        part = slice(start, start + _CHUNK)
        seen, covered = sight.chosen(part), None if footprint is None else footprint[part]
        for light, share in zip(scene.lights, lit, strict=True):
            radiance[part] += light.irradiance * share[part, None] * _under(light, body, seen, covered)
        if any(scene.ambient):
            radiance[part] += np.array(scene.ambient) * _ambient(body, seen, covered)
    return radiance


def footprints(mesh: Mesh, camera: Camera, fragments: Fragments) -> Float64:
    """How texture coordinates change to the next pixel right and below on the same triangle, (n, 2, 2)."""
    here, _ = textured(mesh, fragments)
    ways = [textured(mesh, moved)[0] - here for moved in fragments.next_pixels(mesh, camera)]
    return np.stack(ways, axis=1)


def _seen(body: Body, camera: Camera) -> tuple[Sight, Float64 | None]:
    """What a body shows if nothing hides it."""
    if isinstance(body.material, Mesostructure):
        return relief_sight(body.mesh, body.material, camera), None
    sight, fragments = plain_sight(body.mesh, camera)
    return sight, footprints(body.mesh, camera, fragments) if has_levels(body.material) else None


def _under(light: Light, body: Body, sight: Sight, footprint: Float64 | None) -> Float64:
    """Radiance (n, 3) for unit irradiance: the cosine is that to the mesh, the direction is taken in tiles."""
    local = unit(rotated(sight.frames, np.broadcast_to(light.direction, sight.point.shape)))
    if isinstance(body.material, Mesostructure):
        return body.material.btf.evaluate(sight.uv, unit(local / sight.tile), sight.view) * np.maximum(
            local[:, 2:], 0.0
        )
    return outgoing(body.material, sight.uv, local, sight.view, footprint)


def _ambient(body: Body, sight: Sight, footprint: Float64 | None) -> Float64:
    """Radiance (n, 3) for unit irradiance from everywhere."""
    btf = body.material.btf if isinstance(body.material, Mesostructure) else body.material
    if isinstance(btf, FactoredBtf):
        return btf.ambient(sight.uv, sight.view)
    straight = np.broadcast_to([0.0, 0.0, 1.0], sight.view.shape)
    return outgoing(body.material, sight.uv, straight, sight.view, footprint)
