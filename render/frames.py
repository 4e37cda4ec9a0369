"""Tangent frames per pixel: the NumPy side of shaders/frames.glsl."""

import numpy as np

from render.arrays import Float64, Rows, unit
from render.mesh import perpendicular


def tangent_frames(normal: Rows, tangent: Rows) -> Float64:
    """Rows t, b, n (n, 3, 3) from interpolated normals (n, 3) and tangents (n, 4): orthonormal, b = w n x t."""
    n = unit(normal)
    t = perpendicular(tangent[:, :3], n)
    b = np.where(tangent[:, 3:] < 0.0, -1.0, 1.0) * np.cross(n, t)
    return np.stack([t, b, n], axis=1)


def gradient_frames(normal: Rows, map_from_world: Rows) -> tuple[Float64, Float64]:
    """Texture coordinates (n, 2) and rows t, b, n (n, 3, 3) in the world frame, of a captured sphere.

    In the map's frame p = -n_x / n_z and q = -n_y / n_z, and the map spans p, q in [-1, 1]: u = (p + 1) / 2,
    v = (q + 1) / 2. With sin(phi) = n_y and n_x = cos(phi) cos(theta): t = (sin(theta), 0, cos(theta)) along growing p
    and b = n x t; both are the paper's frame turned by half a turn about n, so that b runs against q as on every mesh.
    Where the sphere turns away from the capture's camera (n_z >= 0) the map's rim goes on.
    Source: Ma et al. 2004, 4.4 and 6.2.
    """
    n = unit(normal) @ np.asarray(map_from_world, dtype=np.float64).T
    facing = np.minimum(n[:, 2], -1e-4)
    uv = 0.5 - 0.5 * n[:, :2] / facing[:, None]
    cos_phi = np.sqrt(np.maximum(n[:, 0] ** 2 + n[:, 2] ** 2, 1e-12))
    zero = np.zeros(len(n))
    t = np.stack([-n[:, 2] / cos_phi, zero, n[:, 0] / cos_phi], axis=1)
    return uv, np.stack([t, np.cross(n, t), n], axis=1) @ map_from_world
