"""A camera arc over a turntable, as numbers: true cameras and boards, seen corners, and the Cramer-Rao bound."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from processing import geometry
from processing.cameras.board import Board, BoardView
from processing.cameras.bundle import ASPECT_SIGMA, CENTRE_SIGMA
from processing.cameras.calibration import CameraModel
from processing.cameras.lens import Pinhole
from processing.cameras.network import Camera, Network, Shot

BOARD = Board(7, 5, 0.012, 0.009)
SIZE = (240, 320)
ELEVATIONS_DEG = (20, 30, 40, 50, 60, 70, 80, 88)
TURNS_DEG = (-150, -90, -30, 30, 90, 150)
SAMPLE = geometry.texel_grid(9, 0.06).reshape(-1, 3)


@dataclass(frozen=True)
class CameraRig:
    """What is true: the network in the frame of the axis, and which shots are taken of its boards."""

    network: Network
    shots: tuple[Shot, ...]

    @property
    def sizes(self):
        return dict.fromkeys(self.network.cameras, SIZE)

    @property
    def models(self):
        """The true cameras as models."""
        cameras = self.network.cameras.items()
        return {name: CameraModel(c.lens, geometry.invert(c.camera_from_rig), SIZE) for name, c in cameras}

    def corners(self, name, *shots):
        """The board's corners (n, 2) in one picture, or one after the other in several."""
        camera, corners_m = self.network.cameras[name], BOARD.corners_m()
        boards = [geometry.transform_points(self.network.rig_from_board(shot), corners_m) for shot in shots]
        in_rig = np.concatenate(boards)
        return camera.lens.project(geometry.transform_points(camera.camera_from_rig, in_rig))

    def views(self, noise_px, rng):
        """What the cameras find, corners that miss the picture left out."""
        return {
            name: {shot: _seen(self.corners(name, shot), noise_px, rng) for shot in self.shots}
            for name in self.network.cameras
        }

    def sample_px(self, name, camera=None):
        """Where a camera (the true one) sees points on the sample."""
        camera = camera or self.network.cameras[name]
        return camera.lens.project(geometry.transform_points(camera.camera_from_rig, SAMPLE))


def _seen(uv_px, noise_px, rng):
    found = inside(uv_px)
    return BoardView(BOARD.corners_m()[found], (uv_px + rng.normal(0, noise_px, uv_px.shape))[found])


def inside(uv_px):
    """Which image points (n, 2) lie far enough within the picture to be found."""
    return ((uv_px > 3) & (uv_px < np.array(SIZE[::-1]) - 4)).all(axis=1)


def camera_rig(rng, elevations_deg=ELEVATIONS_DEG, turns_deg=TURNS_DEG, poses=8):
    """Lenses drawn from what is believed of them, cameras and boards as on the simulated rig.

    The board of pose 0 lies a little beside the axis and tilted, its centre at z = 0, its right toward azimuth 0;
    without turns it is the rig frame.
    """
    cameras = {f"cam{i}": camera_at(elevation, rng) for i, elevation in enumerate(elevations_deg)}
    boards = {0: laid_board(rng) if turns_deg else np.eye(4)} | {pose: held_board(rng) for pose in range(1, poses)}
    shots = [Shot(pose) for pose in range(poses)] + [Shot(0, np.radians(angle)) for angle in turns_deg]
    return CameraRig(Network(cameras, boards, bool(turns_deg)), tuple(sorted(shots)))


def camera_at(elevation_deg, rng):
    """A long lens at a metre, roughly aimed at the origin: half a millimetre a pixel."""
    e = np.radians(elevation_deg)
    position = np.array([np.cos(e), 0, np.sin(e)]) + rng.normal(0, 1e-3, 3)
    pose = geometry.look_at(position, rng.normal(0, 2e-3, 3))
    focal = 2000 * rng.uniform(0.99, 1.01)
    middle = (np.array(SIZE[::-1]) - 1) / 2
    centre = middle + rng.normal(0, CENTRE_SIGMA * 2 * middle[0], 2)
    matrix = np.array([[focal + rng.normal(0, ASPECT_SIGMA * focal), 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]])
    return Camera(Pinhole(matrix, rng.normal(0, Pinhole.distortion_sigma)), geometry.invert(pose))


def laid_board(rng):
    tilt, shift = np.radians(0.05) * rng.standard_normal(2), 2e-4 * rng.standard_normal(2)
    board = geometry.rigid_from_vectors([*tilt, 0], [*shift, 0])
    return geometry.rotation_z(-np.arctan2(board[1, 0], board[0, 0])) @ board


