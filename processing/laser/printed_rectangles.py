"""Two printed rectangles of known size in a picture: their planes, and the camera that their sides betray.

Sides are straight on paper, parallel in pairs, and of known lengths: their images determine focal length, centre and
first distortion term beside both poses. Where a camera's calibration is known it can be checked against that.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from processing import geometry
from processing.errors import ImageError
from processing.laser.plane_fit import Plane, plane_angle

Array = NDArray[np.float64]
Lens = tuple[Array, Array]  # camera matrix (3, 3), distortion (5,)
_ENLARGE = 4  # the contour of a frame is found in an enlarged picture
_FROM_CORNER = 0.08  # of a side's length, rounded by blur
_SIDE_PX = 6.0  # by which distortion may bend a side
_STARTS = (0.7, 1.2, 2.5)  # focal lengths that the search starts from, in widths of the picture
_ROUNDS = 60  # it settles in twenty, unless the rectangles do not tell the camera
_CERTAIN = 18.5  # chi-square of four unknowns that chance exceeds once in a thousand
_FREE = 4  # log focal length, centre / 100 px, k1


@dataclass(frozen=True)
class RectangleFit:
    """Both rectangles as one camera sees them, lengths in metres, camera frame.

    `poses` are camera_from_rectangle (4, 4) of each, x along its width from the upper left corner. `rms_px` is the
    distance of the sides' image points from the fit; these err together along a side: `independent` is how many of them
    there are in effect. `deviation` (4,) is one sigma of focal length, centre column and row in pixels, and k1: NaN
    where the camera was given. `corner_rad` is the angle between both planes.
    """

    lens: Lens
    poses: tuple[Array, Array]
    rms_px: float
    independent: int
    deviation: Array
    corner_rad: float
    corner_deviation_rad: float

    @property
    def planes(self) -> tuple[Plane, Plane]:
        """The upper and the lower rectangle's plane."""
        return Plane.of_board(self.poses[0]), Plane.of_board(self.poses[1])

    def contradicts(self, given: "RectangleFit") -> bool:
        """Whether a camera that was given fits the sides worse than this free one beyond doubt (1 in 1000)."""
        excess = (given.rms_px / max(self.rms_px, 1e-9)) ** 2 - 1.0
        return bool(self.independent * excess > _CERTAIN)


def find_rectangles(picture: NDArray[np.uint8]) -> list[Array]:
    """Inner contours (n, 2) uv_px of dark frames around white in a picture (h, w, 3), the largest two, upper one first.

    Fewer where there are not two.
    """
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    large = cv2.resize(grey, None, fx=_ENLARGE, fy=_ENLARGE, interpolation=cv2.INTER_CUBIC)
    dark = (large < 0.5 * float(np.median(grey))).astype(np.uint8)
    contours, tree = cv2.findContours(dark, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    found = []
    for index, contour in enumerate(contours):
        hole = tree[0, index, 3] >= 0
        if hole and cv2.contourArea(contour) > 0.01 * large.size and len(_corners(contour)) == 4:
            found.append((contour[:, 0].astype(np.float64) + 0.5) / _ENLARGE - 0.5)
    return sorted(sorted(found, key=len)[-2:], key=lambda contour: float(contour[:, 1].mean()))


def fit_rectangles(
    contours: Sequence[Array], size_m: tuple[float, float], shape: tuple[int, ...], lens: Lens | None = None
) -> RectangleFit:
    """Poses of two rectangles of this width and height, and the camera where none is given.

    Least squares on the distances of the sides' points, with square pixels and one term of distortion. Raises
    ImageError where no camera explains the rectangles.
    """
    sides = [_sides(contour) for contour in contours]
    points, owner = _stacked(sides)
    starts = [lens] if lens is not None else [_guess(shape, factor) for factor in _STARTS]
    best = None
    for start in starts:
        corners = [_cornered(four) for four in sides]
        first = _start(corners, size_m, start)
        if lens is None:
            first = np.append(first, np.zeros(_FREE))
        residual = _residual(points, owner, size_m, start)
        found = least_squares(residual, first, x_scale="jac", max_nfev=_ROUNDS)
        if best is None or found.cost < best[0].cost:
            best = found, start
    assert best is not None  # there is a start
    found, start = best
    if not np.isfinite(found.cost) or np.sqrt(np.mean(found.fun**2)) > 0.02 * shape[1]:
        raise ImageError("the printed frames are no two rectangles of the stated size.")
    return _result(found, owner, start)


def _corners(contour: NDArray[np.generic]) -> Array:
    outline = np.asarray(contour, np.float32).reshape(-1, 1, 2)
    return np.asarray(cv2.approxPolyDP(outline, 0.03 * cv2.arcLength(outline, True), True)[:, 0], np.float64)


def _sides(contour: Array) -> list[Array]:
    """The contour's points along each side, clockwise as the picture turns, from the upper left corner."""
    corners = _corners(contour)
    if len(corners) != 4:
        raise ImageError(f"an outline with {len(corners)} corners is no printed rectangle.")
    around = corners - corners.mean(axis=0)
    corners = corners[np.argsort(np.arctan2(around[:, 1], around[:, 0]))]
    along = np.roll(corners, -1, axis=0) - corners
    length = np.linalg.norm(along, axis=1, keepdims=True)
    from_corner = contour - corners[:, None]  # side, point
    place = np.einsum("spi,si->sp", from_corner, along / length**2)
    across = np.abs(np.einsum("spi,si->sp", from_corner, along[:, ::-1] * [-1, 1] / length))
    part = (place > _FROM_CORNER) & (place < 1 - _FROM_CORNER) & (across < _SIDE_PX)
    part &= np.argmin(across, axis=0) == np.arange(4)[:, None]  # near a corner both sides are near
    return [contour[p][np.argsort(t[p])][::_ENLARGE] for p, t in zip(part, place, strict=True)]


def _stacked(sides: list[list[Array]]) -> tuple[Array, NDArray[np.intp]]:
    flat = [side for four in sides for side in four]
    if min(map(len, flat)) < 3:
        raise ImageError("a side of a printed rectangle is hidden or too short.")
    return np.concatenate(flat), np.repeat(np.arange(len(flat)), [len(side) for side in flat])


def _guess(shape: tuple[int, ...], factor: float) -> Lens:
    height, width = shape[:2]
    focal = factor * width
    return np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]]), np.zeros(5)


