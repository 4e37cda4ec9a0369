"""Bundle adjustment: lenses, cameras, board poses and the turntable's axis refined together (Triggs et al. 2000).

Cameras that stand around one board measure its pose better together than each alone, and a pose that several cameras
share ties their focal lengths and distances. A board that the turntable turns shows them its axis.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from processing import geometry
from processing.cameras.board import BoardView
from processing.cameras.network import Camera, Network, Shot, Views
from processing.errors import CalibrationError
from processing.robust import bulk_deviation

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
# What is believed before a view is seen, one sigma, besides the lens's own. Long lenses do not determine their
# distortion or centre; without these the unseen terms would grow to fit noise. Wide ones outweigh them a thousandfold.
CENTRE_SIGMA = 0.03  # principal point off the image's centre, of its width
ASPECT_SIGMA = 0.001  # fx against fy: pixels are square
_ITERATIONS = 60
_ROUNDS = 8
_SETTLED = 1e-3  # relative change of the noise from round to round
_HUBER = 3.0  # corners beyond this many robust deviations count less,
_REJECTED = 6.0  # and beyond this many not at all: a wrong corner, not noise
_LEAST_NOISE_PX = 1e-6


@dataclass(frozen=True)
class Adjusted:
    """A network at its optimum.

    `errors_px` (n, 2) are predicted less found corners of each camera, `accepted` (n,) which of them took part, in the
    order of the camera's shots. `covariance` (p, p) belongs to the parameters in the network's order, in its gauge.
    """

    network: Network
    errors_px: Mapping[str, Array]
    accepted: Mapping[str, Mask]
    covariance: Array


def adjust(start: Network, views: Views) -> Adjusted:
    """The network that minimises the squared distance of all corners over their noise; from 3 sigmas on linearly.

    Principal point, aspect and distortion start from `start` and are held there by weak priors. Each camera's noise
    and the wrong corners are judged by the residuals themselves, in rounds: pictures taken at a slant have corners
    that are less sure. The covariance is that of the inverse normal matrix, scaled by the residuals (Huber 1981, eq.
    7.6.5).
    Raises CalibrationError where the views leave some parameter free.
    """
    sights = {name: _Sight.of(found) for name, found in views.items()}
    network = start
    errors = {name: _errors(network, name, sight) for name, sight in sights.items()}
    noise_px = _noise(errors, start)
    accepted: dict[str, Mask] = {name: np.ones(len(sight.uv_px), np.bool_) for name, sight in sights.items()}
    for _ in range(_ROUNDS):
        problem = _Problem(start, sights, accepted, noise_px)
        network = problem.minimise(network)
        errors = {name: _errors(network, name, sight) for name, sight in sights.items()}
        before_px, noise_px = noise_px, _noise(errors, start)
        accepted = {n: np.asarray((np.abs(e) <= _REJECTED * noise_px[n]).all(axis=1)) for n, e in errors.items()}
        if all(abs(noise_px[n] - before_px[n]) <= _SETTLED * noise_px[n] for n in noise_px):
            break
    return Adjusted(network, errors, accepted, problem.covariance(network))


def _noise(errors_px: Mapping[str, Array], network: Network) -> dict[str, float]:
    """One sigma of every camera's corners in either direction, from the bulk of its residuals.

    A camera's own parameters follow its corners, which makes the residuals smaller than the noise. Below half of the
    noise of all, few corners agree by chance.
    """
    least_px = max(0.5 * bulk_deviation(np.concatenate(list(errors_px.values()))), _LEAST_NOISE_PX)
    noise_px = {}
    for name, error in errors_px.items():
        freedom = max(error.size - network.cameras[name].parameters, 0.25 * error.size)
        noise_px[name] = max(bulk_deviation(error) * float(np.sqrt(error.size / freedom)), least_px)
    return noise_px


@dataclass(frozen=True)
class _Sight:
    """All corners that one camera found, shot after shot: `of_shot` (n,) says which one."""

    shots: Sequence[Shot]
    of_shot: NDArray[np.intp]
    points_m: Array
    uv_px: Array

    @classmethod
    def of(cls, found: Mapping[Shot, BoardView]) -> "_Sight":
        of_shot = np.repeat(np.arange(len(found)), [len(view.uv_px) for view in found.values()])
        points_m = np.concatenate([view.points_m for view in found.values()])
        return cls(tuple(found), of_shot, points_m, np.concatenate([view.uv_px for view in found.values()]))

    def in_rig(self, network: Network) -> Array:
        """The corners (n, 3) in the rig frame."""
        boards = np.stack([network.rig_from_board(shot) for shot in self.shots])[self.of_shot]
        return np.asarray(np.einsum("nij,nj->ni", boards[:, :3, :3], self.points_m) + boards[:, :3, 3])


def _errors(network: Network, name: str, sight: _Sight) -> Array:
    """Predicted less found corners (n, 2)."""
    camera = network.cameras[name]
    local = geometry.transform_points(camera.camera_from_rig, sight.in_rig(network))
    return np.asarray(camera.lens.linearised(local)[0] - sight.uv_px, np.float64)


@dataclass(frozen=True)
class _Problem:
    start: Network
    sights: Mapping[str, _Sight]
    accepted: Mapping[str, Mask]
    noise_px: Mapping[str, float]

    def minimise(self, network: Network) -> Network:
        """Levenberg-Marquardt, damped in units of the normal matrix's own diagonal (Marquardt 1963)."""
        normal, gradient, cost = self.system(network)
        damping = 1e-3
        for _ in range(_ITERATIONS):
            step = -_solve(normal + damping * np.diag(np.diag(normal)), gradient, network)
            trial = network.moved(step)
            trial_normal, trial_gradient, trial_cost = self.system(trial)
            if not trial_cost < cost:
                damping *= 10
                if damping > 1e8:
                    break
                continue
            converged = cost - trial_cost < 1e-10 * cost
            network, normal, gradient, cost = trial, trial_normal, trial_gradient, trial_cost
            damping = max(damping / 10, 1e-12)
            if converged:
                break
        return network

    def system(self, network: Network) -> tuple[Array, Array, float]:
        """Normal matrix, gradient and cost at a network; the cost is infinite where a corner has no image."""
        normal, gradient, cost = np.zeros((network.parameters,) * 2), np.zeros(network.parameters), 0.0
        for name, own in network.camera_slices().items():
            rows, corners_cost = self._weighted(network, name)
            normal[own, own] += rows.by_camera.T @ rows.by_camera
            gradient[own] += rows.by_camera.T @ rows.error
            cost += corners_cost
            _add_boards(normal, gradient, network, own, rows)
            prior, by_lens = _prior(network.cameras[name], self.start.cameras[name])
            lens = slice(own.start, own.start + by_lens.shape[1])
            normal[lens, lens] += by_lens.T @ by_lens
            gradient[lens] += by_lens.T @ prior
            cost += 0.5 * float(prior @ prior)
        return normal, gradient, cost if np.isfinite(cost) else np.inf

    def _weighted(self, network: Network, name: str) -> tuple["_Rows", float]:
        """A camera's corners over their noise, those beyond the Huber bound weighed down, and their cost."""
        rows = _linearised(network, name, self.sights[name])
        size = np.abs(rows.error) / self.noise_px[name]
        weight = np.minimum(1.0, _HUBER / np.maximum(size, 1e-12)) * np.repeat(self.accepted[name], 2)
        cost = float((weight * size * (size - 0.5 * np.minimum(size, _HUBER))).sum())
        return rows.times(np.sqrt(weight) / self.noise_px[name]), cost

    def covariance(self, network: Network) -> Array:
        """Of all parameters: inverse normal matrix times the variance of the corners, as M-estimates have it.

        What the corners tell is first divided by their design effect; what is believed is not.
        """
        normal, _, _ = self.system(network)
        believed = self._believed(network)
        effect = self._design_effect(network, _inverse(normal, network))
        return np.asarray(self._variance(network) * _inverse((normal - believed) / effect + believed, network))

    def _believed(self, network: Network) -> Array:
        """The priors' part of the normal matrix."""
        normal = np.zeros((network.parameters,) * 2)
        for name, own in network.camera_slices().items():
            _, by_lens = _prior(network.cameras[name], self.start.cameras[name])
            lens = slice(own.start, own.start + by_lens.shape[1])
            normal[lens, lens] = by_lens.T @ by_lens
        return normal

    def _design_effect(self, network: Network, inverse: Array) -> float:
        """By how much the variance of the parameters exceeds that which independent corners would give (Kish 1965).

        Blur, shading and mosaic displace neighbouring corners of a picture alike. Residuals r of a picture with the hat
        matrix H = J A^-1 J' have E r'H r = s^2 tr(H - H H) and E r'r = s^2 tr(1 - H) where errors are independent; the
        first grows, against the second, with errors alike that pull at the parameters. Below 1 it is chance.
        """
        boards, pulled, pull, square, freedom = network.board_slices(), 0.0, 0.0, 0.0, 0.0
        for name, own in network.camera_slices().items():
            rows, _ = self._weighted(network, name)
            for number, shot in enumerate(self.sights[name].shots):
                chosen = np.repeat(self.sights[name].of_shot == number, 2)
                columns = np.r_[own, boards[shot.pose]]
                by_board = rows.by_board[chosen][:, list(network.free(shot.pose))]
                jacobian, error = np.hstack([rows.by_camera[chosen], by_board]), rows.error[chosen]
                hat = jacobian @ inverse[np.ix_(columns, columns)] @ jacobian.T
                pulled += float(error @ hat @ error)
                pull += float(np.trace(hat) - np.sum(hat**2))
                square += float(error @ error)
                freedom += len(error) - float(np.trace(hat))
        return max(pulled * freedom / (pull * square), 1.0) if pull * square > 0 else 1.0

    def _variance(self, network: Network) -> float:
        """Of the corners, in units of their noise (Huber 1981, eq. 7.6.5)."""
        error = np.concatenate([
            _errors(network, name, sight)[self.accepted[name]].ravel() / self.noise_px[name]
            for name, sight in self.sights.items()
        ])  # fmt: skip
        held = np.clip(error, -_HUBER, _HUBER)
        inside = float((np.abs(error) <= _HUBER).mean())
        # The priors count as observations: three and the distortion of each lens.
        beliefs = sum(camera.lens.parameters - 1 for camera in network.cameras.values())
        freedom = max(len(error) + beliefs - network.parameters, 1)
        departures = np.concatenate([
            _prior(camera, self.start.cameras[name])[0] for name, camera in network.cameras.items()
        ])  # fmt: skip
        return float(held @ held + departures @ departures) / freedom / inside


