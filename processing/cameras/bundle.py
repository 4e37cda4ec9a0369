"""Bundle adjustment: cameras and board poses refined together (Triggs et al. 2000).

Cameras that stand around one board measure its pose better together than each alone, and a pose that several cameras
share ties their focal lengths and distances. Pose 0 is held: it is the rig frame.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.cameras.board import BoardView
from processing.errors import CalibrationError
from processing.robust import bulk_deviation

Array = NDArray[np.float64]
CAMERA_PARAMETERS = 15  # fx fy cx cy, k1 k2 p1 p2 k3, turn (3), shift (3)
CORNER_NOISE_PX = 0.1  # weight of the corners against the priors
# What is believed before a view is seen, one sigma. Long lenses do not determine their distortion or centre; without
# these the unseen terms would grow to fit noise. Wide ones outweigh them a thousand times.
CENTRE_SIGMA = 0.03  # principal point off the image's centre, of its width
ASPECT_SIGMA = 0.001  # fx against fy: pixels are square
DISTORTION_SIGMA = np.array([0.3, 0.3, 0.005, 0.005, 0.3])
_ITERATIONS = 60
_HUBER = 3.0  # corners beyond this many robust deviations count less


@dataclass(frozen=True)
class Camera:
    """A camera under adjustment; `rms_px` and `deviation` as in `calibration.CameraModel`."""

    matrix: Array
    distortion: Array
    camera_from_rig: Array
    rms_px: float = float("nan")
    deviation: Array = field(default_factory=lambda: np.full(CAMERA_PARAMETERS, np.nan))


@dataclass(frozen=True)
class Network:
    """Cameras by name, `rig_from_board` by pose."""

    cameras: Mapping[str, Camera]
    boards: Mapping[int, Array]

    @property
    def free_boards(self) -> list[int]:
        """The poses that are adjusted."""
        return sorted(pose for pose in self.boards if pose != 0)

    @property
    def parameters(self) -> int:
        """Number of adjusted numbers."""
        return CAMERA_PARAMETERS * len(self.cameras) + 6 * len(self.free_boards)

    def moved(self, step: Array) -> "Network":
        """The network after a step of all parameters; turns act from the left."""
        cameras = {
            name: _moved_camera(camera, step[i * CAMERA_PARAMETERS : (i + 1) * CAMERA_PARAMETERS])
            for i, (name, camera) in enumerate(self.cameras.items())
        }
        poses = step[CAMERA_PARAMETERS * len(self.cameras) :].reshape(-1, 6)
        boards = {pose: _moved(self.boards[pose], s) for pose, s in zip(self.free_boards, poses, strict=True)}
        return Network(cameras, {**self.boards, **boards})


def adjust(start: Network, views: Mapping[str, Mapping[int, BoardView]]) -> dict[str, Camera]:
    """Cameras that minimise the squared distance of all corners, outliers counting linearly (Huber).

    Principal point, aspect and distortion start from `start` and are held there by weak priors. The deviations are
    those of the inverse normal matrix, scaled by the residual.
    Raises CalibrationError where the views leave some parameter free.
    """
    plain = _Problem(start, views, np.inf)
    network = plain.minimise(start)
    spread_px = bulk_deviation(np.concatenate(list(plain.errors(network).values())))
    robust = _Problem(start, views, _HUBER * max(spread_px, 1e-3))
    network = robust.minimise(network)
    deviations = robust.deviations(network)
    errors = robust.errors(network)
    return {
        name: replace(camera, rms_px=float(np.sqrt(2 * np.mean(errors[name] ** 2))), deviation=deviations[i])
        for i, (name, camera) in enumerate(network.cameras.items())
    }


@dataclass(frozen=True)
class _Problem:
    start: Network
    views: Mapping[str, Mapping[int, BoardView]]
    threshold_px: float

    def minimise(self, network: Network) -> Network:
        """Levenberg-Marquardt, damped in units of the normal matrix's own diagonal (Marquardt 1963)."""
        normal, gradient, cost = self.system(network)
        damping = 1e-3
        for _ in range(_ITERATIONS):
            step = -_solve(normal + damping * np.diag(np.diag(normal)), gradient)
            trial = network.moved(step)
            trial_normal, trial_gradient, trial_cost = self.system(trial)
            if not trial_cost < cost:
                damping *= 10
                if damping > 1e8:
                    break
                continue
            converged = cost - trial_cost < 1e-9 * cost
            network, normal, gradient, cost = trial, trial_normal, trial_gradient, trial_cost
            damping = max(damping / 10, 1e-12)
            if converged:
                break
        return network

    def system(self, network: Network) -> tuple[Array, Array, float]:
        """Normal matrix, gradient and cost at a network."""
        normal, gradient, cost = self._priors(network)
        places = {pose: CAMERA_PARAMETERS * len(network.cameras) + 6 * i for i, pose in enumerate(network.free_boards)}
        for i, (name, camera) in enumerate(network.cameras.items()):
            for pose, view in self.views[name].items():
                error, by_camera, by_board = _linearised(camera, network.boards[pose], view)
                weight = np.minimum(1.0, self.threshold_px / np.maximum(np.abs(error), 1e-12))
                where = np.arange(CAMERA_PARAMETERS) + i * CAMERA_PARAMETERS
                jacobian = by_camera
                if pose in places:
                    where = np.concatenate([where, places[pose] + np.arange(6)])
                    jacobian = np.concatenate([by_camera, by_board], axis=1)
                normal[np.ix_(where, where)] += jacobian.T @ (weight[:, None] * jacobian)
                gradient[where] += jacobian.T @ (weight * error)
                cost += _huber(error, self.threshold_px)
        return normal, gradient, cost if np.isfinite(cost) else np.inf

    def _priors(self, network: Network) -> tuple[Array, Array, float]:
        normal = np.zeros((network.parameters, network.parameters))
        gradient, cost = np.zeros(network.parameters), 0.0
        for i, (name, camera) in enumerate(network.cameras.items()):
            error, jacobian = _prior(camera, self.start.cameras[name])
            where = slice(i * CAMERA_PARAMETERS, i * CAMERA_PARAMETERS + 9)
            normal[where, where] = jacobian.T @ jacobian
            gradient[where] = jacobian.T @ error
            cost += _huber(error, np.inf)
        return normal, gradient, cost

    def errors(self, network: Network) -> dict[str, Array]:
        """Predicted minus found corners of every camera, (2 n,) in pixels."""
        return {
            name: np.concatenate(
                [_linearised(camera, network.boards[pose], v)[0] for pose, v in self.views[name].items()]
            )
            for name, camera in network.cameras.items()
        }

    def deviations(self, network: Network) -> Array:
        """One-sigma uncertainties (cameras, 15)."""
        normal, _, cost = self.system(network)
        seen = sum(2 * len(v.uv_px) for found in self.views.values() for v in found.values())
        variance = 2 * cost / max(seen + 8 * len(network.cameras) - network.parameters, 1)
        # Scaled to a unit diagonal first: pixels and radians differ by many decades.
        scale = 1 / np.sqrt(np.diag(normal))
        covariance = _solve(normal * np.outer(scale, scale), np.eye(network.parameters)) * np.outer(scale, scale)
        diagonal = np.diag(covariance)[: CAMERA_PARAMETERS * len(network.cameras)]
        return np.sqrt(variance * np.maximum(diagonal, 0)).reshape(-1, CAMERA_PARAMETERS)


