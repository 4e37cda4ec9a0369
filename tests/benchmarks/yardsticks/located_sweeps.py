"""Sweeps of one view from several laser locations, with their truth and the least error that their frames allow.

Two worlds: a smooth cap under the small forward model of `tests/reference/stripe_rig.py`, and the brick of the
simulated rig with its LEGO motor. Cameras are known exactly; where the laser stands and how its motor turns is not.

The bound of a sweep's displacement holds: the Poisson noise of stripe and background, read noise and rounding, the
stripe's true height and width and the exposure's length at every pixel, and the derivative of the ray's cut with the
true plane. It holds no error of planes, motion, width, background or camera, and no speckle: an estimator that knows
all of them could reach it.
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from processing.cameras.calibration import CameraModel
from processing.cameras.lens import Pinhole
from processing.geometry import rotation_z
from processing.laser.holder import Holder, plane_hits
from processing.laser.laser_plane import LaserMount
from processing.laser.mdf import Sweep
from processing.radiometry.sensor import Sensor
from simulators.light import stripe_angles, stripe_profile
from simulators.motor import LaserMotor
from simulators.optics import Optics
from simulators.pose import Pose
from tests.reference.stripe_rig import HOLDER, SENSOR, Rig, bump, camera_at, expose

ELEVATIONS_DEG = (35, 65, 20, 50, 75)  # the mountings of the simulated unit
FRAME_S, EXPOSURE_S, FRAMES = 1 / 7.5, 1 / 30, 94
RIG_HOLDER = Holder(0.060, 0.076, 0.100, 0.008, 0.004, 0.003)


@dataclass(frozen=True)
class Located:
    """One sweep as processing takes it, and what is true of it.

    `displacement_m` (h, w) is NaN where the laser does not reach, `bound_m2` its least variance. `fan` are the laser's
    true elevation, distance, azimuth and roll, `angle(time)` its true depression angle at times in frames.
    """

    sweep: Sweep
    holder: Holder
    displacement_m: np.ndarray
    bound_m2: np.ndarray
    fan: np.ndarray
    angle: Callable[[np.ndarray], np.ndarray]


def location(number: int) -> tuple[float, float]:
    """Azimuth and elevation in degrees of the numbered location: five mountings, each at azimuths spread evenly."""
    return (40.0 + 137.508 * number) % 360.0 - 180.0, ELEVATIONS_DEG[number % len(ELEVATIONS_DEG)]


def smooth_cap(number: int, scale: float = 1.0, frames: int = 96) -> Located:
    """A smooth cap seen from 60 deg, with a laser that stands up to 0.6 deg and 6 mm from where it should."""
    azimuth, elevation = location(number)
    off = np.random.default_rng((number, 5)).uniform(-1, 1, 2)
    rig = Rig(
        camera_at(60, scale),
        bump,
        azimuth_deg=azimuth,
        elevation_deg=elevation + 0.6 * off[0],
        distance_m=0.8 + 0.006 * off[1],
        frames=frames,
        frame_m=0.1085 / frames,
        reverse=number % 2 == 1,
    )
    points, displacement = rig.hits()
    lit = rig.lit(points)
    raw_dn = expose(rig.electrons(points, lit), np.random.default_rng((number, frames)))
    mount = LaserMount(np.radians(azimuth), np.radians(elevation), 0.8)
    sweep = Sweep("cap", raw_dn, SENSOR, rig.camera, rig.rig_from_sample, mount)
    fan = np.array([np.radians(rig.elevation_deg), rig.distance_m, np.radians(azimuth), 0.0])
    bound = rig.time_bound(points, lit) / _angle_slope(points, rig.camera, rig.source, rig.azimuth_deg) ** 2
    return Located(sweep, HOLDER, np.where(lit, displacement, np.nan), bound, fan, rig.fan)


def brick(number: int, seed: int = 1, size: str = "small", camera: str = "cam4") -> Located:
    """The simulated rig's brick, lit from a location that its own mountings' errors displace."""
    azimuth, elevation = np.radians(location(number))
    optics, still, points = _world(seed, size, camera)
    laser, device, unit = optics.layout.laser, optics.layout.cameras[camera], optics.sensor(camera)
    angle = _motion(laser, elevation, (seed, number))
    poses = [_pose(angle, frame, azimuth, elevation) for frame in range(FRAMES)]
    light = np.stack([optics.laser_rate(camera, pose) for pose in poses])
    keys = [(seed, "located", number, frame) for frame in range(FRAMES)]
    raw_dn = np.stack([unit.expose(still + part, EXPOSURE_S, key) for part, key in zip(light, keys, strict=True)])
    sensor = Sensor(256.0, 4095.0, unit.sensor.gain_e_per_dn, unit.sensor.read_noise_e)
    lens = Pinhole(device.matrix, np.array([*device.distortion, 0, 0, 0]))
    model = CameraModel(lens, device.rig_from_camera, (device.height_px, device.width_px))
    mount = LaserMount(azimuth, elevation, laser.distance_m)
    sweep = Sweep("brick", raw_dn, sensor, model, rotation_z(0.0), mount)
    source = laser.source(azimuth, elevation)
    depth = np.einsum("hwi,hwi->hw", points - plane_hits(model, 0.0), model.pixel_rays())
    lit = light.max(axis=0) > 0
    bound = _time_bound(light, still, points, (source, laser.sigma_m, poses), sensor)
    bound /= _angle_slope(points, model, source, np.degrees(azimuth)) ** 2
    true_elevation, distance_m = laser.mounting(elevation)
    fan = np.array([true_elevation, distance_m, azimuth, 0.0])
    return Located(sweep, RIG_HOLDER, np.where(lit, depth, np.nan), bound, fan, angle)


@lru_cache(maxsize=1)
def _world(seed, size, camera):
    """The simulated rig, what the camera sees without the laser, and where (h, w, 3): the same for all locations."""
    dark = Pose("brick", 0, 0.0, 0.0, 0.0, (), 0.0, False, None)
    with tempfile.TemporaryDirectory() as folder:
        optics = Optics(seed, size, Path(folder))
        points = np.load(optics.truth("points", dark, camera=camera)["path"])
    return optics, optics.rate(camera, dark), points


def _motion(laser, elevation, key):
    """The fan's depression angle over time in frames, in the middle of the exposures, of one run of the LEGO motor."""
    motor = LaserMotor(laser.ticks_per_s, (-0.05 * laser.sweep_ticks, 1.15 * laser.sweep_ticks))
    motor.turn(0, 1, 7, key)
    ticks = np.vectorize(lambda time: motor.ticks(round(1e9 * (time * FRAME_S + EXPOSURE_S / 2))), otypes=[float])
    return lambda time: (
        laser.fan_rad(0.0, elevation) + ticks(time) * (laser.fan_rad(1.0, elevation) - laser.fan_rad(0.0, elevation))
    )


