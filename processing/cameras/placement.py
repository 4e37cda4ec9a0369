"""Where cameras and boards are to begin with: a consensus of all views, before bundle adjustment.

Through a long lens a plane has two poses that look nearly alike, mirrored about the line of sight (the Necker cube's
reversal). One view cannot tell them apart; the other cameras and the other boards can. So each camera and each board
takes, of all poses that any single view proposes for it, the one that most of its views agree with.
"""

from collections.abc import Callable, Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.cameras.board import BoardView
from processing.cameras.bundle import Camera, Network
from processing.errors import CalibrationError

Array = NDArray[np.float64]
Views = Mapping[str, Mapping[int, BoardView]]


def place(matrices: Mapping[str, Array], views: Views) -> Network:
    """Poses of cameras with known matrices (no distortion) and of the boards they see; board 0 is the rig frame.

    Raises CalibrationError that names the cameras which no chain of shared boards links to board 0.
    """
    proposed = {
        name: {pose: _two_poses(matrices[name], view) for pose, view in found.items()} for name, found in views.items()
    }
    cameras: dict[str, Array] = {}
    boards = {0: np.eye(4)}
    # A chain is at most as long as there are cameras; two more rounds let all of them outvote the first guesses.
    for _ in range(len(views) + 2):
        cameras = {
            name: _camera(matrices[name], found, proposed[name], boards)
            for name, found in views.items()
            if not boards.keys().isdisjoint(found)
        }
        seen = {pose for name in cameras for pose in views[name]} - {0}
        boards = {0: np.eye(4)} | {pose: _board(pose, matrices, views, proposed, cameras) for pose in sorted(seen)}
    lost = sorted(set(views) - set(cameras))
    if lost:
        raise CalibrationError(f"{', '.join(lost)}: no board pose links it to pose 0, which is the rig frame.")
    return Network({name: Camera(matrices[name], np.zeros(5), cameras[name]) for name in views}, boards)


def _two_poses(matrix: Array, view: BoardView) -> list[Array]:
    """Both camera_from_board that a plane's perspective allows (Collins and Bartoli 2014)."""
    _, turns, shifts, _ = cv2.solvePnPGeneric(view.points_m, view.uv_px, matrix, None, flags=cv2.SOLVEPNP_IPPE)
    return [geometry.rigid_from_vectors(turn, np.ravel(shift)) for turn, shift in zip(turns, shifts, strict=True)]


def _camera(
    matrix: Array, found: Mapping[int, BoardView], proposed: Mapping[int, list[Array]], boards: Mapping[int, Array]
) -> Array:
    """The camera_from_rig that most of the camera's views of known boards agree with."""
    known = [pose for pose in found if pose in boards]
    candidates = [own @ geometry.invert(boards[pose]) for pose in known for own in proposed[pose]]
    return _agreed(
        candidates, lambda candidate: [_error_px(matrix, candidate @ boards[pose], found[pose]) for pose in known]
    )


def _board(
    pose: int,
    matrices: Mapping[str, Array],
    views: Views,
    proposed: Mapping[str, Mapping[int, list[Array]]],
    cameras: Mapping[str, Array],
) -> Array:
    """The rig_from_board that most of the cameras which see the board agree with."""
    known = [name for name in cameras if pose in views[name]]
    candidates = [geometry.invert(cameras[name]) @ own for name in known for own in proposed[name][pose]]
    return _agreed(
        candidates,
        lambda candidate: [_error_px(matrices[n], cameras[n] @ candidate, views[n][pose]) for n in known],
    )


def _agreed(candidates: Sequence[Array], errors_px: Callable[[Array], list[float]]) -> Array:
    return min(candidates, key=lambda candidate: float(np.median(errors_px(candidate))))


def _error_px(matrix: Array, camera_from_board: Array, view: BoardView) -> float:
    """Root mean square distance of the corners, infinite behind the camera."""
    local = geometry.transform_points(camera_from_board, view.points_m)
    if (local[:, 2] <= 0).any():
        return float("inf")
    uv_px = (local @ matrix.T)[:, :2] / local[:, 2:]
    return float(np.sqrt(2 * np.mean((uv_px - view.uv_px) ** 2)))
