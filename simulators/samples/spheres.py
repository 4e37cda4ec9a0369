"""Materials of spheres, by the sample's name: what a unit sphere's places look like."""

from collections.abc import Callable, Mapping

import numpy as np

from simulators.samples.brushed import brushed
from simulators.samples.cloth import cloth
from simulators.samples.space_noise import fractal, tilted_normals
from simulators.samples.stone import stone
from simulators.scene import Array, Below, Floats, Material

Surface = Callable[[Array, int], tuple[Floats, Material]]  # unit vectors (n, 3) and seed to normals (n, 3) and material

GLAZE, GLAZE_GLOSS = (0.06, 0.21, 0.29), (0.045, 0.24)  # albedo of the body; specular and roughness of the glaze
WAX, WAX_GLOSS = (0.78, 0.55, 0.30), (0.040, 0.45)
# Red, green and blue go 27, 21 and 15 deg past the terminator, 13 to 23 mm on a ball of 50 mm radius: like candle wax,
# by eye.
WAX_SPREAD = (0.45, 0.36, 0.26)


def glaze(unit: Array, seed: int) -> tuple[Floats, Material]:
    """A smooth dielectric over a body of one colour; the same for every seed."""
    none = np.zeros((len(unit), 3), np.float32)
    return unit.astype(np.float32), _covered(np.tile(GLAZE, (len(unit), 1)), none, GLAZE_GLOSS)


def wax(unit: Array, seed: int) -> tuple[Floats, Material]:
    """Wax with soft dents and clouds: light goes below its surface past the terminator, red the furthest."""
    cloud = fractal(unit * 2.5 + 4.7, seed + 20, 3)
    albedo = np.clip(np.array(WAX) * (1 + 0.25 * cloud[:, None]), 0.05, 0.95)
    spread = np.tile(np.array(WAX_SPREAD, np.float32), (len(unit), 1))
    dents = np.full(len(unit), 0.02)
    normals = tilted_normals(unit, lambda place: fractal(place * 3.0, seed + 21, 2) / 3.0, dents)
    return normals, _covered(albedo, spread, WAX_GLOSS)


def _covered(albedo: Array, spread: Floats, gloss: tuple[float, float]) -> Material:
    """A body below an even, glossy surface."""
    count = len(albedo)
    specular, roughness = (np.full(count, value, np.float32) for value in gloss)
    return Material(np.zeros((count, 3), np.float32), specular, roughness, Below(albedo.astype(np.float32), spread))


SPHERES: Mapping[str, Surface] = {
    "sphere": stone,
    "sphere-glaze": glaze,
    "sphere-wax": wax,
    "sphere-cloth": cloth,
    "sphere-brushed": brushed,
}