def _pose(angle, frame, azimuth, elevation):
    half = EXPOSURE_S / FRAME_S / 2
    start, end = (float(fan) for fan in angle(np.array([frame - half, frame + half])))
    return Pose("brick", 0, 0.0, azimuth, 0.0, (), elevation, True, (start, end))


def _time_bound(light, still, points, laser, sensor):
    """As `Rig.time_bound`, of the simulators' stripe: its height from the light of all frames together."""
    source, sigma_m, poses = laser
    azimuth = poses[0].light_arc_rad
    seen = light.reshape(len(light), -1).sum(axis=0, dtype=np.float64)
    angles = stripe_angles(points.reshape(-1, 3), source, azimuth)
    order = np.argsort(angles)  # so that a frame's stripe is one piece of the list
    order = order[seen[order] > 0]
    angles, points_m = angles[order], points.reshape(-1, 3)[order]
    level = (points_m[:, :2] - source[:2]) @ np.array([np.cos(azimuth), np.sin(azimuth)])
    widths = sigma_m / np.hypot(level, points_m[:, 2] - source[2])
    step, reach = 0.01 * widths.min(), 6 * widths.max()
    parts = []
    total = np.zeros(len(order))
    for pose in poses:
        low, high = sorted(pose.laser_sweep)
        near = slice(*np.searchsorted(angles, (low - reach, high + reach)))
        about = widths[near], pose.laser_sweep
        rise = stripe_profile(angles[near] + step, *about) - stripe_profile(angles[near] - step, *about)
        parts.append((near, rise / (2 * step)))
        total[near] += stripe_profile(angles[near], *about)
    height = seen[order] / total * EXPOSURE_S
    information = np.zeros(len(order))
    for frame, (near, slope) in enumerate(parts):
        mean = (light[frame].ravel()[order[near]] + still.ravel()[order[near]]) * EXPOSURE_S
        v = mean + sensor.read_noise_e**2 + sensor.gain_e_per_dn**2 / 12
        information[near] += (slope * height[near]) ** 2 * (1 / v + 0.5 / v**2)
    bound = np.full(seen.size, np.inf)
    bound[order] = 1.0 / information
    return bound.reshape(points.shape[:2])


def _angle_slope(points, camera, source, azimuth_deg):
    """Change (h, w) of the angle of the plane that holds a point, per metre along its pixel's ray."""
    a = np.radians(azimuth_deg)

    def angle(at):
        return np.arctan2(source[2] - at[..., 2], (source - at) @ np.array([np.cos(a), np.sin(a), 0.0]))

    step = 1e-5 * camera.pixel_rays()
    return (angle(points + step) - angle(points - step)) / 2e-5
