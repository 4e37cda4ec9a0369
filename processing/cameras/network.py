"""Cameras, boards and the turntable that carries them: what an adjustment moves, and in which frame."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.cameras.board import BoardView
from processing.cameras.lens import Lens

Array = NDArray[np.float64]
POSE_PARAMETERS = 6  # turn about x y z from the left, then shift
_ALL, _NONE = tuple(range(POSE_PARAMETERS)), ()
_ON_THE_AXIS = (0, 1, 3, 4)  # azimuth and height of pose 0 are held: they say where the rig frame's +X and z = 0 are


@dataclass(frozen=True, order=True, slots=True)
class Shot:
    """One photographed stand of the board: the pose that a hand gave it, and where the turntable then stood."""

    pose: int
    turntable_rad: float = 0.0


Views = Mapping[str, Mapping[Shot, BoardView]]  # camera, shot


@dataclass(frozen=True)
class Camera:
    """A camera under adjustment."""

    lens: Lens
    camera_from_rig: Array

    @property
    def parameters(self) -> int:
        """Those of the lens and of the pose."""
        return self.lens.parameters + POSE_PARAMETERS

    def moved(self, step: Array) -> "Camera":
        """The camera after a step of all parameters."""
        own = self.lens.parameters
        return Camera(self.lens.moved(step[:own]), moved(self.camera_from_rig, step[own:]))


@dataclass(frozen=True)
class Network:
    """Cameras by name; `boards` by pose, as `rig_from_board` with the turntable at 0.

    With `turned` the rig frame's Z is the turntable's axis: azimuth and height of pose 0 are held, its tilt and place
    are adjusted. Without, pose 0 is the rig frame and all of it is held.
    """

    cameras: Mapping[str, Camera]
    boards: Mapping[int, Array]
    turned: bool

    def rig_from_board(self, shot: Shot) -> Array:
        """Where the board was in a shot."""
        board: Array = geometry.rotation_z(shot.turntable_rad) @ self.boards[shot.pose]
        return board

    def free(self, pose: int) -> tuple[int, ...]:
        """Which of the pose's six parameters are adjusted."""
        return _ALL if pose != 0 else _ON_THE_AXIS if self.turned else _NONE

    def camera_slices(self) -> dict[str, slice]:
        """Places of the cameras' parameters among all."""
        places, start = {}, 0
        for name, camera in self.cameras.items():
            places[name] = slice(start, start + camera.parameters)
            start = places[name].stop
        return places

    def board_slices(self) -> dict[int, slice]:
        """Places of the poses' free parameters among all, after the cameras'."""
        places, start = {}, sum(camera.parameters for camera in self.cameras.values())
        for pose in sorted(self.boards):
            places[pose] = slice(start, start + len(self.free(pose)))
            start = places[pose].stop
        return places

    @property
    def parameters(self) -> int:
        """Number of adjusted numbers."""
        cameras = sum(camera.parameters for camera in self.cameras.values())
        return cameras + sum(len(self.free(pose)) for pose in self.boards)

    def moved(self, step: Array) -> "Network":
        """The network after a step of all parameters; turns act from the left."""
        places = self.camera_slices()
        cameras = {name: camera.moved(step[places[name]]) for name, camera in self.cameras.items()}
        boards = {}
        for pose, place in self.board_slices().items():
            whole = np.zeros(POSE_PARAMETERS)
            whole[list(self.free(pose))] = step[place]
            boards[pose] = moved(self.boards[pose], whole)
        return replace(self, cameras=cameras, boards=boards)

    def seen_from(self, new_from_rig: Array) -> "Network":
        """The same network in another frame on the same axis."""
        rig_from_new = geometry.invert(new_from_rig)
        cameras = {name: Camera(c.lens, c.camera_from_rig @ rig_from_new) for name, c in self.cameras.items()}
        return replace(self, cameras=cameras, boards={k: new_from_rig @ board for k, board in self.boards.items()})


def moved(transform: Array, step: Array) -> Array:
    """A rigid transform after a small turn from the left and a shift."""
    turn = geometry.rigid_from_vectors(step[:3], np.zeros(3))[:3, :3]
    return geometry.rigid(turn @ transform[:3, :3], transform[:3, 3] + step[3:])
