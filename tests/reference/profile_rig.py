"""A small forward model of a scanner: a fixed camera and laser plane, a sphere, cylinder or stepped block that moves.

Rays are cut with surfaces in closed form; a surface point shines by its distance from the laser's plane. Camera frame,
metres. It shares nothing with processing but the setup that it is given.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from processing.laser.motion import Slide, Turn
from processing.laser.plane_fit import Plane
from processing.laser.profile_scan import ScanSetup

SIZE = (176, 216)
MATRIX = np.array([[800.0, 0, 107.5], [0, 800.0, 87.5], [0, 0, 1]])
AXIS_M = np.array([0.0, 0.0, 0.4])
TURN = Turn(AXIS_M, np.array([0.0, -1.0, 0.0]), np.radians(6.0))
SLIDE = Slide(np.array([1.0, 0.0, 0.0]), 0.0015)


def laser_plane():
    """Through the turntable's axis, from 32 deg beside the camera."""
    normal = np.array([np.cos(np.radians(32)), 0.0, np.sin(np.radians(32))])
    return Plane(normal, float(normal @ AXIS_M), np.nan, 0)


def setup(motion=TURN, **more):
    return ScanSetup(MATRIX, np.array([-0.1, 0.03, 0.0, 0.0, 0.0]), laser_plane(), motion, **more)


@dataclass(frozen=True)
class Ball:
    """A sphere beside the object frame's z axis."""

    centre_m: tuple = (0.01, 0.005, 0.0)
    radius_m: float = 0.035

    def cut(self, start, rays):
        """Distance along unit rays (..., 3) to the surface, inf where they miss."""
        to = start - np.array(self.centre_m)
        along = rays @ to
        root = along**2 - (to @ to - self.radius_m**2)
        return np.where(root > 0, -along - np.sqrt(np.abs(root)), np.inf)

    def distance(self, points):
        return np.linalg.norm(points - np.array(self.centre_m), axis=-1) - self.radius_m


@dataclass(frozen=True)
class Cylinder:
    """Upright beside the object frame's z axis, without ends."""

    centre_m: tuple = (0.008, -0.004)
    radius_m: float = 0.03

    def cut(self, start, rays):
        flat, to = rays[..., :2], start[:2] - np.array(self.centre_m)
        square, along = (flat**2).sum(axis=-1), flat @ to
        root = along**2 - square * (to @ to - self.radius_m**2)
        return np.where(root > 0, (-along - np.sqrt(np.abs(root))) / square, np.inf)

    def distance(self, points):
        return np.linalg.norm(points[..., :2] - np.array(self.centre_m), axis=-1) - self.radius_m


@dataclass(frozen=True)
class Step:
    """Two planes that face the camera, 12 mm apart, in the object's frame at frame 0."""

    near_m: float = 0.394
    far_m: float = 0.406
    edge_m: float = -0.02

    def cut(self, start, rays):
        near, far = ((z - start[2]) / rays[..., 2] for z in (self.near_m, self.far_m))
        return np.where((start + near[..., None] * rays)[..., 0] < self.edge_m, near, far)

    def distance(self, points):
        return np.where(points[..., 0] < self.edge_m, points[..., 2] - self.near_m, points[..., 2] - self.far_m)


def pattern(points):
    """Albedo (...) of surface points: a few waves in all directions."""
    x, y, z = np.moveaxis(points, -1, 0) * 2 * np.pi / 0.009
    return 0.6 + 0.13 * (np.sin(x + 0.7 * z) + np.sin(0.8 * y - z + 1) + np.sin(1.3 * z + 0.4 * x))


def rays(setup):
    """Unit rays (h, w, 3) of all pixels."""
    uv = np.stack(np.indices(SIZE, float)[::-1], axis=-1).reshape(-1, 1, 2)
    flat = cv2.undistortPoints(uv, setup.matrix, setup.distortion, criteria=(3, 100, 1e-14)).reshape(*SIZE, 2)
    ahead = np.concatenate([flat, np.ones((*SIZE, 1))], axis=-1)
    return ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)


def take_all(setup, shape, count, *, width_m=0.0006, laser=150.0, room=60.0, albedo=pattern):
    """A sequence (t, h, w, 3) uint8 of the object under a red laser and the room's grey light, one count of noise."""
    frames, ray, rng = [], rays(setup), np.random.default_rng(0)
    for frame in range(count):
        placed = setup.motion.camera_from_object(frame)
        into = placed[:3, :3].T
        start, turned = -into @ placed[:3, 3], ray @ into.T
        depth = shape.cut(start, turned)
        hit = np.isfinite(depth)
        depth = np.where(hit, depth, 1.0)[..., None]
        paint = np.where(hit, albedo(start + depth * turned), 0.0)
        across = (depth * ray) @ setup.plane.normal - setup.plane.offset_m
        image = np.repeat((room * paint)[..., None], 3, axis=-1)
        image[..., 0] += paint * laser * np.exp(-0.5 * (across / width_m) ** 2)
        frames.append(np.clip(np.rint(image + rng.normal(0, 1, image.shape)), 0, 255).astype(np.uint8))
    return np.stack(frames)
