"""From scene points to pixels and back: pinhole, radial distortion, vignetting."""

import numpy as np

from simulators.layout import Array, CameraLayout
from simulators.scene import Floats

FALLOFF = 0.03  # loss of light in the corners beside the cosine law


def project(camera: CameraLayout, points_m: Array) -> Array:
    """Image points uv_px (n, 2) of rig-frame points (n, 3); pixel centres lie at integers."""
    turn, place = camera.rig_from_camera[:3, :3], camera.rig_from_camera[:3, 3]
    local = (points_m - place) @ turn
    plane = local[:, :2] / local[:, 2:]
    plane = plane * _distortion(camera, np.sum(plane**2, axis=1))[:, None]
    focal = camera.matrix[[0, 1], [0, 1]]
    image: Array = plane * focal + camera.matrix[:2, 2]
    return image


def rays(camera: CameraLayout, uv_px: Array) -> Array:
    """Unit directions (n, 3), rig frame, of the rays through image points (n, 2)."""
    distorted = (uv_px - camera.matrix[:2, 2]) / camera.matrix[[0, 1], [0, 1]]
    plane = distorted
    for _ in range(12):  # a fixed point: the factor differs from 1 by a few thousandths, so each round gains two digits
        plane = distorted / _distortion(camera, np.sum(plane**2, axis=1))[:, None]
    local = np.column_stack([plane, np.ones(len(plane))])
    directions: Array = local @ camera.rig_from_camera[:3, :3].T
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def sample_points(camera: CameraLayout, samples: int) -> Array:
    """Image points uv_px (h * w * samples^2, 2): samples x samples in each pixel, pixel by pixel."""
    inside = (np.arange(samples) + 0.5) / samples - 0.5
    v, u, dv, du = np.meshgrid(
        np.arange(camera.height_px), np.arange(camera.width_px), inside, inside, indexing="ij"
    )  # fmt: skip
    return np.column_stack([(u + du).ravel(), (v + dv).ravel()])


def vignette(camera: CameraLayout) -> Floats:
    """Share of the light (h, w) that reaches each pixel: the fourth power of the cosine, and a mild fall-off."""
    uv = sample_points(camera, 1)
    plane = (uv - camera.matrix[:2, 2]) / camera.matrix[0, 0]
    square = np.sum(plane**2, axis=1)
    corner = (camera.width_px**2 + camera.height_px**2) / (2 * camera.matrix[0, 0]) ** 2
    share = (1 - FALLOFF * square / corner) / (1 + square) ** 2
    return share.reshape(camera.height_px, camera.width_px).astype(np.float32)


def _distortion(camera: CameraLayout, square: Array) -> Array:
    k1, k2 = camera.distortion
    factor: Array = 1 + square * (k1 + square * k2)
    return factor
