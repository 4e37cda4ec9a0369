"""Camera models: intrinsics, distortion and place in the rig frame, from views of a board (Zhang 2000)."""

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.cameras import bundle
from processing.cameras.board import MIN_CORNERS, Board, BoardView, find_charuco
from processing.cameras.lens import LENSES, Fisheye, Lens, Pinhole
from processing.cameras.network import POSE_PARAMETERS, Shot, Views
from processing.cameras.placement import board_poses, place
from processing.cameras.start import fisheye_start, pinhole_start
from processing.cameras.turntable import Axis, axis_of, network_of
from processing.errors import CalibrationError

Array = NDArray[np.float64]
MIN_VIEWS = 3  # two poses determine five intrinsics at best; the third checks them
MAX_FOCAL_DEVIATION = 0.05  # relative; above it the boards are too parallel to tell focal length from distance
_SCHEMA = "camera-models/2"


@dataclass(frozen=True)
class CameraModel:
    """One camera: its `lens`, `rig_from_camera` (4, 4), `size` (rows, columns).

    `rms_px` is the root mean square distance between found and predicted corners. `deviation` (p + 6,) are one-sigma
    uncertainties of the lens's p parameters (fx fy cx cy in px, then the distortion) and of the turn (rad) and shift
    (m) of `camera_from_rig`, in the camera's axes; NaN where unknown.
    """

    lens: Lens
    rig_from_camera: Array
    size: tuple[int, int]
    rms_px: float = float("nan")
    deviation: Array | None = None

    @property
    def centre_m(self) -> Array:
        """The camera's centre (3,) in the rig frame."""
        return self.rig_from_camera[:3, 3]

    def project(self, points_m: NDArray[np.floating]) -> Array:
        """Image points (..., 2) of rig-frame points (..., 3); NaN where the lens forms no image of them."""
        return self.lens.project(geometry.transform_points(geometry.invert(self.rig_from_camera), points_m))

    def rays(self, uv_px: NDArray[np.floating]) -> Array:
        """Unit rig-frame directions (..., 3) from the centre through image points (..., 2); NaN out of the image."""
        return geometry.rotate(self.rig_from_camera, self.lens.rays(uv_px))

    def pixel_rays(self) -> Array:
        """Unit rig-frame directions (h, w, 3) through all pixel centres, computed once; not to be written to."""
        return self._pixel_rays

    @cached_property
    def _pixel_rays(self) -> Array:
        rows, columns = np.indices(self.size)
        rays = self.rays(np.stack([columns, rows], axis=-1).astype(np.float64))
        rays.setflags(write=False)
        return rays

    def to_json(self) -> dict[str, Any]:
        """Numbers and lists."""
        return {
            "lens": self.lens.name,
            "matrix": self.lens.matrix.tolist(),
            "distortion": self.lens.distortion.tolist(),
            "rig_from_camera": self.rig_from_camera.tolist(),
            "size": list(self.size),
            "rms_px": None if np.isnan(self.rms_px) else self.rms_px,
            "deviation": None if self.deviation is None else self.deviation.tolist(),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> "CameraModel":
        """Inverse of `to_json`. Raises CalibrationError where a field is missing, misshapen or no number."""
        try:
            kind = LENSES[data["lens"]]
            matrix, distortion, pose = (
                np.asarray(data[key], np.float64).reshape(shape)
                for key, shape in (
                    ("matrix", (3, 3)), ("distortion", kind.distortion_sigma.shape), ("rig_from_camera", (4, 4))
                )
            )  # fmt: skip
            rows, columns = data["size"]
            rms_px = np.nan if data["rms_px"] is None else float(data["rms_px"])
            unknown = data["deviation"] is None
            parameters = 4 + len(distortion) + POSE_PARAMETERS
            deviation = None if unknown else np.asarray(data["deviation"], np.float64).reshape(parameters)
            if not all(np.isfinite(part).all() for part in (matrix, distortion, pose)):
                raise ValueError("lens and pose must be finite")
        except (KeyError, TypeError, ValueError) as error:
            raise CalibrationError(f"not a camera model: {error!r}") from error
        return cls(kind(matrix, distortion), pose, (int(rows), int(columns)), rms_px, deviation)


def write_cameras(cameras: Mapping[str, CameraModel], path: Path) -> None:
    """Write camera models as JSON."""
    content = {"schema": _SCHEMA, "cameras": {name: camera.to_json() for name, camera in cameras.items()}}
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read_cameras(path: Path) -> dict[str, CameraModel]:
    """Read camera models. Raises CalibrationError that names the file."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["schema"] != _SCHEMA:
            raise CalibrationError(f"schema {content['schema']!r}, not {_SCHEMA!r}")
        return {name: CameraModel.from_json(data) for name, data in content["cameras"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, CalibrationError) as error:
        raise CalibrationError(f"{path}: not a calibration: {error}. Run the calibrate plan again.") from error


@dataclass(frozen=True)
class Residuals:
    """Found corners `uv_px` (n, 2) of a camera, predicted less found `error_px` (n, 2), and which took part (n,)."""

    uv_px: Array
    error_px: Array
    accepted: NDArray[np.bool_]


@dataclass(frozen=True)
class Survey:
    """Cameras, boards and axis as one adjustment found them, in the rig frame.

    `boards` holds `rig_from_board` by pose, with the turntable at 0. `axis` is None where no board was turned: then
    the rig frame is the board of pose 0, which stands for the turntable as well as a hand has put it there.
    `left_out` says of cameras that could not take part why.
    """

    cameras: Mapping[str, CameraModel]
    boards: Mapping[int, Array]
    axis: Axis | None
    residuals: Mapping[str, Residuals]
    left_out: Mapping[str, str] = field(default_factory=dict)

    def facing(self, names: Collection[str]) -> "Survey":
        """The same survey with azimuth 0 where the named cameras stand, in the mean, as seen from the axis.

        A camera counts by the square of its distance from the axis over that from the origin, the board's own right by
        a quarter: an arc is believed to a thousandth of its radius, a board put by hand to two.
        """
        away = [self.cameras[name].centre_m / np.linalg.norm(self.cameras[name].centre_m) for name in names]
        right = self.boards[0][:2, 0]
        toward = sum((np.linalg.norm(a[:2]) * a[:2] for a in away), start=0.25 * right / np.linalg.norm(right))
        turn = geometry.rotation_z(-float(np.arctan2(toward[1], toward[0])))
        cameras = {n: replace(c, rig_from_camera=turn @ c.rig_from_camera) for n, c in self.cameras.items()}
        return replace(self, cameras=cameras, boards={pose: turn @ board for pose, board in self.boards.items()})


def calibrate_camera(views: Sequence[BoardView], size: tuple[int, int], lens: type[Lens] = Pinhole) -> CameraModel:
    """One camera from views of a board in any poses; its rig frame is the first usable view's board frame.

    Raises CalibrationError where fewer than three views have enough corners or do not determine the camera.
    """
    usable = [view for view in map(_finite, views) if _places(view)]
    shots = {Shot(pose): view for pose, view in enumerate(usable)}
    return survey({"camera": shots}, {"camera": size}, lens).cameras["camera"]


def survey_images(images: Mapping[str, Mapping[Shot, NDArray[np.generic]]], board: Board) -> Survey:
    """As `survey`, from images {camera: {shot: image}} of one board; cameras that read it too seldom are left out.

    Images are linear or not, grey or colour; of a mosaic give `radiometry.mosaic.grey_mosaic`, which keeps its
    resolution. Raises CalibrationError as `survey`, and where no camera is left.
    """
    sizes = {name: _size(name, shots) for name, shots in images.items()}
    views = {
        name: {shot: find_charuco(image, board) for shot, image in shots.items()} for name, shots in images.items()
    }
    lacks = {name: _lack(_placing(found)) for name, found in views.items()}
    left_out = {name: lack for name, lack in lacks.items() if lack}
    taking_part = {name: found for name, found in views.items() if name not in left_out}
    return replace(survey(taking_part or views, sizes), left_out=left_out)


def survey(views: Views, sizes: Mapping[str, tuple[int, int]], lens: type[Lens] = Pinhole) -> Survey:
    """All cameras, board poses and the turntable's axis from corners {camera: {shot: view}} of one board.

    In pose 0 the board lies on the turntable. Where a pose was photographed at several angles of the turntable, the
    axis is found: it is the rig frame's Z, the origin lies at the height of pose 0's centre, and pose 0's right is
    toward +X when the turntable stands at 0. Otherwise pose 0 is the rig frame: origin at its centre, its right along
    +X, its top along +Y. A camera that cannot read pose 0 is placed through poses that others see too. Each camera
    starts by itself (Zhang 2000); then all is refined together (see `bundle.adjust`).
    Raises CalibrationError that names the camera and what it lacks.
    """
    usable = {name: _usable(name, found) for name, found in views.items()}
    lenses = {name: _started(name, usable[name], sizes[name], lens) for name in usable}
    facing = {name: _from_the_front(name, found, lenses[name]) for name, found in usable.items()}
    adjusted = bundle.adjust(network_of(place(lenses, facing), lenses), facing)
    deviations = np.sqrt(np.maximum(np.diag(adjusted.covariance), 0))
    places = adjusted.network.camera_slices()
    cameras, residuals = {}, {}
    for name, camera in adjusted.network.cameras.items():
        deviation, error = deviations[places[name]], adjusted.errors_px[name]
        _check_determined(name, camera.lens, deviation)
        rms_px = float(np.sqrt((error**2).sum(axis=1).mean()))
        pose = geometry.invert(camera.camera_from_rig)
        cameras[name] = CameraModel(camera.lens, pose, sizes[name], rms_px, deviation)
        found_px = np.concatenate([view.uv_px for view in facing[name].values()])
        residuals[name] = Residuals(found_px, error, adjusted.accepted[name])
    axis = axis_of(adjusted.network, adjusted.covariance) if adjusted.network.turned else None
    return Survey(cameras, adjusted.network.boards, axis, residuals)


def _finite(view: BoardView) -> BoardView:
    """Without corners that are no numbers."""
    finite = np.isfinite(view.uv_px).all(axis=1) & np.isfinite(view.points_m).all(axis=1)
    return BoardView(view.points_m[finite], view.uv_px[finite])


def _places(view: BoardView) -> bool:
    """Whether the corners are enough to place the board, four of them with no three on one line.

    At a slant often one row alone is read. A homography from the board to itself is sought (direct linear transform):
    its equations have rank 8 where it is the only one.
    """
    if len(view.uv_px) < MIN_CORNERS:
        return False
    around = view.points_m[:, :2] - view.points_m[:, :2].mean(axis=0)
    x, y = around.T / max(float(np.abs(around).max()), 1e-300)
    point, zero = np.stack([x, y, np.ones_like(x)], axis=1), np.zeros((len(x), 3))
    rows = np.block([[point, zero, -x[:, None] * point], [zero, point, -y[:, None] * point]])
    return bool(np.linalg.matrix_rank(rows, tol=1e-6) == 8)


def _usable(name: str, found: Mapping[Shot, BoardView]) -> dict[Shot, BoardView]:
    """The views with enough corners."""
    usable = _placing(found)
    if lack := _lack(usable):
        raise CalibrationError(f"{name}: {lack}")
    return usable


def _placing(found: Mapping[Shot, BoardView]) -> dict[Shot, BoardView]:
    """The views whose corners place the board, in the order of their shots."""
    views = {shot: _finite(found[shot]) for shot in sorted(found)}
    return {shot: view for shot, view in views.items() if _places(view)}


def _lack(placing: Mapping[Shot, BoardView]) -> str:
    """What these views lack to calibrate a camera; empty where nothing."""
    poses = len({shot.pose for shot in placing})
    if poses >= MIN_VIEWS:
        return ""
    return f"the board was read in {poses} poses; {MIN_VIEWS} are needed. Check focus and light."


def _from_the_front(name: str, found: Mapping[Shot, BoardView], lens: Lens) -> dict[Shot, BoardView]:
    """The views that a board's front can give."""
    facing = {shot: view for shot, view in found.items() if len(board_poses(lens, view))}
    if 2 * len(facing) < len(found):
        raise CalibrationError(
            f"{name}: {len(found) - len(facing)} of {len(found)} boards are seen from behind; are its pictures "
            "mirrored, or its corners counted the other way round?"
        )
    return facing


def _size(name: str, shots: Mapping[Shot, NDArray[np.generic]]) -> tuple[int, int]:
    sizes = {image.shape[:2] for image in shots.values()}
    if len(sizes) != 1:
        raise CalibrationError(f"{name}: images of sizes {sorted(sizes)}; one size is needed.")
    rows, columns = sizes.pop()
    return int(rows), int(columns)


def _started(name: str, found: Mapping[Shot, BoardView], size: tuple[int, int], lens: type[Lens]) -> Lens:
    """The camera's focal length by itself."""
    start = {Pinhole: pinhole_start, Fisheye: fisheye_start}[lens]
    try:
        return start(list(found.values()), size)
    except CalibrationError as error:
        raise CalibrationError(f"{name}: {error}") from error


def _check_determined(name: str, lens: Lens, deviation: Array) -> None:
    finite = np.isfinite(lens.matrix).all() and np.isfinite(lens.distortion).all() and np.isfinite(deviation[:4]).all()
    focal = lens.matrix[[0, 1], [0, 1]]
    if not finite or (focal <= 0).any() or (deviation[:2] > MAX_FOCAL_DEVIATION * focal).any():
        raise CalibrationError(
            f"{name}: the boards do not determine the focal length ({focal[0]:.0f} px, sigma {deviation[0]:.0f} px); "
            "tilt them more, by 15 to 30 deg in different directions."
        )
