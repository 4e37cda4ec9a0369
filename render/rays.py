"""The rays of a view as the shaders know them, one through each pixel of OpenGL's window."""

from dataclasses import dataclass

import numpy as np

from render.arrays import Float64, Rows
from render.camera import Camera, clip_from_parallel, clip_from_world, depth_range, image_from_window
from render.light_view import LightView


@dataclass(frozen=True, eq=False)
class Rays:
    """Start and direction of each ray, both linear in the window point (x, y, 1), and the projection onto the window.

    `toward_from_window` (3, 3) gives vectors, not of unit length, toward where the rays come from.
    """

    size: tuple[int, int]
    clip_from_world: Float64
    start_from_window: Float64
    toward_from_window: Float64


def camera_rays(camera: Camera, positions: Rows) -> Rays:
    """From the eye; positions (n, 3) are what is to be seen. Raises SceneError where all of it lies behind the eye."""
    start = np.zeros((3, 3))
    start[:, 2] = camera.eye
    clip = clip_from_world(camera, *depth_range(camera, positions))
    return Rays(camera.size, clip, start, toward_eye(camera))


def toward_eye(camera: Camera) -> Float64:
    """Vectors toward the eye, not of unit length, of window points (x, y, 1) as a matrix (3, 3)."""
    turn = camera.camera_from_world[:3, :3].T
    return np.asarray(-turn @ np.linalg.inv(camera.matrix) @ image_from_window(camera.size[1]))


def light_rays(view: LightView, positions: Rows) -> Rays:
    """From the plane before all bodies that distances count from."""
    axes, shift = view.image_from_world[:, :3], view.image_from_world[:, 3]
    back = np.linalg.inv(axes)
    plane = np.column_stack([back[:, 0], back[:, 1], -back @ shift])
    toward = np.zeros((3, 3))
    toward[:, 2] = -back[:, 2]
    size = (view.side_px, view.side_px)
    far = float(view.in_image(positions)[:, 2].max())
    return Rays(size, clip_from_parallel(view.image_from_world, size, far), plane @ image_from_window(size[1]), toward)