def held_board(rng):
    azimuth, tilt, spin = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(12, 30)), rng.uniform(-0.5, 0.5)
    axis = tilt * np.array([np.cos(azimuth), np.sin(azimuth), 0])
    shift = rng.uniform([-0.012, -0.012, 0], [0.012, 0.012, 0.015])
    return geometry.rigid_from_vectors(axis, shift) @ geometry.rotation_z(spin)


def bounds_px(rig, noise_px):
    """Least standard deviations (cameras, points, 2) of predicted sample points: sigma sqrt(diag G (J'J)^-1 G').

    The second ones count the estimator's priors as observations (van Trees 1968): they hold on average over lenses
    drawn from these.
    """
    jacobian, lifted = _derivatives(rig)
    information = jacobian.T @ jacobian / noise_px**2
    return tuple(_predicted_sigma(lifted, one) for one in (information, information + _beliefs(rig.network)))


def _predicted_sigma(lifted, information):
    scale = 1 / np.sqrt(np.diag(information))
    spread = (lifted * scale) @ np.linalg.inv(information * np.outer(scale, scale)) * (lifted * scale)
    return np.sqrt(spread.sum(axis=1)).reshape(-1, len(SAMPLE), 2)


def _derivatives(rig):
    """Of all corners in view, and of the sample points, by all parameters: central differences."""
    cameras = list(rig.network.cameras)
    seen = {name: inside(rig.corners(name, *rig.shots)) for name in cameras}
    owners = {i: name for name, place in rig.network.camera_slices().items() for i in range(place.start, place.stop)}
    step = 1e-6
    blocks = [[np.zeros((2 * np.sum(seen[name]), rig.network.parameters)) for name in cameras]]
    blocks.append([np.zeros((2 * len(SAMPLE), rig.network.parameters)) for _ in cameras])
    for i, by in enumerate(step * np.eye(rig.network.parameters)):
        ahead, behind = (CameraRig(rig.network.moved(sign * by), rig.shots) for sign in (1, -1))
        for c, name in enumerate(cameras):
            if owners.get(i, name) == name:
                for block, predicted in zip(blocks, (_corners, _sample), strict=True):
                    block[c][:, i] = (predicted(ahead, name, seen) - predicted(behind, name, seen)) / (2 * step)
    return tuple(map(np.concatenate, blocks))


def _corners(rig, name, seen):
    return rig.corners(name, *rig.shots)[seen[name]].ravel()


def _sample(rig, name, _):
    return rig.sample_px(name).ravel()


def _beliefs(network):
    information = np.zeros((network.parameters,) * 2)
    for name, place in network.camera_slices().items():
        lens = network.cameras[name].lens
        at, focal = place.start, lens.matrix[1, 1]
        for i in (2, 3):
            information[at + i, at + i] += 1 / (CENTRE_SIGMA * (SIZE[1] - 1)) ** 2
        aspect = np.array([1.0, -1.0]) / (ASPECT_SIGMA * focal)
        information[at : at + 2, at : at + 2] += np.outer(aspect, aspect)
        rest = np.arange(at + 4, at + lens.parameters)
        information[rest, rest] += 1 / lens.distortion_sigma**2
    return information


def normalised_errors(true, found):
    """Errors of the lens's parameters, then of turn and shift of camera_from_rig, over the deviations claimed."""
    inside = (found.lens.matrix - true.lens.matrix)[[0, 1, 0, 1], [0, 1, 2, 2]]
    poses = [geometry.invert(camera.rig_from_camera) for camera in (found, true)]
    turn = Rotation.from_matrix(poses[0][:3, :3] @ poses[1][:3, :3].T).as_rotvec()
    shift = poses[0][:3, 3] - poses[1][:3, 3]
    return np.concatenate([inside, found.lens.distortion - true.lens.distortion, turn, shift]) / found.deviation


def axis_errors(true, found):
    """Tilt of pose 0 about X and Y and its shift along them, over the deviations claimed for the axis."""
    apart = found.boards[0] @ geometry.invert(true.boards[0])
    tilt = Rotation.from_matrix(apart[:3, :3]).as_rotvec()[:2] / found.axis.tilt_deviation_rad
    return np.concatenate([tilt, (found.boards[0] - true.boards[0])[:2, 3] / found.axis.place_deviation_m])
