"""What a scan says about its own description: do passes agree, does the object move as stated, what was seen twice."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from processing import geometry
from processing.laser.motion import Motion, Turn
from processing.laser.profile_scan import Scan, ScanSetup, ScanStatus
from processing.robust import bulk_deviation

Array = NDArray[np.float64]
_TOLD = 20_000  # points that tell the usual distance between neighbours
_PICTURES = 10
_CLEAR = 12.0  # sigmas of the stripe between it and where the object's own pattern is read
_LEAST_PAIRS = 300


def pass_disagreement(scan: Scan, motion: Motion) -> float:
    """Robust RMS distance in metres between what a turntable's first turn and later ones measured at the same angle.

    Interpolated between the first turn's frames, scan line by scan line. It grows with a wrong angle per frame, and
    with an object that slips; a wrong direction or axis does not show, since after a full turn the pictures are the
    same. NaN without a second pass.
    """
    if not isinstance(motion, Turn) or motion.step_rad == 0.0:
        return float("nan")
    turn_frames = 2.0 * np.pi / abs(motion.step_rad)
    later = np.arange(int(np.ceil(turn_frames - 1e-6)), len(scan.points_m))
    earlier = np.maximum(later - turn_frames, 0.0)
    seen = np.stack([geometry.transform_points(motion.camera_from_object(k), p) for k, p in enumerate(scan.points_m)])
    below = np.floor(earlier).astype(int)
    share = (earlier - below)[:, None, None]
    expected = np.where(share > 1e-6, (1.0 - share) * seen[below] + share * seen[below + 1], seen[below])
    distance = np.linalg.norm(seen[later] - expected, axis=-1)
    distance = distance[np.isfinite(distance)]
    return bulk_deviation(distance) if distance.size else float("nan")


@dataclass(frozen=True)
class MotionCheck:
    """How alike surface points look before and after they cross the laser: correlations of their pattern, -1 to 1.

    `stated` follows the points as the motion is stated, `reversed` the other way. Both are near 0 where the room is
    dark or the object has no pattern, NaN where no point can be followed: then nothing is known.
    """

    stated: float
    reversed: float

    @property
    def contradicted(self) -> bool:
        """Whether the object moves the other way beyond doubt."""
        return self.reversed > 0.3 and self.reversed > 2.0 * abs(self.stated)

    @property
    def confirmed(self) -> bool:
        """Whether the object moves as stated beyond doubt."""
        return self.stated > 0.3 and self.stated > 2.0 * abs(self.reversed)


def check_motion(frames: Sequence[NDArray[Any]], scan: Scan, setup: ScanSetup) -> MotionCheck:
    """Follow measured points a few frames backward and forward, off the stripe, and compare what is seen there.

    Brightness differences between neighbouring scan lines are compared, which shading hardly changes.
    """
    step = _frames_apart(scan, setup)
    numbers = np.arange(step, len(frames) - step)
    if len(numbers) == 0:
        return MotionCheck(np.nan, np.nan)
    numbers = np.unique(numbers[np.linspace(0, len(numbers) - 1, _PICTURES).astype(int)])
    pairs: dict[int, list[Array]] = {1: [], -1: []}
    for number in map(int, numbers):
        for way, found in pairs.items():
            one, other = (_pattern(frames[k], scan, setup, (number, way, k)) for k in (number - step, number + step))
            both = np.isfinite(one) & np.isfinite(other)
            found.append(np.stack([one[both], other[both]]))
    return MotionCheck(*(_correlation(np.concatenate(pairs[way], axis=1)) for way in (1, -1)))


def _frames_apart(scan: Scan, setup: ScanSetup) -> int:
    """Frames after which half of the points have left the stripe."""
    total = len(scan.points_m)
    number = int(np.argmax((scan.status == ScanStatus.MEASURED).sum(axis=1)))
    start = _places(scan, setup, number, 0)
    for step in range(1, total // 2 + 1):
        moved = np.linalg.norm(_places(scan, setup, number, step) - start, axis=-1)
        if np.isfinite(moved).any() and np.nanmedian(moved) > _CLEAR * scan.stripe.sigma_px:
            return step
    return total


def _places(scan: Scan, setup: ScanSetup, number: int, shift: int) -> Array:
    """Image points (n, 2), `shift` frames later, of the points measured in a frame."""
    in_camera = geometry.transform_points(setup.motion.camera_from_object(number + shift), scan.points_m[number])
    return geometry.project(in_camera, setup.matrix, setup.distortion, np.eye(4))


def _pattern(picture: NDArray[Any], scan: Scan, setup: ScanSetup, path: tuple[int, int, int]) -> Array:
    """What frame `seen` shows between neighbours (n - 1,) of the points of frame `number`, if they move `way` (1, -1).

    NaN outside of the picture and on the stripe of that frame. `path` is number, way, seen.
    """
    number, way, seen = path
    places = _places(scan, setup, number, way * (seen - number))
    along, across = (1, 0) if setup.upright else (0, 1)
    line = np.clip(np.nan_to_num(np.rint(places[:, along])), 0, scan.status.shape[1] - 1).astype(int)
    on_stripe = np.abs(places[:, across] - scan.uv_px[seen, line, across]) < 0.5 * _CLEAR * scan.stripe.sigma_px
    known = np.isfinite(places).all(axis=1) & ~on_stripe
    values = np.full(len(places), np.nan)
    grey = picture if picture.ndim == 2 else picture.mean(axis=2)
    values[known] = map_coordinates(np.asarray(grey, np.float64), places[known, ::-1].T, order=1, cval=np.nan)
    return np.asarray(np.diff(values))


def _correlation(pairs: Array) -> float:
    if pairs.shape[1] < _LEAST_PAIRS or not (pairs.std(axis=1) > 0).all():
        return float("nan")
    return float(np.asarray(np.corrcoef(pairs))[0, 1])


def merged_points(scan: Scan) -> tuple[Array, NDArray[np.uint8]]:
    """All points (n, 3) with their colours (n, 3), those that were measured more than once averaged.

    Points in one cell of half the usual distance between neighbours count as the same.
    """
    measured = scan.status == ScanStatus.MEASURED
    points, colours = scan.points_m[measured], scan.colour[measured]
    if len(points) < 2:
        return points, colours
    distance, _ = cKDTree(points).query(points[:: len(points) // _TOLD + 1], k=2)
    spacing = float(np.median(np.asarray(distance)[:, 1]))
    if spacing == 0.0:
        return points, colours
    _, cell = np.unique(np.floor(points / (0.5 * spacing)).astype(np.int64), axis=0, return_inverse=True)
    cell = cell.ravel()
    count = np.bincount(cell)
    values = np.concatenate([points, colours.astype(np.float64)], axis=1)
    mean = np.stack([np.bincount(cell, weights=column) for column in values.T], axis=1) / count[:, None]
    return mean[:, :3], np.rint(mean[:, 3:]).astype(np.uint8)
