"""The description of somebody else's scan: a TOML file beside its pictures. Degrees and millimetres."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from processing.errors import ImageError
from processing.formats.sequence import Picture, read_picture, read_sequence
from processing.laser.laser_chessboard import Chessboard, LaserChessboard, laser_chessboard
from processing.laser.motion import Motion, Slide, Turn
from processing.laser.plane_fit import Plane
from processing.laser.profile_scan import ScanSetup
from processing.laser.stripe import LaserColour
from rig.config import read_toml

Array = NDArray[np.float64]


def _with_length(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(vector):
        raise ValueError("a direction has a length")
    return vector


def _not_zero(value: float) -> float:
    if value == 0.0:
        raise ValueError("must not be 0")
    return value


Vector = tuple[float, float, float]
Direction = Annotated[Vector, AfterValidator(_with_length)]
NotZero = Annotated[float, AfterValidator(_not_zero)]
BOARD = "board.toml"
Size = tuple[int, int]  # width and height
_CENTRAL = 0.2  # of a picture's size, from its middle to the camera's centre: lenses are mounted better than that


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class CameraTable(_Model):
    """OpenCV's camera matrix, in pixels, its distortion k1 k2 p1 p2 k3, and the size of the pictures it is for."""

    matrix: tuple[Vector, Vector, Vector]
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    size_px: Size | None = None

    @model_validator(mode="after")
    def _is_a_camera(self) -> Self:
        (fx, _, cx), (_, fy, cy), _ = self.matrix
        if min(fx, fy) <= 0 or self.matrix != ((fx, 0.0, cx), (0.0, fy, cy), (0.0, 0.0, 1.0)):
            raise ValueError("a camera matrix is [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx and fy over 0")
        return self


class PlaneTable(_Model):
    """The laser's plane, normal . p = offset_mm, in the camera's frame: x right, y down, z forward."""

    normal: Direction
    offset_mm: NotZero  # a plane through the camera looks like a line


class TurntableTable(_Model):
    """A turning object, camera frame; positive steps turn as a right-handed screw along the axis."""

    axis_point_mm: Vector
    axis_direction: Direction
    step_deg: NotZero
    radius_mm: float = Field(gt=0, default=1e6)  # what lies farther from the axis is not the object

    @model_validator(mode="after")
    def _passes_the_camera(self) -> Self:
        if np.linalg.norm(np.cross(self.axis_point_mm, self.axis_direction)) < 1e-6:
            raise ValueError("the axis goes through the camera")
        return self


class StageTable(_Model):
    """An object on a linear stage, camera frame."""

    direction: Direction
    step_mm: NotZero


class ScanFile(_Model):
    """What the file may say; every path is relative to the file's folder."""

    images: str
    laser: LaserColour = LaserColour.RED
    background: str = ""  # a picture without laser, or a folder with one for each frame
    depth_mm: tuple[float, float] = (0.0, 1e9)  # along the optical axis; what lies outside is not the object
    stripe_sigma_px: float | None = Field(gt=0.3, lt=50, default=None)
    threshold: float | None = Field(gt=0, default=None)
    stripes: str = ""  # a folder of stripe photographs that tells camera and laser plane
    camera: CameraTable | None = None
    laser_plane: PlaneTable | None = None
    turntable: TurntableTable | None = None
    stage: StageTable | None = None

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if (self.turntable is None) == (self.stage is None):
            raise ValueError("one of the tables [turntable] and [stage] is needed, and one only")
        named = self.camera is not None, self.laser_plane is not None
        if any(named) if self.stripes else not all(named):
            raise ValueError("either the tables [camera] and [laser_plane], or `stripes`, a folder that tells both")
        if self.stripes and self.laser == LaserColour.GREY:
            raise ValueError("`stripes` needs a laser of a colour, which tells it from the board's squares")
        if self.depth_mm[0] >= self.depth_mm[1]:
            raise ValueError("depth_mm runs from near to far")
        return self


class BoardFile(_Model):
    """What board.toml says beside photographs of the laser's line on a chessboard."""

    columns: int = Field(ge=3)
    rows: int = Field(ge=3)
    square_mm: float = Field(gt=0)
    laser: Literal["red", "green", "blue"] | None = None


