"""Lamps over a mirror ball and a white plate: as numbers with noise, and as frames of the simulated rig."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from processing import geometry
from processing.cameras.calibration import CameraModel
from processing.cameras.lens import Pinhole
from processing.formats.raw import read_raw
from processing.lamps.camera_doubt import reflection_image, sigmas
from processing.lamps.highlight import Highlight, find_highlights
from processing.lamps.mirror import SEAT_SIGMA_M, Ball, Sighting
from processing.lamps.model import DISTANCE_SIGMA, NominalLamp, nominal_position
from processing.lamps.white import CELLS, PlateCells, PlateView
from processing.radiometry.hdr import merge_exposures
from simulators.layout import Layout, build_layout
from simulators.optics import Optics
from simulators.pose import Pose
from simulators.stage import REPEATABILITY_DEG

ARC_DEG, ARM_DEG = (45.0, 135.0, -135.0, -45.0), (-60.0, -20.0, 20.0, 60.0)
CAMERAS = ("cam1", "cam4", "cam7")
BALL = Ball(np.array([0.0, 0.0, 0.020]), 0.020)
PLATE_M = 0.072


@dataclass(frozen=True)
class LampRig:
    """True lamps and what is believed of them; `said` cameras may differ from those that took the pictures."""

    layout: Layout

    @classmethod
    def of(cls, seed):
        return cls(build_layout(seed, "small"))

    @cached_property
    def nominal(self):
        lamps = self.layout.lamps.items()
        return {n: NominalLamp(la.mount, nominal_position(la.elevation_rad, la.distance_m)) for n, la in lamps}

    def believed(self, rng):
        """Nominal lamps and a ball's seat as far off from the truth as is believed beforehand, in direction less."""
        nominal = {}
        for name, lamp in self.nominal.items():
            true = self.position(name)
            across = true + np.linalg.norm(true) * np.radians(1.0) * rng.normal(size=3)
            place = across / np.linalg.norm(across) * np.linalg.norm(true) * (1 + DISTANCE_SIGMA * rng.normal())
            nominal[name] = replace(lamp, position_m=place)
        return nominal, Ball(self.layout.mirror.centre_m + SEAT_SIGMA_M * rng.normal(size=3), BALL.radius_m)

    @cached_property
    def cameras(self):
        return {name: true_camera(self.layout.cameras[name]) for name in CAMERAS}

    def position(self, name):
        """True position while the carrier stands at 0."""
        return self.layout.lamp_position(name, 0.0, 0.0)

    def stands(self):
        """Every lamp with every angle of its carrier, radians."""
        for name, lamp in self.layout.lamps.items():
            for angle_deg in ARM_DEG if lamp.mount == "arm" else ARC_DEG:
                yield name, float(np.radians(angle_deg))

    def sightings(self, rng, noise_px=0.01, turn_sigma_rad=0.0):
        """Highlights with noise, in cameras that differ from the said ones by what their calibration leaves open."""
        doubts = {name: rng.normal(size=7) * sigmas(camera) for name, camera in self.cameras.items()}
        turns = {}
        found = []
        for lamp, angle in self.stands():
            key = (self.layout.lamps[lamp].mount, angle)
            turn = turns.setdefault(key, rng.normal() * turn_sigma_rad)
            source = geometry.rotate(geometry.rotation_z(angle + turn), self.position(lamp))
            for name, camera in self.cameras.items():
                ball = (np.array(self.layout.mirror.centre_m), 0.020)
                uv_px = reflection_image(camera, doubts[name], ball, source[None])[0]
                found.append(Sighting(lamp, name, angle, (spot(uv_px + rng.normal(0, noise_px, 2), noise_px),)))
        return found

    def plate_views(self, rng, noise=0.003, falloff=2.0):
        """Cells of a white plate of reflectance 0.9 with noise, each camera with its own vignetting."""
        centre = ((np.arange(CELLS) + 0.5) / CELLS - 0.5) * PLATE_M
        x, y = (part.ravel() for part in np.meshgrid(centre, centre))
        points = np.repeat(np.column_stack([x, y, np.zeros_like(x)])[:, None], 3, axis=1)
        vignettes = {name: 0.01 * rng.normal(size=(CELLS**2, 3)) for name in CAMERAS}
        views = []
        for lamp, angle in self.stands():
            way = geometry.rotate(geometry.rotation_z(angle), self.position(lamp)) - points
            if way[0, 0, 2] < 0.05:
                continue
            for name in CAMERAS:
                log_value = np.log(0.9 * way[..., 2]) - (falloff + 1) * np.log(np.linalg.norm(way, axis=-1))
                log_value += self.log_intensity(lamp) + vignettes[name] + rng.normal(0, noise, log_value.shape)
                views.append(PlateView(lamp, name, angle, log_value, np.full(log_value.shape, noise**-2), points))
        return views

    def log_intensity(self, name):
        """Electrons per second of a perfect diffuser at 1 m, as the simulators define it."""
        lamp = self.layout.lamps[name]
        return np.log(60000 / 0.9 * lamp.distance_m**2 * np.array([0.6, 1.0, 0.72]) * lamp.gains)


