"""Where cameras and boards are to begin with: a consensus of all views, before bundle adjustment.

Through a long lens a plane has two poses that look nearly alike, mirrored about the line of sight (the Necker cube's
reversal). One view cannot tell them apart; the other cameras and the other boards can. So each camera and each board
takes, of all poses that any single view proposes for it, the one that most of its views agree with.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.cameras.board import MIN_CORNERS, BoardView
from processing.cameras.lens import Lens
from processing.cameras.network import Shot, Views
from processing.errors import CalibrationError

Array = NDArray[np.float64]
Key = TypeVar("Key")
Poses = Mapping[str, Mapping[Shot, Array]]  # camera, shot: proposed camera_from_board (c, 4, 4)


@dataclass(frozen=True)
class Placed:
    """`camera_from_first` of every camera and `first_from_board` of every shot, in the frame of the first board."""

    cameras: Mapping[str, Array]
    boards: Mapping[Shot, Array]


def place(lenses: Mapping[str, Lens], views: Views) -> Placed:
    """Poses of cameras with known lenses and of the boards they see, in the frame of pose 0's first shot.

    Raises CalibrationError that names the cameras which no chain of shared boards links to pose 0.
    """
    first = min((shot for found in views.values() for shot in found if shot.pose == 0), default=None)
    proposed = {
        name: {shot: board_poses(lenses[name], view) for shot, view in found.items()} for name, found in views.items()
    }
    cameras: dict[str, Array] = {}
    boards = {} if first is None else {first: np.eye(4)}
    # A chain is at most as long as there are cameras; two more rounds let all of them outvote the first guesses.
    for _ in range(len(views) + 2):
        before = (cameras, boards)
        cameras = {
            name: _camera(lenses[name], found, proposed[name], boards)
            for name, found in views.items()
            if not boards.keys().isdisjoint(found)
        }
        seen = {shot for name in cameras for shot in views[name]} - {first}
        boards |= {shot: _board(shot, lenses, views, proposed, cameras) for shot in sorted(seen)}
        if _same(before[0], cameras) and _same(before[1], boards):
            break
    lost = sorted(set(views) - set(cameras))
    if lost:
        raise CalibrationError(f"{', '.join(lost)}: no board pose links it to pose 0, which is the rig frame.")
    return Placed(cameras, boards)


def board_poses(lens: Lens, view: BoardView) -> Array:
    """The camera_from_board (c, 4, 4) that a plane's perspective allows (Collins and Bartoli 2014), c = 0 to 2.

    Poses that show the board's back are left out: nobody reads a board from behind. The perspective is that of a
    pinhole turned toward the board, so that it may lie anywhere around a fish-eye.
    """
    rays = lens.rays(view.uv_px)
    imaged = np.isfinite(rays).all(axis=1)
    toward = geometry.look_at(np.zeros(3), rays[imaged].mean(axis=0), up=(0, -1, 0))
    local = geometry.rotate(geometry.invert(toward), rays[imaged])
    plane = local[:, :2] / local[:, 2:]
    points = np.ascontiguousarray(view.points_m[imaged])
    points, plane = (part[likely_corners(points, plane)] for part in (points, plane))
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(points, plane, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    except cv2.error:
        return np.empty((0, 4, 4))
    poses = [
        toward @ geometry.rigid_from_vectors(turn, np.ravel(shift)) for turn, shift in zip(turns, shifts, strict=True)
    ]
    facing = [pose for pose in poses if np.isfinite(pose).all() and pose[:3, 2] @ pose[:3, 3] < 0]
    return np.stack(facing) if facing else np.empty((0, 4, 4))


def likely_corners(points_m: Array, plane: Array) -> NDArray[np.bool_]:
    """Which corners (n,) follow the homography that most follow, from the board to a plane (least median of squares).

    Good enough to begin with: neither all wrong corners are found, nor are all others right.
    """
    _, mask = cv2.findHomography(points_m[:, :2], plane, cv2.LMEDS)
    kept = np.ones(len(plane), np.bool_) if mask is None else mask.ravel() > 0
    return kept if np.count_nonzero(kept) >= MIN_CORNERS else np.ones(len(plane), np.bool_)


def errors_px(lens: Lens, poses: Array, views: Sequence[BoardView]) -> Array:
    """Median distance (c, v) of found and predicted corners; infinite where a corner has no image.

    `poses` (c, v, 4, 4) are camera_from_board of c candidates in each of v views.
    """
    counts = [len(view.uv_px) for view in views]
    turns, shifts_m = poses[:, :, :3, :3].swapaxes(2, 3), poses[:, :, None, :3, 3]
    local = np.concatenate([view.points_m @ turns[:, i] + shifts_m[:, i] for i, view in enumerate(views)], axis=1)
    apart = np.linalg.norm(lens.project(local) - np.concatenate([view.uv_px for view in views]), axis=-1)
    apart[np.isnan(apart)] = np.inf
    by_view = np.split(apart, np.cumsum(counts[:-1]), axis=1)
    return np.stack([np.median(part, axis=1) for part in by_view], axis=1)


def _camera(
    lens: Lens, found: Mapping[Shot, BoardView], proposed: Mapping[Shot, Array], boards: Mapping[Shot, Array]
) -> Array:
    """The camera_from_first that most of the camera's views of known boards agree with."""
    known = [shot for shot in found if shot in boards]
    candidates = np.concatenate([proposed[shot] @ geometry.invert(boards[shot]) for shot in known])
    placed = np.stack([boards[shot] for shot in known])
    errors = errors_px(lens, candidates[:, None] @ placed, [found[shot] for shot in known])
    return np.asarray(candidates[np.argmin(np.median(errors, axis=1))], np.float64)


def _board(
    shot: Shot, lenses: Mapping[str, Lens], views: Views, proposed: Poses, cameras: Mapping[str, Array]
) -> Array:
    """The first_from_board that most of the cameras which see the board agree with."""
    known = [name for name in cameras if shot in views[name]]
    candidates = np.concatenate([geometry.invert(cameras[name]) @ proposed[name][shot] for name in known])
    errors = np.concatenate(
        [errors_px(lenses[n], (cameras[n] @ candidates)[:, None], [views[n][shot]]) for n in known], axis=1
    )
    return np.asarray(candidates[np.argmin(np.median(errors, axis=1))], np.float64)


def _same(before: Mapping[Key, Array], after: Mapping[Key, Array]) -> bool:
    return before.keys() == after.keys() and all(np.array_equal(before[key], after[key]) for key in after)
