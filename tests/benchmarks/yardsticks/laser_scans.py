"""Laser sweeps of a simulated rig, rendered where light falls, with what the sample truly is."""

import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import radians

import numpy as np

from processing import geometry
from processing.cameras.calibration import CameraModel
from processing.cameras.lens import Pinhole
from processing.laser.holder import Holder, plane_hits
from processing.laser.laser_plane import LaserMount
from processing.laser.mdf import Sweep
from processing.radiometry.sensor import Sensor
from service.bench import CHECKOUT
from simulators.clock import NS_PER_S
from simulators.layout import LaserLayout
from simulators.motor import LaserMotor
from simulators.optics import Optics
from simulators.pose import Pose

_DARK_FRAMES = 24  # drawn once and taken in turn where no laser falls: as many as a pulse's window holds
_MARGIN_PX = 4


@dataclass(frozen=True, slots=True)
class Location:
    """Where the laser stands."""

    azimuth_deg: float
    elevation_deg: float


@dataclass(frozen=True, slots=True)
class Recording:
    """How sweeps are recorded."""

    exposure_s: float = 1 / 15  # as long as the rig makes it, where a test sweep finds the stripe dim
    frame_rate_hz: float = 7.5


def planned() -> list[Location]:
    """The 26 locations of the plan that is an example for users."""
    plan = tomllib.loads((CHECKOUT / "docs" / "plans" / "mdf-26.toml").read_text())
    each = zip(plan["laser_elevations_deg"], plan["laser_azimuth_deg"], strict=True)
    return [Location(float(azimuth), float(elevation)) for elevation, azimuths in each for azimuth in azimuths]


def around(count: int, elevations_deg: Sequence[float] = (35.0, 50.0)) -> list[Location]:
    """That many locations, evenly about the sample on each mounting by turns, clear of the cameras' azimuth."""
    per_mounting = [len(range(i, count, len(elevations_deg))) for i in range(len(elevations_deg))]
    return [
        Location(float(azimuth), elevation)
        for elevation, n in zip(elevations_deg, per_mounting, strict=True)
        for azimuth in 15.0 + 330.0 * (np.arange(n) + 0.5) / n
    ]


@dataclass(frozen=True)
class Truth:
    """Displacement (n, n) in metres of one view, NaN where the ray meets nothing, and which a laser location lights.

    Texels that are not `inside` (n, n) the part of the image that is looked at have neither.
    """

    displacement_m: np.ndarray
    lit: np.ndarray
    inside: np.ndarray


