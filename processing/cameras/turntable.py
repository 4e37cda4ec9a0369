"""The turntable's axis, from boards that were photographed at several of its angles."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.cameras.lens import Lens
from processing.cameras.network import Camera, Network, Shot
from processing.cameras.placement import Placed
from processing.errors import CalibrationError

Array = NDArray[np.float64]
MAX_TILT_DEVIATION_RAD = np.radians(0.1)  # as well as a hand lays the board down
_LEAST_TURN_RAD = np.radians(2.0)  # below it a turn's axis is mostly noise
_DISAGREEMENT_RAD = np.radians(5.0)  # a first placement is good to a degree or two


@dataclass(frozen=True)
class Axis:
    """The turntable's axis as seen from the board of pose 0, and its one-sigma uncertainties.

    `direction` (3,) is a unit vector and `point_m` (3,) the axis' point at the height of the board's centre, both in
    the board frame. `tilt_deviation_rad` (2,) are about the rig frame's X and Y, `place_deviation_m` (2,) along them.
    """

    direction: Array
    point_m: Array
    tilt_deviation_rad: Array
    place_deviation_m: Array

    @property
    def tilt_rad(self) -> float:
        """Angle from the board's normal to the axis."""
        return float(np.arctan2(np.hypot(*self.direction[:2]), self.direction[2]))


def axis_of(network: Network, covariance: Array) -> Axis:
    """The axis of an adjusted network with turned boards. Raises CalibrationError where they turned by too little."""
    board = network.boards[0]
    variance = np.diag(covariance)[network.board_slices()[0]]
    deviation = np.sqrt(np.maximum(variance, 0))
    if not (deviation[:2] <= MAX_TILT_DEVIATION_RAD).all():
        raise CalibrationError(
            f"the turned boards leave the turntable's axis uncertain by {np.degrees(deviation[:2].max()):.2g} deg; "
            "photograph pose 0 at angles all around."
        )
    return Axis(board[2, :3].copy(), -board[:3, :3].T @ board[:3, 3], deviation[:2], deviation[2:])


def network_of(placed: Placed, lenses: Mapping[str, Lens]) -> Network:
    """The placed cameras and boards in the rig frame.

    Where a pose was photographed at several angles of the turntable, Z is the axis: the board of pose 0 has its centre
    at z = 0 and its right toward +X when the turntable stands at 0. Otherwise the board of pose 0 is the rig frame.
    Raises CalibrationError where the boards did not turn as the turntable is said to have.
    """
    turns = _turns(placed.boards)
    rig_from_first = geometry.invert(_first_from_axis(turns)) if turns else np.eye(4)
    boards = {
        shot: geometry.rotation_z(-shot.turntable_rad) @ rig_from_first @ board for shot, board in placed.boards.items()
    }
    first_from_rig = geometry.invert(rig_from_first)
    cameras = {name: Camera(lenses[name], pose @ first_from_rig) for name, pose in placed.cameras.items()}
    network = Network(cameras, {pose: _middle(pose, boards) for pose in {shot.pose for shot in boards}}, bool(turns))
    return network.seen_from(_level(network.boards[0]) if turns else geometry.invert(network.boards[0]))


@dataclass(frozen=True)
class _Turn:
    """What took a board from one shot to another: a motion in the first board's frame, and what the turntable says."""

    motion: Array
    angle_rad: float

    @property
    def vector(self) -> Array:
        """Rotation vector (3,), along the axis and upward for a turn from +X toward +Y."""
        vector = cv2.Rodrigues(self.motion[:3, :3])[0].ravel()
        # The first board lies on the turntable, so that the axis is about its z; near half a turn both senses fit.
        upward = vector if vector[2] >= 0 else -vector
        return np.asarray(upward / np.linalg.norm(upward), np.float64)

    @property
    def disagreement_rad(self) -> float:
        """Angle between the turn that was seen and that about the same axis by the turntable's angle."""
        told = geometry.rigid_from_vectors(self.vector * self.angle_rad, np.zeros(3))[:3, :3]
        return float(np.linalg.norm(cv2.Rodrigues(told @ self.motion[:3, :3].T)[0]))


def _turns(boards: Mapping[Shot, Array]) -> list[_Turn]:
    """All pairs of shots of one pose at different angles. Raises CalibrationError where the angles are not theirs."""
    pairs = [(a, b) for a, b in combinations(sorted(boards), 2) if a.pose == b.pose]
    if not pairs:
        return []
    turns = [_Turn(boards[b] @ geometry.invert(boards[a]), b.turntable_rad - a.turntable_rad) for a, b in pairs]
    turns = [turn for turn in turns if np.linalg.norm(cv2.Rodrigues(turn.motion[:3, :3])[0]) > _LEAST_TURN_RAD]
    if not turns:
        raise CalibrationError("the boards did not turn with the turntable; photograph them at angles far apart.")
    off = np.median([turn.disagreement_rad for turn in turns])
    if off > _DISAGREEMENT_RAD:
        raise CalibrationError(
            f"the boards turned otherwise than the turntable's angles say, by {np.degrees(off):.0f} deg in the middle; "
            "check the turntable's direction and that the board was not moved between turned shots."
        )
    return turns


def _first_from_axis(turns: list[_Turn]) -> Array:
    """A frame on the axis: Z along it, origin somewhere on it."""
    direction = np.median([turn.vector for turn in turns], axis=0)
    direction /= np.linalg.norm(direction)
    # Points of the axis stay: (1 - R) p = t for each motion (R, t), besides how far along it.
    left = np.concatenate([np.eye(3) - turn.motion[:3, :3] for turn in turns])
    right = np.concatenate([turn.motion[:3, 3] for turn in turns])
    point = np.linalg.lstsq(left, right, rcond=1e-3)[0]
    return geometry.rigid(_frame(direction), point)


def _frame(z: Array) -> Array:
    """Rotation (3, 3) whose third column is z and whose first lies nearest to (1, 0, 0)."""
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _level(rig_from_board: Array) -> Array:
    """The motion about and along Z that brings a board's centre to z = 0 and its right to azimuth 0."""
    turn = geometry.rotation_z(-float(np.arctan2(rig_from_board[1, 0], rig_from_board[0, 0])))
    return turn @ geometry.rigid(np.eye(3), [0, 0, -rig_from_board[2, 3]])


def _middle(pose: int, boards: Mapping[Shot, Array]) -> Array:
    """Of all places that a pose's shots give it, the one that is nearest to the others."""
    places = np.stack([board for shot, board in sorted(boards.items()) if shot.pose == pose])
    apart = np.linalg.norm(places[:, None, :3, :3] - places[None, :, :3, :3], axis=(2, 3))
    return np.asarray(places[np.argmin(np.median(apart, axis=1))], np.float64)
