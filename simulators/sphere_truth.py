"""True reflectance maps of the sphere samples, for any lights and any eye."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from simulators.layout import Array, build_layout
from simulators.light import radiance
from simulators.samples.spheres import SPHERES
from simulators.scene import Floats
from simulators.scene_sphere import SphereScene

POINTS = 3  # of a cell, along each axis


def reflectance_maps(sample: str, seed: int, lights_m: Array, eye_m: Array, size: int) -> Floats:
    """Noise-free maps R(p, q) (n, size, size, 3), cosine inside, 1/sr, of a sphere at the origin without a card.

    Lights (n, 3) and eye (3,) are places, metres, rig frame. A camera at the eye looks at the origin with its rows
    level. See `maps_of`. Raises ValueError where no sphere has this sample's name.
    """
    if sample not in SPHERES:
        raise ValueError(f"{sample!r} is no sphere: one of {', '.join(SPHERES)}")
    alone = replace(build_layout(seed, "small").sphere, card_width_m=0.0, card_height_m=0.0)
    scene = SphereScene(alone, seed, SPHERES[sample])
    return maps_of(scene, lights_m, eye_m, camera_axes(eye_m), size)


def maps_of(scene: SphereScene, lights_m: Iterable[Array], eye_m: Array, axes: Array, size: int) -> Floats:
    """Maps (n, size, size, 3) under point lights at n places, toward an eye (3,); NaN where it does not see the sphere.

    Cell (row, column) spans 2 / size around p, q = (column, row + 0.5) * 2 / size - 1; the normal of a point in it is
    (p, q, -1) / |.| in the camera's axes (3, 3), columns x right, y down, z forward in the rig frame. Values: radiance
    over the irradiance on a surface at the same point that faces the lamp, mean over 3 x 3 points of the cell.
    """
    normals = gradient_normals(size, POINTS) @ axes.T
    hits = scene.normal_hits(normals)
    hidden = np.einsum("nk,nk->n", normals, eye_m - hits.points) <= 0
    maps = []
    for light_m in lights_m:
        square = np.sum((light_m - hits.points) ** 2, axis=1, keepdims=True)
        seen = radiance(hits, scene.lit(hits, light_m), light_m, eye_m, 1.0) * square
        seen[hidden] = np.nan
        maps.append(seen.reshape(size, size, POINTS**2, 3).mean(axis=2))
    return np.asarray(maps, np.float32)


def gradient_normals(size: int, points: int) -> Array:
    """Unit normals (size^2 * points^2, 3) of points that divide each cell of gradient space evenly, cell by cell."""
    inside = (np.arange(points) + 0.5) / points
    row, column, down, right = np.meshgrid(np.arange(size), np.arange(size), inside, inside, indexing="ij")
    p, q = ((at * 2 / size - 1).ravel() for at in (column + right, row + down))
    normals = np.column_stack([p, q, -np.ones_like(p)])
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def camera_axes(eye_m: Array) -> Array:
    """Axes (3, 3) of a level camera at the eye that looks at the origin: columns x right, y down, z forward."""
    outward = eye_m / np.linalg.norm(eye_m)
    azimuth_rad = np.arctan2(eye_m[1], eye_m[0])  # 0 for an eye in the zenith
    right = np.array([-np.sin(azimuth_rad), np.cos(azimuth_rad), 0.0])
    return np.column_stack([right, np.cross(-outward, right), -outward])
