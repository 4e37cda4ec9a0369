"""From scene points to pixels and back: pinhole, radial distortion, vignetting."""

import numba
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
    directions = np.empty((len(uv_px), 3))
    matrix, (k1, k2) = camera.matrix, camera.distortion
    lens = (float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]), float(matrix[1, 2]), k1, k2)
    _rays(uv_px, lens, camera.rig_from_camera[:3, :3].copy(), directions)
    return directions


@numba.njit(cache=True)
def _rays(uv: Array, lens: tuple[float, float, float, float, float, float], turn: Array, out: Array) -> None:
    focal_u, focal_v, centre_u, centre_v, k1, k2 = lens
    for i in range(len(uv)):
        bent_x, bent_y = (uv[i, 0] - centre_u) / focal_u, (uv[i, 1] - centre_v) / focal_v
        x, y = bent_x, bent_y
        for _ in range(8):  # a fixed point: the factor is 1 to a few thousandths, so each round gains two digits
            square = x * x + y * y
            factor = 1 + square * (k1 + square * k2)
            x, y = bent_x / factor, bent_y / factor
        length = np.sqrt(x * x + y * y + 1)
        for k in range(3):
            out[i, k] = (turn[k, 0] * x + turn[k, 1] * y + turn[k, 2]) / length


def sample_points(camera: CameraLayout, samples: int) -> Array:
    """Image points uv_px (h * w * samples^2, 2): samples x samples in each pixel, pixel by pixel."""
    inside = (np.arange(samples) + 0.5) / samples - 0.5
    image = np.empty((camera.height_px, camera.width_px, samples, samples, 2))
    image[..., 0] = np.arange(camera.width_px)[None, :, None, None] + inside
    image[..., 1] = np.arange(camera.height_px)[:, None, None, None] + inside[:, None]
    return image.reshape(-1, 2)


def vignette(camera: CameraLayout) -> Floats:
    """Share of the light (h, w) that reaches each pixel: the fourth power of the cosine, and a mild fall-off."""
    uv = sample_points(camera, 1)
    plane = (uv - camera.matrix[:2, 2]) / camera.matrix[0, 0]
    square = np.sum(plane**2, axis=1)
    corner = (camera.width_px**2 + camera.height_px**2) / (2 * camera.matrix[0, 0]) ** 2
    share: Array = (1 - FALLOFF * square / corner) / (1 + square) ** 2
    return share.reshape(camera.height_px, camera.width_px).astype(np.float32)


def _distortion(camera: CameraLayout, square: Array) -> Array:
    k1, k2 = camera.distortion
    factor: Array = 1 + square * (k1 + square * k2)
    return factor
