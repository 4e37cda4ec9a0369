"""The test of silhouettes of Wang et al. 2005, 4.1, in NumPy: straight rays, offsets of front and back face."""

from dataclasses import replace

import numpy as np

from processing.products import Mesostructure
from render.march import Entry, march, meets, tile_scale
from render.mesh import Mesh
from render.peeling import Layer, layers
from render.picture import Picture
from render.reference import shade
from render.scene import Scene
from render.sights import Sight, entries


def draw(scene: Scene) -> Picture:
    """A scene of one closed body that is covered with a `Mesostructure`, without shadows of bodies.

    The surface counts as flat around where a ray enters and around where it leaves; of a layer that the ray hits the
    BTF is asked where the ray enters. Rays flatter than measured are treated as `march` does.
    Raises ValueError for another scene.
    """
    (body,) = scene.bodies
    if not isinstance(body.material, Mesostructure):
        raise ValueError("the paper's test is of a sample with depths")
    width, height = scene.camera.size
    radiance, coverage = np.zeros((height * width, 3), np.float32), np.zeros(height * width, np.float32)
    for layer in layers(body.mesh, scene.camera):
        sight = _met(body.mesh, body.material, layer.chosen(coverage[layer.front.pixel] == 0.0), scene)
        radiance[sight.pixel] = shade(scene, body, sight, None, [np.ones(len(sight.pixel))] * len(scene.lights))
        coverage[sight.pixel] = 1.0
    return Picture(radiance.reshape(height, width, 3), coverage.reshape(height, width))


def _met(mesh: Mesh, structure: Mesostructure, layer: Layer, scene: Scene) -> Sight:
    """The rays of a layer that hit."""
    entry, frames = entries(mesh, layer.front, scene.camera)
    behind, _ = entries(mesh, layer.back, scene.camera, backward=True)
    front, back = march(structure, _flat(entry), 1), march(structure, _flat(behind), 1)
    tile = np.column_stack([entry.stretch, tile_scale(entry)])
    point = layer.front.interpolate(mesh, mesh.positions)
    seen = Sight(layer.front.pixel, layer.entry, point, front.uv, front.view, frames, tile)
    return seen.chosen(meets(front, back, layer.exit - layer.entry))


def _flat(entry: Entry) -> Entry:
    return replace(entry, bending=np.zeros_like(entry.bending))
