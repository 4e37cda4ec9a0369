"""Gradient space and tangent frames of the sphere that a reflectance map is taken from.

All of it is in the camera frame turned to the sphere: x right (image column), y down (image row), z from the
camera into the scene, so that the visible normals are n = (p, q, -1) / |(p, q, -1)|. A rig whose camera stands at
azimuth 0 and looks along -X has x = +Y, y = -Z, z = -X of the rig frame.
"""

import numpy as np

from processing.products.arrays import Float64


def gradient_grid(size: int) -> Float64:
    """p (and q) at the texel centres of a map over [-1, 1], (size,)."""
    return np.asarray((np.arange(size) + 0.5) * (2 / size) - 1, np.float64)


def sphere_normals(size: int) -> Float64:
    """Unit normals (q, p, 3) of a size x size reflectance map: row = q downward, column = p to the right."""
    p, q = np.meshgrid(gradient_grid(size), gradient_grid(size))
    return normals_of(p, q)


def normals_of(p: Float64, q: Float64) -> Float64:
    """n = (p, q, -1) / |(p, q, -1)|, with a last axis of 3."""
    length = np.sqrt(p * p + q * q + 1)
    return np.stack([p / length, q / length, -1 / length], axis=-1)


def sphere_uv(normal: Float64) -> Float64:
    """Texture coordinates (n, 2) in the map of unit normals (n, 3): p = -n_x / n_z, q = -n_y / n_z over [-1, 1]."""
    return (1 - normal[..., :2] / normal[..., 2:]) / 2


def tangent_frames(normal: Float64) -> Float64:
    """Rows t, b, n (..., 3, 3): right-handed, t along +p, b against +q (to the top of the image).

    With phi = arcsin(n_y) and n = (cos phi cos theta, sin phi, -cos phi sin theta) these are
    t = (sin theta, 0, cos theta), b = (sin phi cos theta, -cos phi, -sin phi sin theta): the paper's t and b turned
    by half a turn about n, so that they run along +u and against +v like those of any textured mesh. No angle is
    computed: cos phi cos theta and cos phi sin theta are components of n. At cos phi = 0 theta is pi / 2.
    Source: Ma et al. 2004, 4.4; its bracket for theta is misprinted, arccos(n_x / cos phi) is meant.
    """
    n_x, n_y, n_z = normal[..., 0], normal[..., 1], normal[..., 2]
    cos_phi = np.hypot(n_x, n_z)
    pole = cos_phi == 0
    safe = np.where(pole, 1.0, cos_phi)
    cos_theta = n_x / safe
    sin_theta = np.where(pole, 1.0, -n_z / safe)
    tangent = np.stack([sin_theta, np.zeros_like(n_x), cos_theta], axis=-1)
    binormal = np.stack([n_y * cos_theta, -cos_phi, -n_y * sin_theta], axis=-1)
    return np.stack([tangent, binormal, normal], axis=-2)