def _cornered(sides: list[Array]) -> Array:
    """Corners (4, 2) from the straight lines through the ends of the sides."""
    return np.stack([0.5 * (sides[i - 1][-1] + sides[i][0]) for i in range(4)])


def _model(size_m: tuple[float, float]) -> Array:
    width, height = size_m
    return np.array([(0.0, 0.0, 0.0), (width, 0.0, 0.0), (width, height, 0.0), (0.0, height, 0.0)])


def _start(corners: list[Array], size_m: tuple[float, float], lens: Lens) -> Array:
    vectors = []
    for four in corners:
        _, rotation, translation = cv2.solvePnP(_model(size_m), four, *lens, flags=cv2.SOLVEPNP_IPPE)
        vectors += [rotation.ravel(), translation.ravel()]
    return np.concatenate(vectors)


def _lens_at(values: Array, start: Lens) -> Lens:
    """The lens of the values past the poses; the start's own where there are none."""
    matrix, distortion = start[0].copy(), start[1].copy()
    if len(values) > 12:
        matrix[[0, 1], [0, 1]] *= np.exp(values[12])
        matrix[:2, 2] += 100.0 * values[13:15]
        distortion[0] += values[15]
    return matrix, distortion


def _poses_at(values: Array) -> tuple[Array, Array]:
    return (
        geometry.rigid_from_vectors(values[0:3], values[3:6]),
        geometry.rigid_from_vectors(values[6:9], values[9:12]),
    )


def _residual(
    points: Array, owner: NDArray[np.intp], size_m: tuple[float, float], start: Lens
) -> Callable[[Array], Array]:
    """Signed distances (n,) of the sides' points from the rectangles' sides.

    In the picture as it is: in an undistorted one, a lens that shrinks it would seem to fit better.
    """
    model = _model(size_m)

    def distances(values: Array) -> Array:
        matrix, distortion = _lens_at(values, start)
        corners = []
        for pose in _poses_at(values):
            in_camera = geometry.transform_points(pose, model)
            corners.append(in_camera[:, :2] / in_camera[:, 2:] * matrix[[0, 1], [0, 1]] + matrix[:2, 2])
        begin = np.concatenate(corners)
        along = np.concatenate([np.roll(four, -1, axis=0) for four in corners]) - begin
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
        straight = cv2.undistortPoints(points[:, None], matrix, distortion, P=matrix)[:, 0]
        across = np.einsum("ij,ij->i", straight - begin[owner], normal[owner])
        foot = (straight - across[:, None] * normal[owner] - matrix[:2, 2]) / matrix[[0, 1], [0, 1]]
        ahead = np.concatenate([foot, np.ones((len(foot), 1))], axis=1)
        seen = geometry.project(ahead, matrix, distortion, np.eye(4))
        return np.asarray(np.einsum("ij,ij->i", points - seen, normal[owner]))

    return distances


def _result(found: object, owner: NDArray[np.intp], start: Lens) -> RectangleFit:
    values, errors, jacobian = (np.asarray(getattr(found, name), np.float64) for name in ("x", "fun", "jac"))
    rms = float(np.sqrt(np.mean(errors**2)))
    independent = _independent([errors[owner == side] for side in range(owner[-1] + 1)])
    variance = rms**2 * len(errors) / max(independent - len(values), 1)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * variance
    lens = _lens_at(values, start)
    deviation = np.full(_FREE, np.nan)
    if len(values) > 12:
        deviation = np.sqrt(np.diag(covariance)[12:]) * np.array([lens[0][0, 0], 100.0, 100.0, 1.0])
    steps = 1e-6 * np.eye(len(values))
    slope = np.array([(_corner(values + step) - _corner(values - step)) / 2e-6 for step in steps])
    spread = float(np.sqrt(slope @ covariance @ slope))
    return RectangleFit(lens, _poses_at(values), rms, independent, deviation, _corner(values), spread)


def _independent(sides: list[Array]) -> int:
    """How many independent errors tell as much as these: their number over the sum of their correlations along sides.

    Correlations are summed up to the first that is not positive (Geyer 1992's initial sequence).
    """
    power = sum(float(side @ side) for side in sides)
    count = sum(map(len, sides))
    correlated = 1.0
    for lag in range(1, min(map(len, sides))):
        pairs = sum(len(side) - lag for side in sides)
        shared = sum(float(side[lag:] @ side[:-lag]) for side in sides) / pairs * count / max(power, 1e-300)
        if shared <= 0.0:
            break
        correlated += 2.0 * shared
    return max(int(count / correlated), 1)


def _corner(values: Array) -> float:
    upper, lower = _poses_at(values)
    return plane_angle(Plane.of_board(upper), Plane.of_board(lower))
