"""A small forward model of a laser sweep over a height field in the holder, for tests: rays marched, nothing clever.

Frames of reference and names as in CONVENTIONS.md. It shares the camera's projection with processing, nothing else:
surfaces are marched, planes are written down from the source and the angle.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numba import njit

from processing.cameras.calibration import CameraModel
from processing.cameras.lens import Pinhole
from processing.geometry import look_at, rotation_z
from processing.laser.holder import Holder
from processing.laser.laser_plane import LaserMount
from processing.radiometry.sensor import Sensor

HOLDER = Holder(sample_m=0.060, inner_m=0.076, outer_m=0.100, step_m=0.008, depth_m=0.004)
SENSOR = Sensor(256.0, 4095.0, 4.0, 4.0)


def camera_at(elevation_deg: float, scale: float = 1.0) -> CameraModel:
    """A camera of 160 x 128 pixels times `scale`, 1 m from the origin at azimuth 0."""
    e = np.radians(elevation_deg)
    matrix = np.array([[1000.0 * scale, 0, 79.5 * scale], [0, 1000.0 * scale, 63.5 * scale], [0, 0, 1]])
    pose = look_at((np.cos(e), 0.0, np.sin(e)), (0.0, 0.0, 0.0))
    return CameraModel(Pinhole(matrix, np.array([-0.1, 0.02, 0, 0, 0])), pose, (int(128 * scale), int(160 * scale)))


def flat(depth_m: float) -> Callable:
    return lambda x, y: np.full(np.shape(x), -depth_m)


def step(x, y):
    """1 mm deep for x < 0, 3 mm for x > 0: its wall faces a camera at azimuth 0."""
    return np.where(x < 0, -0.001, -0.003)


def bump(x, y):
    """A cap of a sphere of 40 mm radius whose top is 0.5 mm under the reference plane, on a floor 3.5 mm deep."""
    return np.maximum(-0.0405 + np.sqrt(np.maximum(0.040**2 - x**2 - y**2, 0.0)), -0.0035)


@dataclass(frozen=True)
class Rig:
    """One sweep: the true laser, the surface, the albedo."""

    camera: CameraModel
    surface: Callable
    turntable_deg: float = 0.0
    azimuth_deg: float = 40.0
    elevation_deg: float = 45.3
    distance_m: float = 0.803
    sigma_m: float = 0.0008
    frames: int = 96
    frame_m: float = 0.00113  # the trace's mean advance per frame
    peak_e: float = 9000.0
    reverse: bool = False
    unevenness: float = 0.03
    albedo: Callable = field(default=lambda x, y: np.full(np.shape(x), 0.5))

    @property
    def mount(self) -> LaserMount:
        """What the operator believes."""
        return LaserMount(np.radians(self.azimuth_deg), np.radians(45.0), 0.8)

    @property
    def rig_from_sample(self) -> np.ndarray:
        return rotation_z(np.radians(self.turntable_deg))

    @property
    def source(self) -> np.ndarray:
        a, e = np.radians(self.azimuth_deg), np.radians(self.elevation_deg)
        return self.distance_m * np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])

    def fan(self, time):
        """Depression angle of the plane at a time in frames: a slow drift and a ripple on an even motion."""
        middle = 0.5 * (self.frames - 1)
        t = np.asarray(time, float) - middle
        t = t + self.unevenness * (9.0 / (2 * np.pi) * np.sin(2 * np.pi * t / 9.0 + 1.0) + 0.3 * t * t / (middle + 1))
        e = np.radians(self.elevation_deg)
        trace = self.frame_m * t * (-1 if self.reverse else 1)
        return np.arctan2(self.distance_m * np.sin(e), self.distance_m * np.cos(e) - trace)

    def height(self, x, y):
        """Sample and holder in the sample frame; -inf beside them."""
        r = np.maximum(np.abs(x), np.abs(y))
        inside = np.clip(x, -0.03, 0.03), np.clip(y, -0.03, 0.03)
        return np.where(
            r < HOLDER.sample_m / 2,
            self.surface(*inside),
            np.where(r < HOLDER.inner_m / 2, 0.0, np.where(r < HOLDER.outer_m / 2, -HOLDER.step_m, -np.inf)),
        )

    def local(self, points):
        return points @ self.rig_from_sample[:3, :3]

    def hits(self) -> tuple[np.ndarray, np.ndarray]:
        """First hits (h, w, 3) of the pixel rays, rig frame, and the displacement (h, w); NaN where none."""
        rays = self.camera.pixel_rays()
        start = self.camera.centre_m + rays * ((0.0002 - self.camera.centre_m[2]) / rays[..., 2:])
        length = 0.0092 / -rays[..., 2]
        low, high = self._bracket(start, rays, length)
        for _ in range(30):
            middle = 0.5 * (low + high)
            above = self._above(start + middle[..., None] * rays)
            low, high = np.where(above, middle, low), np.where(above, high, middle)
        points = start + high[..., None] * rays
        points[~np.isfinite(high)] = np.nan
        reference = self.camera.centre_m + rays * (-self.camera.centre_m[2] / rays[..., 2:])
        return points, np.einsum("hwi,hwi->hw", points - reference, rays)

    def _bracket(self, start, rays, length):
        low, high = np.zeros(length.shape), np.full(length.shape, np.nan)
        for share in np.linspace(0, 1, 140)[1:]:
            below = np.isnan(high) & ~self._above(start + (share * length)[..., None] * rays)
            high[below] = (share * length)[below]
            low = np.where(np.isnan(high), share * length, low)
        return low, high

    def _above(self, points):
        x, y, z = np.moveaxis(self.local(points), -1, 0)
        return z > self.height(x, y)

    def lit(self, points) -> np.ndarray:
        """Whether nothing stands between each point and the laser."""
        towards = self.source - points
        free = np.isfinite(points[..., 0])
        for rise in np.linspace(0, 0.0085, 60)[1:]:
            free &= self._above(np.nan_to_num(points) + np.nan_to_num(towards / towards[..., 2:]) * rise + [0, 0, 2e-5])
        return free

    def electrons(self, points, lit) -> np.ndarray:
        """Stripe light (t, h, w) in electrons, integrated over an exposure of 0.3 frames."""
        return self._light(points, lit)[0]

    def time_bound(self, points, lit, background_e=30.0) -> np.ndarray:
        """Smallest variance (h, w) in rad^2 with which frames can tell the angle of the plane that holds each point.

        The Cramer-Rao bound for Gaussian noise of variance v = signal + background + read noise + rounding, whose mean
        and variance both depend on the signal s: 1 / sum over frames of (ds/dangle)^2 (1/v + 1/(2 v^2)), with the true
        height, width, background and motion known. Infinite where no light falls.
        """
        signal, slope = self._light(points, lit)
        v = signal + background_e + SENSOR.read_noise_e**2 + SENSOR.gain_e_per_dn**2 / 12
        information = (slope**2 * (1 / v + 0.5 / v**2)).sum(axis=0)
        with np.errstate(divide="ignore"):
            return 1.0 / information

    def _light(self, points, lit):
        """Electrons (t, h, w) and their derivative by the points' angle seen from the laser."""
        x, y, _ = np.moveaxis(self.local(points), -1, 0)
        holder = np.maximum(np.abs(x), np.abs(y)) > HOLDER.sample_m / 2
        strength = np.where(holder, 0.9, self.albedo(x, y)) / 0.9 * self.peak_e * np.where(lit, 1.0, 0.0)
        rows, columns = np.indices(strength.shape, sparse=True)
        strength = strength * np.array([[1.0, 0.12], [0.12, 0.03]])[rows % 2, columns % 2]
        angle, reach = self.polar(points)
        moments = self.fan(np.arange(self.frames)[:, None] + np.array([-0.1, 0.0, 0.1]))
        signal, slope = np.zeros((2, self.frames, strength.size))
        _stripe((angle.ravel(), reach.ravel(), strength.ravel()), moments, self.sigma_m, signal, slope)
        shape = (self.frames, *strength.shape)
        return signal.reshape(shape), slope.reshape(shape)

    def polar(self, points) -> tuple[np.ndarray, np.ndarray]:
        """Depression angle and distance of points (..., 3), seen from the laser's level axis."""
        a = np.radians(self.azimuth_deg)
        level = (self.source - points) @ np.array([np.cos(a), np.sin(a), 0.0])
        down = self.source[2] - points[..., 2]
        return np.arctan2(down, level), np.hypot(down, level)


