"""Noise-free photographs of a textured plane, by tracing every pixel's ray to it."""

import numpy as np

from processing import geometry
from processing.cameras.calibration import CameraModel
from processing.cameras.lens import Pinhole
from processing.radiometry.hdr import Radiance
from processing.radiometry.mosaic import cfa_channels

SIZE = (240, 320)
MATRIX = np.array([[2000.0, 0, 161], [0, 2004, 118], [0, 0, 1]])
DISTORTION = np.array([-0.1, 0, 0, 0, 0])
RGGB = np.array([[0, 1], [1, 2]], np.uint8)


def camera_at(elevation_deg):
    e = np.radians(elevation_deg)
    pose = geometry.look_at(np.array([np.cos(e), 0, np.sin(e)]), np.zeros(3))
    return CameraModel(Pinhole(MATRIX, DISTORTION), pose, SIZE)


def photograph(camera, rig_from_sample, radiance_at):
    """Noise-free colour image of the plane z = 0: `radiance_at` of sample-frame points (h, w, 3)."""
    met = geometry.intersect_plane(camera.centre_m, camera.pixel_rays(), [0, 0, 1], 0.0)
    points = geometry.transform_points(geometry.invert(rig_from_sample), met)
    value = radiance_at(points).astype(np.float32)
    return Radiance(value, np.ones_like(value), np.zeros(value.shape, np.uint8))


def mosaic_of(colour):
    channels = cfa_channels(RGGB, colour.value.shape[:2])[..., None]
    value, variance = (np.take_along_axis(a, channels, -1)[..., 0] for a in (colour.value, colour.variance))
    return Radiance(value, variance, np.zeros(value.shape, np.uint8))


def waves(points):
    """A smooth texture of 15 mm period, thirty pixels, three channels."""
    x, y = points[..., 0] / 0.015 * 2 * np.pi, points[..., 1] / 0.015 * 2 * np.pi
    return np.stack([2 + np.sin(x), 2 + np.cos(y), 2 + np.sin(x + y)], axis=-1)