@dataclass(frozen=True)
class _Rows:
    """Errors (2 n,) of one camera, derivatives by the camera (2 n, c) and by a board (2 n, 6), and its pose (2 n,)."""

    error: Array
    by_camera: Array
    by_board: Array
    pose: NDArray[np.int64]

    def times(self, weight: Array) -> "_Rows":
        return _Rows(self.error * weight, self.by_camera * weight[:, None], self.by_board * weight[:, None], self.pose)


def _linearised(network: Network, name: str, sight: _Sight) -> _Rows:
    camera = network.cameras[name]
    turns = np.stack([geometry.rotation_z(shot.turntable_rad)[:3, :3] for shot in sight.shots])[sight.of_shot]
    boards = np.stack([network.boards[shot.pose][:3, :3] for shot in sight.shots])[sight.of_shot]
    local = geometry.transform_points(camera.camera_from_rig, sight.in_rig(network))
    uv_px, by_lens, by_local = camera.lens.linearised(local)
    by_camera = np.concatenate([by_lens, _by_pose(by_local, local - camera.camera_from_rig[:3, 3])], axis=2)
    on_table = (by_local @ camera.camera_from_rig[:3, :3]) @ turns  # the board's parameters act before the table turns
    by_board = _by_pose(on_table, np.einsum("nij,nj->ni", boards, sight.points_m))
    pose = np.array([shot.pose for shot in sight.shots])[sight.of_shot]
    error = np.asarray(uv_px - sight.uv_px, np.float64).ravel()
    return _Rows(error, by_camera.reshape(len(error), -1), by_board.reshape(len(error), -1), np.repeat(pose, 2))