class StoppingRig(Rig):
    """The motor stands still for twelve frames in the middle."""

    def fan(self, time):
        time = np.asarray(time, float)
        return super().fan(np.where(time < 40.0, time, np.maximum(time - 12.0, 40.0)) * 96 / 84)


@njit(cache=True)
def _stripe(pixels, moments, sigma, signal, slope):
    """Mean over each frame's moments of strength exp(-d^2 / (2 sigma^2)), d the distance from the plane."""
    angle, reach, strength = pixels
    for frame in range(moments.shape[0]):
        for p in range(angle.size):
            for fan in moments[frame]:
                off = reach[p] * (angle[p] - fan) / sigma
                if abs(off) < 7.0:
                    light = strength[p] / moments.shape[1] * np.exp(-0.5 * off * off)
                    signal[frame, p] += light
                    slope[frame, p] -= light * off * reach[p] / sigma


def expose(electrons: np.ndarray, rng: np.random.Generator, background_e: float = 30.0) -> np.ndarray:
    """Frames in raw_dn of the test sensor."""
    noisy = rng.poisson(electrons + background_e) + rng.normal(0, SENSOR.read_noise_e, electrons.shape)
    return np.clip(np.rint(noisy / SENSOR.gain_e_per_dn + SENSOR.black_dn), 0, 4095).astype(np.uint16)


def shoot(rig: Rig, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Frames (t, h, w) and the true displacement (h, w), NaN where the laser does not reach."""
    points, displacement = rig.hits()
    lit = rig.lit(points)
    frames = expose(rig.electrons(points, lit), np.random.default_rng(seed))
    return frames, np.where(lit, displacement, np.nan)
