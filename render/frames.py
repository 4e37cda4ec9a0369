"""Tangent frames per pixel: the NumPy side of shaders/frames.glsl."""

import numpy as np

from processing.products import sphere_uv, tangent_frames
from render.arrays import Float64, Rows, unit
from render.mesh import perpendicular


def vertex_frames(normal: Rows, tangent: Rows) -> Float64:
    """Rows t, b, n (n, 3, 3) from interpolated normals (n, 3) and tangents (n, 4): orthonormal, b = w n x t."""
    n = unit(normal)
    t = perpendicular(tangent[:, :3], n)
    b = np.where(tangent[:, 3:] < 0.0, -1.0, 1.0) * np.cross(n, t)
    return np.stack([t, b, n], axis=1)


def gradient_frames(normal: Rows, map_from_world: Rows) -> tuple[Float64, Float64]:
    """Texture coordinates (n, 2) and rows t, b, n (n, 3, 3) in the world frame, of a captured sphere.

    Both follow from the normal in the map's frame, as processing.products defines them. Beyond the map, where p or q
    leaves [-1, 1], the map is mirrored once, up to 3: nothing was measured there. The frame is not mirrored with it, so
    that the residual, and with it the colour, goes over the border without a step.
    """
    n = unit(normal) @ np.asarray(map_from_world, dtype=np.float64).T
    facing = n.copy()
    facing[:, 2] = np.minimum(n[:, 2], -1e-4)
    endless = np.clip(sphere_uv(facing), -1.0, 2.0)
    return 1.0 - np.abs(1.0 - np.abs(endless)), np.asarray(tangent_frames(n) @ map_from_world)
