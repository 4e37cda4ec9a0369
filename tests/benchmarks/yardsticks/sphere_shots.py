"""Simulated spheres photographed in brackets under one light after another, merged as a session's frames are."""

import tempfile
from dataclasses import dataclass, replace
from functools import cached_property
from math import radians
from pathlib import Path

import numpy as np

from processing.materials.limb import SphereImage, find_sphere
from processing.materials.photographs import BodyPhotographs
from processing.materials.reflectance_map import reflectance_maps
from processing.materials.sight import CircleSight
from processing.materials.white_card import WhiteCard, card_irradiance
from processing.radiometry.mosaic import demosaic
from processing.radiometry.sensor import Sensor
from processing.radiometry.stack import Exposures, merge_stack
from simulators.layout import direction
from simulators.optics import Optics
from simulators.pose import Pose
from simulators.sensor import Sensor as Model
from simulators.truth import limb_circle

CFA = np.array([[0, 1], [1, 2]], np.uint8)
EXPOSURES_S = (0.1, 0.5)
RADIUS_M = 0.05
BESIDE, BELOW = WhiteCard(0.064, 0.0, 0.011, 0.040, 0.9), WhiteCard(0.0, -0.059, 0.040, 0.011, 0.9)


@dataclass(frozen=True)
class SphereShots:
    """One sphere of one rig before one camera; `lights` are lamps with the angle of the axis that carries each."""

    seed: int
    sample: str
    camera: str
    lights: tuple[tuple[str, float], ...]

    @cached_property
    def optics(self) -> Optics:
        """The simulated rig; what it writes is read at once."""
        return Optics(self.seed, "small", Path(tempfile.mkdtemp(prefix="spheres")))

    @cached_property
    def mosaics(self) -> tuple[np.ndarray, np.ndarray]:
        """Merged radiance and its variance (light, row, column), with all that a camera of the rig does to them."""
        merged = [self._merged(light) for light in self.lights]
        return np.stack([one.value for one in merged]), np.stack([one.variance for one in merged])

    @cached_property
    def found(self) -> SphereImage:
        """The sphere as the pipeline finds it."""
        return find_in(self.mosaics)

    @cached_property
    def circle(self) -> tuple[np.ndarray, float]:
        """Centre and radius of the true circle in pixels."""
        return limb_circle(self.optics.layout.cameras[self.camera], RADIUS_M)

    def maps(self, size, *, orthographic=False):
        """Reflectance maps as the pipeline makes them without calibrations, or with the paper's distant camera."""
        camera = self.optics.layout.cameras[self.camera]
        distance = np.inf if orthographic else camera.distance_m / RADIUS_M
        sight, photographs = CircleSight(self.found, distance), self._photographs()
        card = BELOW if camera.elevation_rad == 0.0 else BESIDE
        return reflectance_maps(photographs, sight, card_irradiance(photographs, sight, card), size)

    def true_maps(self, size):
        """What they ought to be."""
        answer = self.optics.truth(
            "srf", self._pose(), lights=list(self.lights), camera=self.camera, sample=self.sample, size=size
        )
        return np.load(answer["path"])

    def _photographs(self):
        layout = self.optics.layout
        lamps = [layout.lamps[name] for name, _ in self.lights]
        toward = [
            direction(radians(angle), lamp.elevation_rad) for lamp, (_, angle) in zip(lamps, self.lights, strict=True)
        ]
        elevation_rad = layout.cameras[self.camera].elevation_rad
        outward, right = direction(0.0, elevation_rad), np.array([0.0, 1.0, 0.0])
        rig_from_view = np.column_stack([right, np.cross(-outward, right), -outward])
        names = sorted({name for name, _ in self.lights})
        return BodyPhotographs(
            *self.mosaics, CFA, np.stack(toward) @ rig_from_view, np.array([lamp.distance_m for lamp in lamps]),
            RADIUS_M, np.array([names.index(name) for name, _ in self.lights]),
        )  # fmt: skip

    def _pose(self):
        elevation_rad = self.optics.layout.cameras[self.camera].elevation_rad
        return Pose(self.sample, 0, 0.0, radians(45), 0.0, (), 0.0, False, None, elevation_rad)

    def _merged(self, light):
        name, angle_deg = light
        lit = replace(self._pose(), light_arc_rad=radians(angle_deg), arm_rad=radians(angle_deg), lamps=((name, 1.0),))
        rate, unit, model = self.optics.rate(self.camera, lit), self.optics.sensor(self.camera), Model()
        frames = [unit.expose(rate, exposure_s, (self.seed, *light, exposure_s)) for exposure_s in EXPOSURES_S]
        stated = Sensor.from_noise_profile(model.black_dn, model.white_dn, *model.noise_profile())
        return merge_stack(Exposures(frames, EXPOSURES_S, [f"{s} s" for s in EXPOSURES_S], stated)).radiance


def find_in(mosaics: tuple[np.ndarray, np.ndarray]) -> SphereImage:
    """The sphere in merged mosaics and their variances."""
    return find_sphere(np.stack([demosaic(*pair, CFA)[0].mean(axis=-1) for pair in zip(*mosaics, strict=True)]))