def true_camera(device):
    """The camera model of a simulated camera."""
    lens = Pinhole(device.matrix, np.array([*device.distortion, 0.0, 0.0, 0.0]))
    return CameraModel(lens, device.rig_from_camera, (device.height_px, device.width_px))


def spot(uv_px, noise_px):
    """A highlight with equal noise along both axes."""
    return Highlight(np.asarray(uv_px), noise_px**2 * np.eye(2), 0.6, np.ones(3))


def angle_deg(first, second):
    """Angle between two vectors."""
    cosine = first @ second / np.linalg.norm(first) / np.linalg.norm(second)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


@dataclass(frozen=True)
class Photographer:
    """Frames of the simulated rig, its axes as unsure of their angles as they are."""

    optics: Optics
    cameras: dict
    rng: np.random.Generator

    def mirror(self, rig, exposures_s=(0.001, 0.004), names=None):
        """Sightings of all lamps, or those named."""
        found = []
        for lamp, angle, stand in self._stands(rig, names):
            for name, camera in self.cameras.items():
                merged, cfa = self._merged(name, replace(stand, sample="mirror"), exposures_s)
                source = geometry.rotate(geometry.rotation_z(angle), rig.nominal[lamp].position_m)
                near_px = reflection_image(camera, np.zeros(7), (BALL.seat_m, BALL.radius_m), source[None])[0]
                found.append(Sighting(lamp, name, angle, find_highlights(merged, cfa, near_px, 20.0)))
        return found

    def white(self, rig, exposures_s=(0.03,), names=None):
        """Views of the white plate under all lamps above it, or those named."""
        views, cells = [], {}
        for lamp, angle, stand in self._stands(rig, names):
            if rig.nominal[lamp].position_m[2] <= 0:
                continue
            for name, camera in self.cameras.items():
                merged, cfa = self._merged(name, replace(stand, sample="white"), exposures_s)
                if name not in cells:
                    cells[name] = PlateCells.of(camera, cfa, PLATE_M)
                views.append(cells[name].view(merged, lamp, name, angle))
        return views

    def _stands(self, rig, names):
        stood = {}
        for lamp, angle in rig.stands():
            if names is not None and lamp not in names:
                continue
            mount = rig.layout.lamps[lamp].mount
            off = stood.setdefault((mount, angle), np.radians(self.rng.uniform(-1, 1) * REPEATABILITY_DEG))
            arc, arm = (0.5, angle + off) if mount == "arm" else (angle + off, 0.0)
            yield lamp, angle, Pose("none", 0, 0.0, arc, arm, ((lamp, 1.0),), 0.6, False, None)

    def _merged(self, name, pose, exposures_s):
        key = (pose.sample, str(pose.lamps), str(pose.light_arc_rad), str(pose.arm_rad))
        frames = [
            read_raw(self.optics.photograph(name, pose, t, serial=name, frame_key=(*key, str(t)), time_s=0.0))
            for t in exposures_s
        ]
        merged = merge_exposures(np.stack([f.mosaic for f in frames]), [f.exposure_s for f in frames], frames[0].sensor)
        return merged, frames[0].cfa
