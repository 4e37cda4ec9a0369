"""How an object moves before a camera and a laser that stand: on a turntable or a linear stage."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing import geometry

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Turn:
    """Turning about an axis through `point_m` (3,) along the unit vector `direction` (3,), camera frame.

    `step_rad` per frame, positive as a right-handed screw along `direction`. The object's frame has its origin in
    `point_m`, z along the axis and x toward the camera at frame 0.
    """

    point_m: Array
    direction: Array
    step_rad: float

    def camera_from_object(self, frame: float) -> Array:
        """The object's frame (4, 4) at a frame of the sequence, which need not be whole."""
        toward = -self.point_m + (self.point_m @ self.direction) * self.direction
        x = toward / np.linalg.norm(toward)
        start = geometry.rigid(np.stack([x, np.cross(self.direction, x), self.direction], axis=1), self.point_m)
        return start @ geometry.rotation_z(frame * self.step_rad)

    def depth(self, points_m: Array) -> Array:
        """How far within the object's reach points (..., 3) of its frame lie: minus their distance from the axis."""
        return np.asarray(-np.hypot(points_m[..., 0], points_m[..., 1]))

    def reversed(self) -> "Turn":
        """The same, turning the other way."""
        return Turn(self.point_m, self.direction, -self.step_rad)


@dataclass(frozen=True)
class Slide:
    """Moving along the unit vector `direction` (3,), camera frame, by `step_m` per frame.

    The object's frame is the camera's at frame 0.
    """

    direction: Array
    step_m: float

    def camera_from_object(self, frame: float) -> Array:
        """The object's frame (4, 4) at a frame of the sequence, which need not be whole."""
        return geometry.rigid(np.eye(3), frame * self.step_m * self.direction)

    def depth(self, points_m: Array) -> Array:
        """Distance of points (..., 3) along the optical axis, as far as that is square to the motion.

        Where the object moves along the optical axis itself, along that.
        """
        view = np.array([0.0, 0.0, 1.0]) - self.direction[2] * self.direction
        if np.linalg.norm(view) < 1e-3:
            view = self.direction
        return np.asarray(points_m @ (view / np.linalg.norm(view)))

    def reversed(self) -> "Slide":
        """The same, moving the other way."""
        return Slide(self.direction, -self.step_m)


Motion = Turn | Slide