def _linearised(camera: Camera, rig_from_board: Array, view: BoardView) -> tuple[Array, Array, Array]:
    """Error (2 n,) and its derivatives by the camera's (2 n, 15) and the board's (2 n, 6) parameters."""
    in_rig = geometry.transform_points(rig_from_board, view.points_m)
    local = geometry.transform_points(camera.camera_from_rig, in_rig)
    zero = np.zeros(3)
    uv_px, by_opencv = cv2.projectPoints(local, zero, zero, camera.matrix, camera.distortion)
    by_opencv = np.asarray(by_opencv, np.float64)
    by_local = np.asarray(by_opencv[:, 3:6], np.float64).reshape(-1, 2, 3)
    turned = camera.camera_from_rig[:3, :3]
    by_camera = np.concatenate([by_opencv[:, 6:15], _by_pose(by_local, local - camera.camera_from_rig[:3, 3])], axis=1)
    by_board = _by_pose(np.asarray(by_local @ turned), in_rig - rig_from_board[:3, 3])
    return (np.asarray(uv_px)[:, 0] - view.uv_px).ravel(), by_camera, by_board


def _by_pose(by_point: Array, turned: Array) -> Array:
    """Derivative (2 n, 6) by a left turn and a shift of points `turned` (n, 3) about the frame's origin."""
    # d(exp(w) p) / dw = -[p]x, so each row g of the derivative by the point gives p x g.
    by_turn = np.cross(turned[:, None, :], by_point)
    return np.concatenate([by_turn, by_point], axis=2).reshape(-1, 6)


def _prior(camera: Camera, start: Camera) -> tuple[Array, Array]:
    """Weighted departure (8,) from what is believed, and its derivative (8, 9) by the intrinsics."""
    focal, centre = camera.matrix[0, 0], camera.matrix[:2, 2]
    sigma = np.concatenate([
        np.full(2, CENTRE_SIGMA * 2 * start.matrix[0, 2]), [ASPECT_SIGMA * start.matrix[0, 0]], DISTORTION_SIGMA
    ])  # fmt: skip
    departure: Array = np.concatenate([centre - start.matrix[:2, 2], [focal - camera.matrix[1, 1]], camera.distortion])
    jacobian = np.zeros((8, 9))
    jacobian[[0, 1], [2, 3]] = 1
    jacobian[2, :2] = 1, -1
    jacobian[3:, 4:] = np.eye(5)
    weight = CORNER_NOISE_PX / sigma
    return np.asarray(weight * departure, np.float64), np.asarray(weight[:, None] * jacobian, np.float64)


def _huber(error: Array, threshold: float) -> float:
    size = np.abs(error)
    return float(np.sum(np.where(size <= threshold, 0.5 * size**2, threshold * (size - 0.5 * threshold))))


def _solve(matrix: Array, right: Array) -> Array:
    try:
        return np.asarray(np.linalg.solve(matrix, right), np.float64)
    except np.linalg.LinAlgError as error:
        raise CalibrationError("the views leave a parameter free; tilt the board in more directions.") from error


def _moved_camera(camera: Camera, step: Array) -> Camera:
    matrix = camera.matrix.copy()
    matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += step[:4]
    return replace(
        camera,
        matrix=matrix,
        distortion=camera.distortion + step[4:9],
        camera_from_rig=_moved(camera.camera_from_rig, step[9:]),
    )


def _moved(transform: Array, step: Array) -> Array:
    turn = geometry.rigid_from_vectors(step[:3], np.zeros(3))[:3, :3]
    return geometry.rigid(turn @ transform[:3, :3], transform[:3, 3] + step[3:])
