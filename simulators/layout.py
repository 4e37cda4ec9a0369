"""The rig as it was built: nominal numbers, which rig.toml tells, and true ones, which only calibration can find.

Rig frame: origin where the turntable axis meets the reference plane, +Z up, +X at azimuth 0. Metres and radians inside.
True poses differ from nominal ones by seeded amounts: cameras by up to 0.3 deg, 2 mm and 1 % in focal length (the front
camera, aimed with care through its long lens, by 0.05 deg and 1 mm), the hand-mounted laser by 0.3 deg and 2 mm, lamps
by 0.5 deg, 5 mm and 10 % in intensity, and by 2 % between the colours.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import atan2, cos, radians, sin
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
PHONE = "phone"  # the camera in the hand; see `simulators.phone`


@dataclass(frozen=True, slots=True)
class HolderLayout:
    """The stepped white frame and the box in which the sample lies."""

    opening_m: float = 0.060  # side of the square opening
    margin_m: float = 0.003  # of the sample beside the opening's edge, which the texels leave out
    upper_m: float = 0.076  # outer side of the frame at z = 0
    lower_m: float = 0.100  # outer side of the frame at z = -step_m
    step_m: float = 0.008
    depth_m: float = 0.004  # the sample lies between -depth_m and 0
    albedo: float = 0.9


@dataclass(frozen=True, slots=True)
class BoardLayout:
    """The ChArUco board: in pose 0 its centre near the rig origin, columns along +X, rows of the print along -Y.

    So a corner that OpenCV's board puts at (x, y) from the print's top left lies at (x - width/2, height/2 - y, 0) of
    the board; see `Layout.rig_from_board`.
    """

    columns: int = 7
    rows: int = 5
    square_m: float = 0.012
    marker_m: float = 0.009
    margin_m: float = 0.006  # white around the squares
    dictionary: str = "DICT_4X4_50"


@dataclass(frozen=True, slots=True)
class SphereLayout:
    """The SRF sphere at the rig origin, and the matt white card beside it.

    The card faces a camera at azimuth 0 and `card_elevation_rad`, which sees `card_y_m` to the right and `card_z_m` up.
    For the front camera it hangs below the sphere: there no direction of the horizontal LED arm has one shadow the
    other. For a camera of the arc, whose picture is lower, it stands upright to the right.
    """

    radius_m: float = 0.050
    card_y_m: float = 0.0
    card_z_m: float = -0.059
    card_width_m: float = 0.040
    card_height_m: float = 0.011
    card_albedo: float = 0.9
    card_elevation_rad: float = 0.0

    def facing(self, elevation_rad: float) -> "SphereLayout":
        """With the card where a camera at this elevation sees it."""
        if elevation_rad == 0.0:
            return self
        moved = replace(self, card_y_m=0.064, card_z_m=0.0, card_elevation_rad=elevation_rad)
        return replace(moved, card_width_m=self.card_height_m, card_height_m=self.card_width_m)


@dataclass(frozen=True, slots=True)
class MirrorLayout:
    """A polished ball of black glass on a matt black plate in the reference plane; `centre_m` in the sample frame."""

    centre_m: tuple[float, float, float] = (0.0, 0.0, 0.020)
    radius_m: float = 0.020
    refractive_index: float = 1.5
    plate_m: float = 0.100  # side of the square plate
    plate_albedo: float = 0.03


@dataclass(frozen=True, slots=True)
class AxisLayout:
    """One stepper axis."""

    module: int
    steps_per_deg: float
    min_deg: float
    max_deg: float
    forbidden_deg: tuple[tuple[float, float], ...] = ()
    speed_deg_s: float = 30.0
    acceleration_deg_s2: float = 60.0


@dataclass(frozen=True, slots=True)
class LampLayout:
    """One lamp on the arm or on the light arc: what its label says, and what is true.

    It is small: a disc of `radius_m` seen in a mirror, a point source to all else.
    """

    channel: int
    mount: str
    elevation_rad: float
    distance_m: float
    offsets: tuple[float, float, float] = (0.0, 0.0, 0.0)  # true less nominal: azimuth and elevation (rad), distance
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)  # true over nominal intensity in red, green, blue
    radius_m: float = 0.003


@dataclass(frozen=True)
class CameraLayout:
    """One camera: what its label says, and its true optics.

    `matrix` (3, 3) and `rig_from_camera` (4, 4) follow OpenCV's axes (x right, y down, z forward), pixel centres at
    integers; `distortion` = (k1, k2) on normalised coordinates.
    """

    name: str
    serial: str
    model: str
    mount: str
    elevation_rad: float
    distance_m: float
    width_px: int
    height_px: int
    matrix: Array
    distortion: tuple[float, float]
    rig_from_camera: Array
    megabytes_per_s: float = 20.0


class CameraLabel(Protocol):
    """What a camera says of itself on the wire, whatever lies behind."""

    @property
    def name(self) -> str:
        """Key in rig.toml."""
        ...

    @property
    def serial(self) -> str:
        """As engraved."""
        ...

    @property
    def model(self) -> str:
        """As engraved."""
        ...

    @property
    def width_px(self) -> int:
        """Of a picture."""
        ...

    @property
    def height_px(self) -> int:
        """Of a picture."""
        ...

    @property
    def megabytes_per_s(self) -> float:
        """Of the download."""
        ...


@dataclass(frozen=True, slots=True)
class LaserLayout:
    """The line laser on the light arc.

    The fan plane contains the source and a horizontal line through it, square to the azimuth of the arc. Its depression
    angle grows from the sweep's start, where it cuts the reference plane 52 mm behind the axis as seen from the laser,
    to the end, 52 mm before it. Each mounting has its own gearing, so that every sweep takes the same ticks.
    """

    distance_m: float = 0.800
    elevations_deg: tuple[float, ...] = (20.0, 35.0, 50.0, 65.0, 75.0)
    sweep_ticks: int = 480  # 1/16 turns of the rotation sensor
    ticks_per_s: float = 39.2  # 104 mm in 12.2 s
    reach_m: float = 0.052
    sigma_m: float = 0.0008  # Gaussian half width across the plane
    offsets: tuple[tuple[float, float], ...] = ((0.0, 0.0),) * 5  # true minus nominal (rad, m) per mounting

    def mounting(self, elevation_rad: float) -> tuple[float, float]:
        """True elevation (rad) and distance (m) of the mounting that was meant to have this elevation."""
        nearest = int(np.argmin(np.abs(np.radians(self.elevations_deg) - elevation_rad)))
        turn, shift = self.offsets[nearest]
        return elevation_rad + turn, self.distance_m + shift

    def fan_rad(self, ticks: float, elevation_rad: float) -> float:
        """Depression angle of the fan plane at this count of the rotation sensor since the start of the sweep."""
        start, end = (self._fan_at(reach, elevation_rad) for reach in (-self.reach_m, self.reach_m))
        return start + (end - start) * ticks / self.sweep_ticks

    def _fan_at(self, trace_m: float, elevation_rad: float) -> float:
        true_rad, distance_m = self.mounting(elevation_rad)
        return atan2(distance_m * sin(true_rad), distance_m * cos(true_rad) - trace_m)

    def source(self, light_arc_rad: float, elevation_rad: float) -> Array:
        """Position of the laser (3,), rig frame, metres."""
        true_rad, distance_m = self.mounting(elevation_rad)
        return distance_m * direction(light_arc_rad, true_rad)

    def plane(self, light_arc_rad: float, elevation_rad: float, fan_rad: float) -> tuple[Array, float]:
        """Unit normal n and offset d of the fan plane n . x = d, rig frame, metres."""
        normal = np.array([sin(fan_rad) * cos(light_arc_rad), sin(fan_rad) * sin(light_arc_rad), -cos(fan_rad)])
        return normal, float(normal @ self.source(light_arc_rad, elevation_rad))


@dataclass(frozen=True)
class Layout:
    """Everything of one rig; build it with `build_layout`."""

    size: str
    seed: int
    axes: Mapping[str, AxisLayout]
    lamps: Mapping[str, LampLayout]
    cameras: Mapping[str, CameraLayout]
    laser: LaserLayout
    holder: HolderLayout = field(default_factory=HolderLayout)
    board: BoardLayout = field(default_factory=BoardLayout)
    sphere: SphereLayout = field(default_factory=SphereLayout)
    mirror: MirrorLayout = field(default_factory=MirrorLayout)

    def lamp_position(self, name: str, light_arc_rad: float, arm_rad: float) -> Array:
        """True position of the lamp (3,), rig frame, metres."""
        lamp = self.lamps[name]
        azimuth_rad = arm_rad if lamp.mount == "arm" else light_arc_rad
        round_rad, up_rad, away_m = lamp.offsets
        return (lamp.distance_m + away_m) * direction(azimuth_rad + round_rad, lamp.elevation_rad + up_rad)

    def rig_from_board(self, pose: int) -> Array:
        """Rigid transform (4, 4) of the board's centre with the turntable at 0.

        Pose 0 lies on the turntable as well as a hand puts it there: off by up to 0.3 mm, 0.1 deg of tilt and 0.2 deg
        about the axis. The others tilt by up to 30 deg and shift.
        """
        rng = np.random.default_rng([self.seed, 7, pose])
        if pose == 0:
            toward_rad, off_rad = rng.uniform(-np.pi, np.pi, 2)
            tilt = radians(rng.uniform(0.02, 0.1)) * np.array([cos(toward_rad), sin(toward_rad), 0.0])
            spin = np.array([0.0, 0.0, radians(rng.uniform(-0.2, 0.2))])
            shift_m = rng.uniform(0.0001, 0.0003) * np.array([cos(off_rad), sin(off_rad), 0.0])
            return transform(rotation(tilt) @ rotation(spin), shift_m)
        azimuth_rad, spin_rad = rng.uniform(-np.pi, np.pi), rng.uniform(-0.5, 0.5)
        tilt_rad = radians(rng.uniform(12, 30))
        axis = np.array([cos(azimuth_rad), sin(azimuth_rad), 0.0])
        turn = rotation(axis * tilt_rad) @ rotation(np.array([0.0, 0.0, spin_rad]))
        return transform(turn, rng.uniform([-0.012, -0.012, 0.0], [0.012, 0.012, 0.015]))


def build_layout(seed: int, size: str) -> Layout:
    """The rig of this seed; `size` is "small" (320 x 240, front 640 x 480) or "full" (1024 x 768, 2560 x 1920)."""
    if size not in ("small", "full"):
        raise ValueError(f"size {size!r} is neither 'small' nor 'full'")
    axes = {
        "arm": AxisLayout(module=1, steps_per_deg=100.0, min_deg=-90.0, max_deg=90.0),
        "light_arc": AxisLayout(2, 100.0, -180.0, 180.0, forbidden_deg=((-12.0, 12.0),)),
        "turntable": AxisLayout(module=3, steps_per_deg=160.0, min_deg=-200.0, max_deg=200.0),
    }
    lamps = {f"lamp{i}": _lamp(seed, i + 1, "light_arc", 10.0 * (i + 1), 0.900) for i in range(8)}
    lamps["led"] = _lamp(seed, 9, "arm", 0.0, 0.600)
    elevations_deg = (20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 88.0)
    cameras = {f"cam{i}": _arc_camera(i, elevation, seed, size) for i, elevation in enumerate(elevations_deg)}
    cameras["front"] = _front_camera(seed, size)
    drawn = np.random.default_rng([seed, 3]).uniform(-1, 1, (5, 2)) * (radians(0.3), 0.002)
    # Those of 35 and 50 deg are drawn first: every seed's rig had these two before it had the others.
    laser = LaserLayout(offsets=tuple((float(turn), float(shift)) for turn, shift in drawn[[2, 0, 1, 3, 4]]))
    seat_m = np.random.default_rng([seed, 5]).uniform(-1, 1, 3) * (0.003, 0.003, 0.0005)
    mirror = MirrorLayout(centre_m=(float(seat_m[0]), float(seat_m[1]), 0.020 + float(seat_m[2])))
    return Layout(size, seed, axes, lamps, cameras, laser, mirror=mirror)


def _lamp(seed: int, channel: int, mount: str, elevation_deg: float, distance_m: float) -> LampLayout:
    rng = np.random.default_rng([seed, 4, channel])
    elevation_rad = radians(elevation_deg)
    sideways, up, away = _within_ball(rng) * (radians(0.5), radians(0.5), 0.005)
    gains = (1 + rng.uniform(-0.10, 0.10)) * (1 + rng.uniform(-0.02, 0.02, 3))
    offsets = (float(sideways / cos(elevation_rad)), float(up), float(away))
    return LampLayout(
        channel, mount, elevation_rad, distance_m, offsets, (float(gains[0]), float(gains[1]), float(gains[2]))
    )


def _arc_camera(index: int, elevation_deg: float, seed: int, size: str) -> CameraLayout:
    scale = 1.0 if size == "small" else 3.2
    rng = np.random.default_rng([seed, 1, index])
    matrix = _matrix(2000.0 * scale * rng.uniform(0.99, 1.01), 320 * scale, 240 * scale, rng.uniform(-3, 3, 2) * scale)
    pose = _true_pose(radians(elevation_deg), 1.0, radians(0.3), 0.002, rng)
    distortion = (float(rng.uniform(-0.12, -0.08)), float(rng.uniform(-0.05, 0.05)))
    return CameraLayout(
        f"cam{index}", f"VC-{index:04d}", "Virtual Arc Camera", "camera_arc", radians(elevation_deg), 1.0,
        round(320 * scale), round(240 * scale), matrix, distortion, pose,
    )  # fmt: skip


def _front_camera(seed: int, size: str) -> CameraLayout:
    scale = 1.0 if size == "small" else 4.0
    rng = np.random.default_rng([seed, 2])
    # 3900 px: the sphere's radius is 177 px and the card below it is still in the picture.
    matrix = _matrix(
        3900.0 * scale * rng.uniform(0.997, 1.003), 640 * scale, 480 * scale, rng.uniform(-2, 2, 2) * scale
    )
    pose = _true_pose(0.0, 1.1, radians(0.05), 0.001, rng)
    distortion = (float(rng.uniform(-0.12, -0.08)), 0.0)
    return CameraLayout(
        "front", "DS-0001", "Virtual DSLR", "front", 0.0, 1.1,
        round(640 * scale), round(480 * scale), matrix, distortion, pose,
    )  # fmt: skip


def direction(azimuth_rad: float, elevation_rad: float) -> Array:
    """Unit vector (3,) of an azimuth from +X toward +Y and an elevation from the horizon."""
    return np.array([
        cos(elevation_rad) * cos(azimuth_rad),
        cos(elevation_rad) * sin(azimuth_rad),
        sin(elevation_rad),
    ])  # fmt: skip


def rotation(vector_rad: Array) -> Array:
    """Rotation matrix (3, 3) about the vector by its length in radians (Rodrigues' formula)."""
    angle = float(np.linalg.norm(vector_rad))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector_rad / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned: Array = np.eye(3) + sin(angle) * cross + (1 - cos(angle)) * cross @ cross
    return turned


def transform(turn: Array, shift_m: Array) -> Array:
    """Rigid transform (4, 4) of a rotation (3, 3) followed by a shift (3,)."""
    matrix = np.eye(4)
    matrix[:3, :3] = turn
    matrix[:3, 3] = shift_m
    return matrix


def _true_pose(
    elevation_rad: float, distance_m: float, turn_rad: float, shift_m: float, rng: np.random.Generator
) -> Array:
    """rig_from_camera of a camera at azimuth 0 that looks at the origin, but not quite."""
    outward = direction(0.0, elevation_rad)
    right = np.array([0.0, 1.0, 0.0])
    nominal = np.column_stack([right, np.cross(-outward, right), -outward])
    off_axis, off_place = (_within_ball(rng) for _ in range(2))
    return transform(nominal @ rotation(turn_rad * off_axis), distance_m * outward + shift_m * off_place)


def _within_ball(rng: np.random.Generator) -> Array:
    vector = rng.standard_normal(3)
    inside: Array = vector / np.linalg.norm(vector) * rng.uniform(0.3, 1.0)
    return inside


def _matrix(focal_px: float, width_px: float, height_px: float, off_centre_px: Array) -> Array:
    centre_u, centre_v = (width_px - 1) / 2 + off_centre_px[0], (height_px - 1) / 2 + off_centre_px[1]
    return np.array([[focal_px, 0.0, centre_u], [0.0, focal_px, centre_v], [0.0, 0.0, 1.0]])
