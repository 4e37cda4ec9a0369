"""What the cameras photograph: noise-free electron rates per pose, exposed by the sensor, written as raw files.

What a camera sees of a pose, the shadows of each lamp and of the laser are computed once, kept for a while, and serve
every exposure and every laser frame.
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from simulators.chance import Key
from simulators.dng import RawFile, encode_dng
from simulators.glint import Spots, add_spots, glint
from simulators.layout import PHONE, Array, CameraLayout, Layout
from simulators.lens import rays, sample_points, vignette
from simulators.light import (
    AMBIENT,
    CHANNELS,
    ELECTRONS_PER_RADIANCE,
    LASER_CHANNELS,
    LASER_PEAK,
    SRGB_FROM_XYZ,
    gather,
    radiance,
    stripe_angles,
    stripe_profile,
    through_filters,
)
from simulators.phone import FrameLabel, Phone, build_phone
from simulators.pose import Pose
from simulators.recent import Recent
from simulators.scene import Floats, Hits
from simulators.sensor import Sensor, Unit
from simulators.speckle import STILL_SPECKLE, Speckle
from simulators.studio import CAP, LIGHTBOX, Studio
from simulators.truth import Argument, Truth

SAMPLES = {"small": (2, 4), "full": (1, 2)}  # rays per pixel along each axis; the second for the printed board's edges
BLUR_PX = 0.5  # standard deviation of the lens and the sensor's low-pass filter; the laser is taken as sharp
VIEW_BYTES, MOSAIC_BYTES = 256 << 20, 64 << 20
ISO, F_NUMBER, PIXEL_PITCH_M = 100, 8.0, 6e-6
LIGHTBOX_RADIANCE = 0.9 / np.pi  # as white that faces a lamp


@dataclass(frozen=True)
class View:
    """What a camera sees: hits of `per_pixel` rays per pixel, and the eye (3,) in the rig frame."""

    hits: Hits
    per_pixel: int
    eye_m: Array


@dataclass(frozen=True)
class Stripe:
    """The laser's light on the pixels that it can reach.

    `pixel` (n,) counts along rows; `angles` and `widths` (n,) are the fan angle that lights the pixel and the stripe's
    standard deviation there, `rate_e_s` (n,) is the pixel's rate in the middle of the stripe, `phases` (n, m) are its
    moving speckle's.
    """

    pixel: NDArray[np.int64]
    angles: Array
    widths: Array
    rate_e_s: Array
    phases: Floats

    @property
    def nbytes(self) -> int:
        """Memory that the arrays take."""
        arrays = (self.pixel, self.angles, self.widths, self.rate_e_s, self.phases)
        return sum(array.nbytes for array in arrays)


class Optics:
    """Light, scenes and cameras of one rig. Not for use by several threads at once."""

    def __init__(self, seed: int, size: str, truth_dir: Path, speckle: Speckle = STILL_SPECKLE) -> None:
        self._studio = Studio(seed, size)
        self._speckle = speckle
        self._views: Recent[View] = Recent(VIEW_BYTES, lambda view: view.hits.nbytes)
        self._mosaics: Recent[Floats] = Recent(MOSAIC_BYTES, lambda mosaic: mosaic.nbytes)
        self._stripes: Recent[Stripe] = Recent(VIEW_BYTES, lambda stripe: stripe.nbytes)
        self._responses: dict[str, Floats] = {}
        self.phone = Phone(build_phone(seed, size), seed)
        self._truth = Truth(truth_dir, self._studio, self.rate, self.phone)

    @property
    def layout(self) -> Layout:
        """Where everything stands."""
        return self._studio.layout

    def sensor(self, camera: str) -> Unit:
        """The camera's own sensor."""
        return self._studio.sensor(camera)

    def serial(self, camera: str) -> str:
        """What is engraved on a camera."""
        return self.phone.layout.serial if camera == PHONE else self.layout.cameras[camera].serial

    def photograph(
        self, camera: str, pose: Pose, exposure_s: float, *, serial: str, frame_key: Key, time_s: float
    ) -> bytes:
        """The DNG file of one exposure; its noise depends on the seed, `serial` and `frame_key` alone.

        `time_s` is the simulated time, for the file's date. Appends a line to the truth's frames.jsonl.
        """
        key = (self._studio.seed, serial, *frame_key)
        label = self._label(key, camera, pose, exposure_s, time_s)
        if camera == PHONE:
            return self.phone.dng(self.phone.radiance(pose.place, pose.facing), exposure_s, key, label)
        rate = self.rate(camera, pose) + self.laser_rate(camera, pose)
        counts = self.sensor(camera).expose(rate, exposure_s, key)
        return encode_dng(counts, self._raw_file(camera, exposure_s, label))

    def photograph_jpeg(
        self, camera: str, pose: Pose, exposure_s: float, *, serial: str, frame_key: Key, time_s: float
    ) -> bytes:
        """As `photograph`, of the phone as JPEG; any other camera delivers what it has."""
        if camera != PHONE:
            return self.photograph(camera, pose, exposure_s, serial=serial, frame_key=frame_key, time_s=time_s)
        key = (self._studio.seed, serial, "jpeg", *frame_key)
        label = self._label(key, camera, pose, exposure_s, time_s)
        return self.phone.jpeg(self.phone.radiance(pose.place, pose.facing), exposure_s, key, label)

    def _label(self, key: Key, camera: str, pose: Pose, exposure_s: float, time_s: float) -> FrameLabel:
        unique_id = hashlib.blake2b(repr((key, exposure_s)).encode(), digest_size=16).hexdigest()
        self._truth.note_frame(unique_id, camera, pose, exposure_s=exposure_s, time_s=time_s)
        return FrameLabel(str(key[1]), time_s, unique_id)

    def truth(self, what: str, pose: Pose, **arguments: Argument) -> dict[str, Any]:
        """Write one kind of truth of a pose into the truth folder and say where; see `simulators.truth.Truth`."""
        return self._truth.tell(what, pose, **arguments)

    def rate(self, camera: str, pose: Pose) -> Floats:
        """Noise-free mosaic (h, w) in electrons per second, all but the laser: dark current, stray light, lamps.

        As this camera's pixels count: vignetting and each pixel's own response are inside.
        """
        if pose.sample in (CAP, LIGHTBOX):
            return self._covered_rate(camera, lit=pose.sample == LIGHTBOX)
        rate = self._dark_rate(camera, pose)
        for name, level in pose.lamps:
            rate = rate + np.float32(level) * self._lamp_rate(camera, pose, name)
        return rate

    def laser_rate(self, camera: str, pose: Pose) -> Floats:
        """The laser's part of the mosaic (h, w), electrons per second, mean over the exposure's sweep."""
        device = self.layout.cameras[camera]
        rate = np.zeros(device.height_px * device.width_px, np.float32)
        if pose.laser_on and pose.laser_sweep is not None and pose.sample not in (CAP, LIGHTBOX):
            stripe = self._stripe(camera, pose)
            low, high = sorted(pose.laser_sweep)
            margin = 6 * stripe.widths
            near = (stripe.angles > low - margin) & (stripe.angles < high + margin)
            profile = stripe_profile(stripe.angles[near], stripe.widths[near], pose.laser_sweep)
            speckle = self._speckle.passing(stripe.phases[near], stripe.widths[near], pose.laser_sweep)
            rate[stripe.pixel[near]] = stripe.rate_e_s[near] * profile * speckle
        return rate.reshape(device.height_px, device.width_px)

    def _covered_rate(self, camera: str, *, lit: bool) -> Floats:
        """What a capped lens, or one before the light box, leaves (h, w)."""

        def make() -> Floats:
            field = np.full((*self._shape(camera), 3), LIGHTBOX_RADIANCE if lit else 0.0, np.float32)
            return self.sensor(camera).dark_e_s + self._filtered(camera, field)

        return self._mosaics.get((camera, LIGHTBOX if lit else CAP), make)

    def _dark_rate(self, camera: str, pose: Pose) -> Floats:
        """Dark current and the stray light of the room (h, w)."""

        def make() -> Floats:
            view = self._view(camera, pose)
            dark = self.sensor(camera).dark_e_s
            return dark + self._mosaic(camera, view, view.hits.material.diffuse * np.float32(AMBIENT / np.pi))

        return self._mosaics.get((*self._view_key(camera, pose), "dark"), make)

    def _lamp_rate(self, camera: str, pose: Pose, name: str) -> Floats:
        """The mosaic (h, w) that this lamp alone gives at full level."""
        lamp = self._studio.lamp(pose, name)

        def make() -> Floats:
            view = self._view(camera, pose)
            light = self._studio.lamp_radiance(pose, view.hits, lamp, view.eye_m)
            return self._mosaic(camera, view, light, self._glint(camera, pose, name))

        place = tuple(np.round(lamp.position_m, 9).tolist())
        return self._mosaics.get((*self._view_key(camera, pose), name, place), make)

    def _glint(self, camera: str, pose: Pose, name: str) -> Spots | None:
        """The lamp's image in the mirror, None where there is no mirror."""
        if pose.sample != "mirror":
            return None
        device, lamp = self.layout.cameras[camera], self._studio.lamp(pose, name)
        light = self._studio.to_scene(pose, lamp.position_m)
        disc = (light, self.layout.lamps[name].radius_m, lamp.strength * lamp.reach_m**2)
        return glint(self.layout.mirror, disc, device, self._studio.rig_from_scene(pose))

    def _mosaic(self, camera: str, view: View, light: Floats, spots: Spots | None = None) -> Floats:
        """Electron rates (h, w) of the hits' radiance (n, 3), and of what is smaller than a pixel."""
        image = np.zeros((*self._shape(camera), 3), np.float32)
        gather(light, view.hits.ray, view.per_pixel, image)
        image = np.asarray(cv2.GaussianBlur(image, (5, 5), BLUR_PX), np.float32)
        if spots is not None:
            add_spots(image, spots, BLUR_PX)
        return self._filtered(camera, image)

    def _filtered(self, camera: str, image: Floats) -> Floats:
        """Electron rates (h, w) of an image's radiance (h, w, 3) behind lens and filters."""
        mosaic = np.empty(image.shape[:2], np.float32)
        through_filters(image, CHANNELS * ELECTRONS_PER_RADIANCE, mosaic)
        return mosaic * self._response(camera)

    def _stripe(self, camera: str, pose: Pose) -> Stripe:
        source = self.layout.laser.source(pose.light_arc_rad, pose.laser_elevation_rad)
        key = (*self._view_key(camera, pose), "laser", tuple(np.round(source, 9).tolist()))
        return self._stripes.get(key, lambda: self._light_stripe(camera, pose, source, key))

    def _light_stripe(self, camera: str, pose: Pose, source: Array, key: tuple[object, ...]) -> Stripe:
        """The stripe through the pixels' centres: where it can fall, and how bright it is there."""
        view, laser = self._view(camera, pose, samples=1), self.layout.laser
        visible = self._studio.lit(pose, view.hits, source)
        origin, eye = self._studio.to_scene(pose, source), self._studio.to_scene(pose, view.eye_m)
        red = radiance(view.hits, visible, origin, eye, laser.distance_m)[:, 0] * np.float32(LASER_PEAK)
        points = self._studio.to_rig(pose, view.hits.points)
        # The light spreads along the stripe alone, whose width stays: it falls off as 1 / distance, not as its square.
        red *= np.linalg.norm(points - source, axis=1) / laser.distance_m
        pixel = view.hits.ray
        row, col = np.divmod(pixel, self.layout.cameras[camera].width_px)
        gains = (ELECTRONS_PER_RADIANCE * LASER_CHANNELS)[row % 2 + col % 2] * self._response(camera).ravel()[pixel]
        chance: Key = (self._studio.seed, *map(str, key))
        rate = red * gains * self._speckle.fixed(len(pixel), chance)
        across = np.hypot((points[:, :2] - source[:2]) @ _azimuth(pose.light_arc_rad), points[:, 2] - source[2])
        angles = stripe_angles(points, source, pose.light_arc_rad)
        seen = red > 0
        phases = self._speckle.phases(len(pixel), chance)
        return Stripe(pixel[seen], angles[seen], (laser.sigma_m / across)[seen], rate[seen], phases[seen])

    def _view(self, camera: str, pose: Pose, samples: int | None = None) -> View:
        device = self.layout.cameras[camera]
        if samples is None:
            samples = SAMPLES[self.layout.size][pose.sample == "charuco"]
        key = (*self._view_key(camera, pose), samples)
        return self._views.get(key, lambda: self._look(device, pose, samples))

    def _look(self, device: CameraLayout, pose: Pose, samples: int) -> View:
        eye_m = device.rig_from_camera[:3, 3]
        hits = self._studio.trace(pose, eye_m, rays(device, sample_points(device, samples)))
        return View(hits, samples**2, eye_m)

    def _view_key(self, camera: str, pose: Pose) -> tuple[object, ...]:
        place = tuple(np.round(self._studio.rig_from_scene(pose), 9).ravel().tolist())
        return camera, pose.sample, pose.card_elevation_rad, place

    def _response(self, camera: str) -> Floats:
        """Share of the light (h, w) that each pixel counts: the lens's vignetting times the pixel's own response."""
        if camera not in self._responses:
            shares = vignette(self.layout.cameras[camera]) * self.sensor(camera).response
            self._responses[camera] = shares.astype(np.float32)
        return self._responses[camera]

    def _shape(self, camera: str) -> tuple[int, int]:
        device = self.layout.cameras[camera]
        return device.height_px, device.width_px

    def _raw_file(self, camera: str, exposure_s: float, label: FrameLabel) -> RawFile:
        device = self.layout.cameras[camera]
        neutral = (float(CHANNELS[0]), float(CHANNELS[1]), float(CHANNELS[2]))
        model = Sensor()  # a file states the model's noise, not the unit's
        return RawFile(
            serial=label.serial,
            model=device.model,
            black_dn=model.black_dn,
            white_dn=model.white_dn,
            noise_profile=model.noise_profile(),
            color_matrix=CHANNELS[:, None] * SRGB_FROM_XYZ,
            neutral=neutral,
            exposure_s=exposure_s,
            iso=ISO,
            f_number=F_NUMBER,
            focal_length_mm=float(device.matrix[0, 0]) * PIXEL_PITCH_M * 1e3,
            time_s=label.time_s,
            unique_id=label.unique_id,
        )


def _azimuth(azimuth_rad: float) -> Array:
    return np.array([np.cos(azimuth_rad), np.sin(azimuth_rad)])
