"""The camera, and the one place that knows OpenGL's frame.

Everywhere else cameras are OpenCV's: x right, y down, z forward, pixel centres at integers, rows downward. OpenGL
has y upward, window pixels centred at halves, and reads its rows from the bottom; that is dealt with in
`clip_from_world`, `clip_from_parallel`, `image_from_window` and `rows_from_gl`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from render.arrays import Float64, Rows, unit
from render.errors import SceneError


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera without distortion.

    Intrinsic `matrix` (3, 3) in pixels, rigid `camera_from_world` (4, 4), `size` (width, height).
    """

    matrix: Float64
    camera_from_world: Float64
    size: tuple[int, int]

    @property
    def eye(self) -> Float64:
        """Centre of projection in the world frame, (3,)."""
        rotation = self.camera_from_world[:3, :3]
        return np.asarray(-rotation.T @ self.camera_from_world[:3, 3])

    def projected(self, points: Rows) -> Float64:
        """World points (n, 3) as homogeneous image points: column times depth, row times depth, depth."""
        return np.asarray(self.in_camera(points) @ self.matrix.T)

    def distance(self, points: Rows) -> Float64:
        """From the eye to world points (n, 3)."""
        return np.asarray(np.linalg.norm(points - self.eye, axis=1))

    def toward(self, points: Rows) -> Float64:
        """Unit vectors (n, 3) from world points to the eye."""
        return unit(self.eye - points)

    def scaled(self, factor: int) -> "Camera":
        """The same view with `factor` times as many pixels along each side."""
        matrix = self.matrix.copy()
        matrix[:2] *= factor
        # A pixel centred at an integer splits into `factor` pixels around it: their first centre lies before it.
        matrix[:2, 2] += (factor - 1) / 2
        return replace(self, matrix=matrix, size=(self.size[0] * factor, self.size[1] * factor))

    def resized(self, size: tuple[int, int]) -> "Camera":
        """The same view in another window: the shorter side keeps its field of view, the centre stays in the centre."""
        factor = min(size) / min(self.size)
        matrix = self.matrix.copy()
        matrix[:2, :2] *= factor
        for axis in (0, 1):
            old_centre = (self.size[axis] - 1) / 2
            matrix[axis, 2] = (size[axis] - 1) / 2 + factor * (self.matrix[axis, 2] - old_centre)
        return replace(self, matrix=matrix, size=size)

    def in_camera(self, points: Rows) -> Float64:
        """World points (n, 3) in the camera frame, z forward."""
        return np.asarray(points @ self.camera_from_world[:3, :3].T + self.camera_from_world[:3, 3])


def look_at(
    eye: Rows, target: Rows, size: tuple[int, int], *, field_of_view_rad: float, up: Sequence[float] = (0.0, 0.0, 1.0)
) -> Camera:
    """A camera at `eye` with `target` in the middle of the picture and `up` upward.

    `field_of_view_rad` is the full angle of the shorter side. Raises SceneError where eye and target coincide or the
    view is parallel to `up`.
    """
    eye, target = np.asarray(eye, dtype=np.float64), np.asarray(target, dtype=np.float64)
    forward = unit(target - eye)
    right = np.cross(forward, np.asarray(up, dtype=np.float64))
    if np.linalg.norm(right) < 1e-9:
        raise SceneError(f"camera at {eye.tolist()} looking at {target.tolist()}: no direction is right of it")
    right = unit(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = rotation
    camera_from_world[:3, 3] = -rotation @ eye
    focal_px = 0.5 * min(size) / np.tan(0.5 * field_of_view_rad)
    centre_px = [(size[0] - 1) / 2, (size[1] - 1) / 2]
    matrix = np.array([[focal_px, 0.0, centre_px[0]], [0.0, focal_px, centre_px[1]], [0.0, 0.0, 1.0]])
    return Camera(matrix, camera_from_world, size)


def depth_range(camera: Camera, points: Rows) -> tuple[float, float]:
    """Near and far plane around the world points (n, 3); raises SceneError where nothing lies before the camera."""
    depth = camera.in_camera(points)[:, 2]
    far = float(depth.max()) * 1.01
    if far <= 0.0:
        raise SceneError(f"nothing before the camera: the mesh lies behind the eye at {camera.eye.tolist()}")
    return max(float(depth.min()) * 0.99, far * 1e-3), far


def clip_from_world(camera: Camera, near: float, far: float) -> Float64:
    """OpenGL's clip coordinates (4, 4) from world points, near and far as depths along the camera's z.

    The window's x is u + 1/2 and its y is height - (v + 1/2) for the image point (u, v), so that both rasterise the
    same pixels at the same points.
    """
    width, height = camera.size
    clip_from_camera = np.zeros((4, 4))
    clip_from_camera[0, :3] = 2.0 * camera.matrix[0] / width
    clip_from_camera[0, 2] += 1.0 / width - 1.0
    clip_from_camera[1, :3] = -2.0 * camera.matrix[1] / height
    clip_from_camera[1, 2] += 1.0 - 1.0 / height
    clip_from_camera[2, 2:] = (far + near) / (far - near), -2.0 * far * near / (far - near)
    clip_from_camera[3, 2] = 1.0
    return np.asarray(clip_from_camera @ camera.camera_from_world)


def clip_from_parallel(image_from_world: Rows, size: tuple[int, int], far: float) -> Float64:
    """The same (4, 4) for parallel rays: `image_from_world` (3, 4) gives image points and distances from 0 to `far`."""
    width, height = size
    clip_from_image = np.zeros((4, 4))
    clip_from_image[0, [0, 3]] = 2.0 / width, 1.0 / width - 1.0
    clip_from_image[1, [1, 3]] = -2.0 / height, 1.0 - 1.0 / height
    # A little room at both ends, so that nothing is cut off by rounding.
    clip_from_image[2, [2, 3]] = 1.9 / far, -0.95
    clip_from_image[3, 3] = 1.0
    return np.asarray(clip_from_image @ np.vstack([image_from_world, [0.0, 0.0, 0.0, 1.0]]))


def image_from_window(height: int) -> Float64:
    """Image points (u, v, 1) of OpenGL's window points (x, y, 1) as a matrix (3, 3)."""
    return np.array([[1.0, 0.0, -0.5], [0.0, -1.0, height - 0.5], [0.0, 0.0, 1.0]])


def rows_from_gl(image: Rows) -> Rows:
    """An image read from a framebuffer, its first row on top."""
    return np.ascontiguousarray(image[::-1])
