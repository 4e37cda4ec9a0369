"""Camera models: intrinsics, distortion and place in the rig frame, from views of a board (Zhang 2000)."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.cameras import bundle, placement
from processing.cameras.board import MIN_CORNERS, Board, BoardView, find_charuco
from processing.cameras.lens import LENSES, Lens, Pinhole
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
        """Unit rig-frame directions (h, w, 3) through all pixel centres."""
        rows, columns = np.indices(self.size)
        return self.rays(np.stack([columns, rows], axis=-1).astype(np.float64))

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
        """Inverse of `to_json`. Raises CalibrationError where a field is missing or misshapen."""
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
            deviation = None if data["deviation"] is None else np.asarray(data["deviation"], np.float64)
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


def calibrate_camera(views: Sequence[BoardView], size: tuple[int, int]) -> CameraModel:
    """One camera from views of a board in any poses; its rig frame is the first usable view's board frame.

    Raises CalibrationError where fewer than three views have enough corners or do not determine the camera.
    """
    usable = [view for view in views if len(view.uv_px) >= MIN_CORNERS]
    return calibrate_views({"camera": dict(enumerate(usable))}, {"camera": size})["camera"]


def calibrate_cameras(images: Mapping[str, Mapping[int, NDArray[np.generic]]], board: Board) -> dict[str, CameraModel]:
    """All cameras from their images {camera: {pose: image}} of one board in poses that they share.

    Images are linear or not, grey or colour; of a mosaic give `radiometry.grey_mosaic`, which keeps its resolution.
    Pose 0 is the rig frame: the board flat on the reference plane, its centre at the origin, its right along +X, its
    top along +Y. A camera that cannot read pose 0 is placed through poses that others see too. Each camera starts
    from Zhang's method; then all cameras and board poses are refined together (see `bundle.adjust`).
    Raises CalibrationError that names the camera and what it lacks.
    """
    views = {
        name: {
            pose: found
            for pose, image in shots.items()
            if len((found := find_charuco(image, board)).uv_px) >= MIN_CORNERS
        }
        for name, shots in images.items()
    }
    sizes = {name: _size(name, shots) for name, shots in images.items()}
    return calibrate_views(views, sizes)


def calibrate_views(
    views: Mapping[str, Mapping[int, BoardView]], sizes: Mapping[str, tuple[int, int]]
) -> dict[str, CameraModel]:
    """As `calibrate_cameras`, from found corners."""
    for name, found in views.items():
        if len(found) < MIN_VIEWS:
            raise CalibrationError(
                f"{name}: the board was read in {len(found)} poses; {MIN_VIEWS} are needed. Check focus and light."
            )
    start = _start(views, sizes)
    adjusted = bundle.adjust(start, views)
    for name, camera in adjusted.items():
        _check_determined(name, camera.matrix, camera.distortion, camera.deviation)
    return {
        name: CameraModel(
            Pinhole(c.matrix, c.distortion), geometry.invert(c.camera_from_rig), sizes[name], c.rms_px, c.deviation
        )
        for name, c in adjusted.items()
    }


def _size(name: str, shots: Mapping[int, NDArray[np.generic]]) -> tuple[int, int]:
    sizes = {image.shape[:2] for image in shots.values()}
    if len(sizes) != 1:
        raise CalibrationError(f"{name}: images of sizes {sorted(sizes)}; one size is needed.")
    rows, columns = sizes.pop()
    return int(rows), int(columns)


def _start(views: Mapping[str, Mapping[int, BoardView]], sizes: Mapping[str, tuple[int, int]]) -> bundle.Network:
    """Every camera's focal length by itself, then all poses by consensus."""
    matrices = {}
    for name, found in views.items():
        try:
            matrices[name] = _zhang(list(found.values()), sizes[name])
        except CalibrationError as error:
            raise CalibrationError(f"{name}: {error}") from error
    return placement.place(matrices, views)


def _zhang(views: Sequence[BoardView], size: tuple[int, int]) -> Array:
    """Matrix by Zhang's method: focal length only, principal point in the middle, no distortion."""
    flags = cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST
    flags |= cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    points = [view.points_m.astype(np.float32) for view in views]
    uv_px = [view.uv_px.astype(np.float32) for view in views]
    square = np.array([[1.0, 0, (size[1] - 1) / 2], [0, 1.0, (size[0] - 1) / 2], [0, 0, 1]])
    try:
        _, matrix, *_ = cv2.calibrateCamera(points, uv_px, (size[1], size[0]), square, np.zeros(5), flags=flags)
    except cv2.error as error:
        raise CalibrationError(f"the views do not determine the camera: {error.err}. Tilt the board more.") from error
    return np.asarray(matrix, np.float64)


def _check_determined(name: str, matrix: Array, distortion: Array, deviation: Array) -> None:
    finite = np.isfinite(matrix).all() and np.isfinite(distortion).all() and np.isfinite(deviation[:4]).all()
    focal = matrix[[0, 1], [0, 1]]
    if not finite or (focal <= 0).any() or (deviation[:2] > MAX_FOCAL_DEVIATION * focal).any():
        raise CalibrationError(
            f"{name}: the boards do not determine the focal length ({focal[0]:.0f} px, sigma {deviation[0]:.0f} px); "
            "tilt them more, by 15 to 30 deg in different directions."
        )