class Scanner:
    """One camera of a simulated rig that looks at one sample.

    Frames hold the columns of the holder, or the middle `share` of these, and its rows. The analysis takes
    the camera to be its true self, or `model`.
    """

    def __init__(
        self, optics: Optics, camera: str, sample: str, share: float = 1.0, model: CameraModel | None = None
    ) -> None:
        self.optics, self.name, self.sample = optics, camera, sample
        device, self._unit = optics.layout.cameras[camera], optics.sensor(camera)
        lens = Pinhole(device.matrix, np.array([*device.distortion, 0, 0, 0]))
        whole = CameraModel(lens, device.rig_from_camera, (device.height_px, device.width_px))
        self._rows, self._columns = _crop(whole, self.holder, share)
        self.camera = _cropped(whole if model is None else model, self._rows, self._columns)

    @property
    def holder(self) -> Holder:
        """As the rig's file describes it."""
        h = self.optics.layout.holder
        return Holder(h.opening_m, h.upper_m, h.lower_m, h.step_m, h.depth_m, h.margin_m)

    def sweep(self, location: Location, recording: Recording) -> Sweep:
        """What the analysis is given of one location: frames come as they are asked for, with the nominal mount."""
        model, laser = self._unit.sensor, self.optics.layout.laser
        sensor = Sensor(model.black_dn, model.white_dn, model.gain_e_per_dn, model.read_noise_e)
        mount = LaserMount(radians(location.azimuth_deg), radians(location.elevation_deg), laser.distance_m)
        frames = self._frames(location, recording)
        return Sweep(self.name, frames, sensor, self.camera, np.eye(4), mount)

    def truth(self, locations: Sequence[Location], texels: int) -> Truth:
        """Of the texel grid."""
        uv_px = self.camera.project(geometry.texel_grid(texels, self.holder.texels_m))
        inside = ((uv_px > 0) & (uv_px < np.array(self.camera.size[::-1]) - 1)).all(axis=-1)
        lit = np.zeros((texels, texels), bool)
        for location in locations:
            told = self.optics.truth("displacement", self._pose(location, None), camera=self.name, texels=texels)
            lit |= np.load(told["lit_path"])
        return Truth(np.where(inside, np.load(told["path"]), np.nan), lit & inside, inside)

    def pixel_displacement(self) -> np.ndarray:
        """True displacement (h, w) in metres along the rays of the pixels."""
        told = self.optics.truth("points", self._pose(Location(90.0, 35.0), None), camera=self.name)
        points = np.load(told["path"])[self._rows, self._columns]
        way = points - plane_hits(self.camera, 0.0)
        return np.asarray(np.einsum("ijk,ijk->ij", way, self.camera.pixel_rays()))

    def _frames(self, location: Location, recording: Recording) -> Iterator[np.ndarray]:
        laser, crop = self.optics.layout.laser, (self._rows, self._columns)
        interval_s = 1 / recording.frame_rate_hz
        key = (self.optics.layout.seed, round(1000 * location.azimuth_deg), round(1000 * location.elevation_deg))
        motor = LaserMotor(laser.ticks_per_s, (0.0, float(laser.sweep_ticks)))
        motor.turn(0, 1, 7, key)
        dark = np.ascontiguousarray(self.optics.rate(self.name, self._pose(location, None))[crop])
        offset_dn = np.ascontiguousarray(self._unit.offset_dn[crop])
        expose = self._unit.sensor.expose
        unlit = [expose(dark, recording.exposure_s, (*key, "dark", i), offset_dn) for i in range(_DARK_FRAMES)]
        for number in range(int(np.ceil(laser.sweep_ticks / laser.ticks_per_s * recording.frame_rate_hz))):
            times_s = number * interval_s + np.array([0.0, recording.exposure_s])
            fan = _fans(motor, laser, times_s, location)
            light = self.optics.laser_rate(self.name, self._pose(location, fan))[crop]
            frame, near = unlit[number % _DARK_FRAMES].copy(), light > 0
            rate = light[near] + dark[near]
            frame[near] = expose(rate, recording.exposure_s, (*key, number), offset_dn[near])
            yield frame

    def _pose(self, location: Location, fan: tuple[float, float] | None) -> Pose:
        return Pose(
            self.sample, 0, 0.0, radians(location.azimuth_deg), 0.0, (), radians(location.elevation_deg),
            fan is not None, fan,
        )  # fmt: skip


def _cropped(camera: CameraModel, rows: slice, columns: slice) -> CameraModel:
    """The camera of a part of the image."""
    lens = camera.lens
    assert isinstance(lens, Pinhole)
    matrix = lens.matrix - np.array([[0, 0, columns.start], [0, 0, rows.start], [0, 0, 0]])
    size = (rows.stop - rows.start, columns.stop - columns.start)
    return replace(camera, lens=replace(lens, matrix=matrix), size=size)


def _crop(camera: CameraModel, holder: Holder, share: float) -> tuple[slice, slice]:
    """Rows and columns that hold the holder; even starts, so that the mosaic's pattern stays."""
    half = holder.outer_m / 2
    corners = np.array([[x, y, -holder.step_m] for x in (-half, half) for y in (-half, half)])
    uv_px = camera.project(corners)
    low, high = uv_px.min(axis=0) - _MARGIN_PX, uv_px.max(axis=0) + _MARGIN_PX
    spared = (1.0 - share) / 2 * (high[0] - low[0])
    low[0], high[0] = low[0] + spared, high[0] - spared
    low = np.maximum(low, 0).astype(int) // 2 * 2
    high = np.minimum(high, np.array(camera.size)[::-1]).astype(int)
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def _fans(motor: LaserMotor, laser: LaserLayout, times_s: np.ndarray, location: Location) -> tuple[float, float]:
    start, end = (
        laser.fan_rad(motor.ticks(round(t * NS_PER_S)), radians(location.elevation_deg)) for t in times_s
    )  # fmt: skip
    return start, end