def _by_pose(by_point: Array, turned: Array) -> Array:
    """Derivative (n, 2, 6) by a left turn and a shift of points `turned` (n, 3) about the frame's origin."""
    # d(exp(w) p) / dw = -[p]x, so each row g of the derivative by the point gives p x g.
    return np.concatenate([np.cross(turned[:, None, :], by_point), by_point], axis=2)


def _add_boards(normal: Array, gradient: Array, network: Network, own: slice, rows: _Rows) -> None:
    """Add the boards' blocks of one camera's corners to normal matrix and gradient."""
    places = network.board_slices()
    for pose in np.unique(rows.pose):
        chosen, place = rows.pose == pose, places[pose]
        board = rows.by_board[chosen][:, list(network.free(pose))]
        across = board.T @ rows.by_camera[chosen]
        normal[place, place] += board.T @ board
        normal[place, own] += across
        normal[own, place] += across.T
        gradient[place] += board.T @ rows.error[chosen]


def _prior(camera: Camera, start: Camera) -> tuple[Array, Array]:
    """Departure (3 + k,) from what is believed in its sigmas, and its derivative (3 + k, 4 + k) by the lens."""
    lens, first = camera.lens, start.lens
    focal, believed = lens.matrix[[0, 1], [0, 1]], first.matrix[:2, 2]
    centre_px = CENTRE_SIGMA * 2 * believed[0]
    sigma = np.concatenate([
        np.full(2, centre_px), [ASPECT_SIGMA * first.matrix[0, 0]], lens.distortion_sigma
    ])  # fmt: skip
    departure = np.concatenate([lens.matrix[:2, 2] - believed, [focal[0] - focal[1]], lens.distortion])
    jacobian = np.zeros((len(departure), lens.parameters))
    jacobian[[0, 1], [2, 3]] = 1
    jacobian[2, :2] = 1, -1
    jacobian[3:, 4:] = np.eye(len(lens.distortion))
    return np.asarray(departure / sigma, np.float64), np.asarray(jacobian / sigma[:, None], np.float64)