@dataclass(frozen=True)
class ScanSource:
    """The frames of a scan, what was taken without laser, and the setup."""

    frames: Sequence[Picture]
    backgrounds: Sequence[Picture]
    setup: ScanSetup


def open_scan(path: Path) -> ScanSource:
    """Read a scan's description and find its pictures.

    Raises ConfigError that names the field that is wrong, ImageError for pictures that cannot be used.
    """
    file, folder = read_toml(path, ScanFile), path.parent
    frames = read_sequence(folder / file.images)
    setup, size_px = _setup(file, folder)
    _check_size(folder / file.images, frames[0].shape, setup.matrix, size_px)
    return ScanSource(frames, _backgrounds(file, folder), setup)


def open_stripes(folder: Path, colour: LaserColour) -> LaserChessboard:
    """The laser plane of a folder of photographs with board.toml, or of the MATLAB toolbox.

    `colour` is the laser's, unless board.toml says it. Raises ConfigError, and what `laser_chessboard` does.
    """
    if not (folder / BOARD).exists():
        return laser_chessboard(folder, colour)
    file = read_toml(folder / BOARD, BoardFile)
    board = Chessboard(file.columns, file.rows, file.square_mm * 1e-3)
    return laser_chessboard(folder, LaserColour(file.laser or colour), board)


def _check_size(images: Path, shape: tuple[int, ...], matrix: Array, stated_px: Size | None) -> None:
    """Raises ImageError where the camera was calibrated at another size, or seems so where none is stated.

    Pictures of half or twice the calibrated size have the camera's centre at a quarter of their width, or at its end.
    """
    height, width = shape[:2]
    across, down = matrix[:2, 2]
    if stated_px is not None and stated_px != (width, height):
        raise ImageError(
            f"{images}: pictures of {width} x {height} pixels, but the camera was calibrated at {stated_px[0]} x "
            f"{stated_px[1]}."
        )
    central = all(abs(place / size - 0.5) < _CENTRAL for place, size in ((across, width), (down, height)))
    if stated_px is None and not central:
        raise ImageError(
            f"{images}: pictures of {width} x {height} pixels, but the camera's centre is at ({across:.0f}, "
            f"{down:.0f}): was it calibrated at another size? If not, say size_px = [{width}, {height}] in [camera]."
        )


def _backgrounds(file: ScanFile, folder: Path) -> Sequence[Picture]:
    if not file.background:
        return ()
    place = folder / file.background
    return read_sequence(place) if place.is_dir() else [read_picture(place)]


def _setup(file: ScanFile, folder: Path) -> tuple[ScanSetup, Size | None]:
    """The setup, and the size of pictures that its camera is for, where that is known."""
    matrix, distortion, plane, size_px = _camera_and_plane(file, folder)
    setup = ScanSetup(
        matrix,
        distortion,
        plane,
        _motion(file),
        file.laser,
        file.depth_mm[0] * 1e-3,
        file.depth_mm[1] * 1e-3,
        np.inf if file.turntable is None else file.turntable.radius_mm * 1e-3,
        file.stripe_sigma_px,
        file.threshold,
    )
    return setup, size_px


def _camera_and_plane(file: ScanFile, folder: Path) -> tuple[Array, Array, Plane, Size | None]:
    if file.camera is None or file.laser_plane is None:
        found = open_stripes(folder / file.stripes, file.laser)
        camera = found.calibration
        return camera.matrix, camera.distortion, found.plane, camera.size_px
    normal = np.array(file.laser_plane.normal)
    length = float(np.linalg.norm(normal))
    plane = Plane(normal / length, file.laser_plane.offset_mm * 1e-3 / length, np.nan, 0)
    return np.array(file.camera.matrix), np.array(file.camera.distortion), plane, file.camera.size_px


def _motion(file: ScanFile) -> Motion:
    if file.turntable is not None:
        table = file.turntable
        step_rad = float(np.radians(table.step_deg))
        return Turn(np.array(table.axis_point_mm) * 1e-3, _unit(table.axis_direction), step_rad)
    assert file.stage is not None  # the model sees to it
    return Slide(_unit(file.stage.direction), file.stage.step_mm * 1e-3)


def _unit(vector: Vector) -> Array:
    return np.asarray(np.array(vector) / np.linalg.norm(vector))