def _inverse(normal: Array, network: Network) -> Array:
    """Of a normal matrix, scaled to a unit diagonal first: pixels and radians differ by many decades."""
    scale = 1 / np.sqrt(np.diag(normal))
    scaled = np.outer(scale, scale)
    return np.asarray(_solve(normal * scaled, np.eye(len(normal)), network) * scaled, np.float64)


def _solve(matrix: Array, right: Array, network: Network) -> Array:
    """Solution of the normal equations, whose cameras meet boards only and boards cameras only.

    The group with more parameters is eliminated block by block (Schur's complement), which leaves a small system.
    """
    cameras, boards = list(network.camera_slices().values()), list(network.board_slices().values())
    border, end = boards[0].start, len(matrix)
    blocks, kept = (cameras, slice(border, end)) if 2 * border >= end else (boards, slice(0, border))
    try:
        lifts = [np.linalg.solve(matrix[block, block], matrix[block, kept]) for block in blocks]
        own = [np.linalg.solve(matrix[block, block], right[block]) for block in blocks]
        reduced, rest = matrix[kept, kept].copy(), right[kept].copy()
        for block, lift in zip(blocks, lifts, strict=True):
            reduced -= matrix[kept, block] @ lift
            rest -= lift.T @ right[block]
        solved = np.empty_like(right)
        solved[kept] = cho_solve(cho_factor(reduced, check_finite=False), rest, check_finite=False)
    except np.linalg.LinAlgError as error:
        raise CalibrationError("the views leave a parameter free; tilt the board in more directions.") from error
    for block, lift, part in zip(blocks, lifts, own, strict=True):
        solved[block] = part - lift @ solved[kept]
    return solved
