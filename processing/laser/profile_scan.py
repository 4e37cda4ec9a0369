"""Range of an object that moves before a camera and a laser plane that stand: turntable and stage scanners.

The stripe's middle is found in space, frame by frame. Space-time analysis would be free of its error at edges of
albedo here too, but along the path on which a surface point crosses the laser, which depends on the range that is
sought, and with steps well under the stripe's width (Curless and Levoy 1995, section 4); turntables step by several.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.errors import ImageError
from processing.laser.motion import Motion
from processing.laser.plane_fit import Plane
from processing.laser.ridge import Ridge, stripe_ridge, stripe_sigma
from processing.laser.stripe import LaserColour, laser_light
from processing.robust import bulk_deviation

Array = NDArray[np.float64]
Picture = NDArray[Any]
Track = Callable[[Iterable[int]], Iterable[int]]
_PROBES = 7  # frames that tell the stripe's width and the noise
_CERTAIN = 8.0  # deviations of noise by which a ridge exceeds it: none of a million pixels does by chance
_FAINT = 0.08  # of the usual stripe: weaker ridges are the object's own pattern
_RIVAL = 0.5  # of the stripe: a second one as strong is a reflection, or the first one is
_GRAZING = 0.05  # cosine between ray and laser plane under which the cut means nothing
_BESIDE = 5.0  # sigmas from the stripe's middle to where the laser no longer colours the object
_NEAR = 3.0  # usual distances between neighbours from which on a point is alone


class ScanStatus(IntEnum):
    """Outcome on one scan line of one frame; only MEASURED carries a point."""

    MEASURED = 0
    NO_STRIPE = 1  # nothing that rises out of the noise and reaches a twelfth of the usual stripe
    TWO_STRIPES = 2  # another ridge is half as strong: a reflection
    OUT_OF_RANGE = 3  # the ray misses or grazes the laser plane, or the point lies outside of the stated range
    ISOLATED = 4  # no neighbours nearby: a glint or speckle


@dataclass(frozen=True)
class ScanSetup:
    """What stands still, and how the object moves: camera, laser plane and motion, in the camera's frame, metres.

    `near_m` and `far_m` bound the depth along the optical axis, `radius_m` the distance from a turntable's axis.
    `sigma_px` is that of the stripe's profile and `threshold` the least strength of its ridge, in pixel values; None
    lets the pictures tell.
    """

    matrix: Array
    distortion: Array
    plane: Plane
    motion: Motion
    colour: LaserColour = LaserColour.RED
    near_m: float = 0.0
    far_m: float = np.inf
    radius_m: float = np.inf
    sigma_px: float | None = None
    threshold: float | None = None

    @property
    def upright(self) -> bool:
        """Whether the stripe runs more along columns than along rows, so that rows are its scan lines."""
        return bool(abs(self.plane.normal[0]) >= abs(self.plane.normal[1]))


@dataclass(frozen=True)
class Stripe:
    """How the stripe looks in a sequence: sigma of its profile in pixels, least strength, noise of a pixel's value."""

    sigma_px: float
    threshold: float
    noise: float


@dataclass(frozen=True)
class Scan:
    """What a sequence of t frames with n scan lines measured, in the object's frame, metres.

    `points_m` (t, n, 3) are NaN and `deviation_m` (t, n), one sigma from the noise of the pictures, too where `status`
    (t, n) uint8 is not MEASURED. `uv_px` (t, n, 2) are the stripe's places, `colour` (t, n, 3) uint8 what the frame
    shows beside the stripe there.
    """

    points_m: Array
    deviation_m: Array
    uv_px: Array
    colour: NDArray[np.uint8]
    status: NDArray[np.uint8]
    stripe: Stripe

    def count(self, status: ScanStatus) -> int:
        """Scan lines of all frames with this outcome."""
        return int(np.count_nonzero(self.status == status))


def scan_profiles(
    frames: Sequence[Picture],
    setup: ScanSetup,
    backgrounds: Sequence[Picture] = (),
    track: Track = lambda items: items,
) -> Scan:
    """Points of every frame's stripe, put together in the object's frame.

    `backgrounds` are pictures without the laser, one for all frames or one for each. `track` passes the frames'
    numbers on as they are taken, for a progress bar. Frames without a stripe measure nothing; that is no error.
    Raises ImageError where frames differ in size or kind, or no frame shows a stripe.
    """
    sequence = _Sequence(frames, backgrounds, setup)
    stripe = _look_of_stripe(sequence, setup)
    lines = sequence.light(0).shape[0]
    scan = Scan(
        np.full((len(frames), lines, 3), np.nan), np.full((len(frames), lines), np.nan),
        np.full((len(frames), lines, 2), np.nan), np.zeros((len(frames), lines, 3), np.uint8),
        np.full((len(frames), lines), ScanStatus.NO_STRIPE, np.uint8), stripe,
    )  # fmt: skip
    for number in track(range(len(frames))):
        _take_frame(scan, number, sequence, setup)
    _drop_isolated(scan)
    return scan


class _Sequence:
    """Frames and backgrounds, scan lines along rows."""

    def __init__(self, frames: Sequence[Picture], backgrounds: Sequence[Picture], setup: ScanSetup) -> None:
        if len(frames) == 0:
            raise ImageError("the sequence has no frames.")
        if len(backgrounds) not in (0, 1, len(frames)):
            raise ImageError(
                f"{len(backgrounds)} pictures without the laser for {len(frames)} frames; one for all, or one for each."
            )
        self._frames, self._backgrounds, self._setup = frames, backgrounds, setup
        self._first = frames[0]
        self.white = self._white()
        self._steady = self._light(backgrounds[0], "the picture without laser") if len(backgrounds) == 1 else None

    def __len__(self) -> int:
        return len(self._frames)

    def _white(self) -> float:
        """Full scale: of 16-bit files the next full number of bits over what they hold, since many hold 10 or 12."""
        if self._first.dtype == np.uint8:
            return 255.0
        highest = max(float(self._frames[k].max()) for k in (0, len(self._frames) // 2, len(self._frames) - 1))
        return float(2.0 ** np.ceil(np.log2(highest + 1.0)) - 1.0) if highest > 0 else 1.0

    def picture(self, number: int) -> Picture:
        """A frame, its scan lines along rows."""
        return self._along_rows(self._same(self._frames[number], f"frame {number}"))

    def light(self, number: int) -> Array:
        """The laser's light in a frame, less that of the background."""
        light = self._light(self._frames[number], f"frame {number}")
        if self._steady is not None:
            return light - self._steady
        if self._backgrounds:
            return light - self._light(self._backgrounds[number], f"picture without laser {number}")
        return light

    def _light(self, picture: Picture, name: str) -> Array:
        return self._along_rows(laser_light(self._same(picture, name), self._setup.colour))

    def _along_rows(self, image: Picture) -> Picture:
        return image if self._setup.upright else image.swapaxes(0, 1)

    def _same(self, picture: Picture, name: str) -> Picture:
        if (picture.shape, picture.dtype) != (self._first.shape, self._first.dtype):
            raise ImageError(
                f"{name} is {picture.shape} {picture.dtype}, the first frame {self._first.shape} {self._first.dtype}; "
                "a sequence is of one size, depth and kind."
            )
        return picture


def _look_of_stripe(sequence: _Sequence, setup: ScanSetup) -> Stripe:
    """Width, strength and noise of the stripe, of frames over the whole sequence."""
    numbers = np.unique(np.linspace(0, len(sequence) - 1, _PROBES).round().astype(int))
    lights = [sequence.light(int(number)) for number in numbers]
    noise = float(np.median([_noise(light) for light in lights]))
    strongest = [float(stripe_ridge(light, 2.0, 0.0).strength.max(initial=0.0)) for light in lights]
    bright = [light for light, one in zip(lights, strongest, strict=True) if one > 0.3 * max(strongest)]
    sigma_px = setup.sigma_px or float(np.median([stripe_sigma(light) for light in bright] or [np.nan]))
    usual = _usual_strength(bright, sigma_px) if bright else 0.0
    # White noise gives a second derivative of deviation noise sqrt(3 / (16 pi)) / sigma^3.
    certain = _CERTAIN * noise * np.sqrt(3.0 / (16.0 * np.pi)) / sigma_px
    if not usual > certain:
        raise ImageError("no stripe in the frames: is the laser's colour right, and is it brighter than the room?")
    threshold = max(certain, _FAINT * usual) if setup.threshold is None else setup.threshold
    return Stripe(sigma_px, threshold, noise)


def _usual_strength(lights: Sequence[Array], sigma_px: float) -> float:
    """Median over frames of what a tenth of the scan lines with the strongest ridges exceeds."""
    strengths = [stripe_ridge(light, sigma_px, 0.0).strength for light in lights]
    strong = [float(np.percentile(strength, 90)) for strength in strengths if strength.size]
    return float(np.median(strong)) if strong else 0.0


def _noise(light: Array) -> float:
    """Deviation of a pixel's noise, of differences along the scan lines, never under that of rounding."""
    return max(bulk_deviation(np.diff(light[::3], axis=1)) / float(np.sqrt(2.0)), float(np.sqrt(1.0 / 12.0)))


def _take_frame(scan: Scan, number: int, sequence: _Sequence, setup: ScanSetup) -> None:
    """Fill one frame of the scan."""
    ridge = stripe_ridge(sequence.light(number), scan.stripe.sigma_px, scan.stripe.threshold)
    lines = ridge.lines
    uv_px = ridge.uv_px if setup.upright else ridge.uv_px[:, ::-1]
    rays = geometry.pixel_rays(uv_px, setup.matrix, setup.distortion, np.eye(4))
    in_camera = setup.plane.cut(rays)
    points = geometry.transform_points(geometry.invert(setup.motion.camera_from_object(number)), in_camera)
    slant = np.abs(rays @ setup.plane.normal)
    good = _in_range(in_camera, points, slant, setup)
    status = np.where(good, ScanStatus.MEASURED, ScanStatus.OUT_OF_RANGE)
    status[good & (ridge.rival > _RIVAL * ridge.strength)] = ScanStatus.TWO_STRIPES
    scan.status[number, lines] = status
    kept = status == ScanStatus.MEASURED
    lines = lines[kept]
    scan.points_m[number, lines], scan.uv_px[number, lines] = points[kept], uv_px[kept]
    # A step across the stripe by one pixel moves the point within the plane by distance / (focal length slant).
    distance_m = np.linalg.norm(in_camera[kept], axis=1)
    focal_px = np.sqrt(setup.matrix[0, 0] * setup.matrix[1, 1])
    scan.deviation_m[number, lines] = (
        ridge.deviation_px(scan.stripe.noise)[kept] * distance_m / (focal_px * slant[kept])
    )
    beside = _beside(sequence.picture(number), ridge, kept, scan.stripe.sigma_px)
    scan.colour[number, lines] = np.clip(np.rint(beside * (255.0 / sequence.white)), 0, 255).astype(np.uint8)


def _in_range(in_camera: Array, points_m: Array, slant: Array, setup: ScanSetup) -> NDArray[np.bool_]:
    depth, radius = in_camera[:, 2], np.hypot(points_m[:, 0], points_m[:, 1])
    good = (depth > setup.near_m) & (depth < setup.far_m) & (slant > _GRAZING)  # NaN compares false
    return np.asarray(good & (radius < setup.radius_m) if np.isfinite(setup.radius_m) else good)


def _beside(picture: Picture, ridge: Ridge, kept: NDArray[np.bool_], sigma_px: float) -> Array:
    """Mean (n, 3) of the two pixels on the scan line where the laser's light has ended, in the picture's counts."""
    column, line = ridge.uv_px[kept, 0], ridge.lines[kept]
    sides = [np.clip(np.rint(column + s * _BESIDE * sigma_px), 0, picture.shape[1] - 1).astype(int) for s in (-1, 1)]
    mean = np.mean([picture[line, side].astype(np.float64) for side in sides], axis=0)
    return np.asarray(mean if mean.ndim == 2 else np.repeat(mean[:, None], 3, axis=1))


def _drop_isolated(scan: Scan) -> None:
    """Take out points of which fewer than two of the eight neighbours (frame, scan line) lie nearby."""
    usual = [np.linalg.norm(np.diff(scan.points_m, axis=axis), axis=-1) for axis in (0, 1)]
    medians = [float(np.nanmedian(steps)) for steps in usual if np.isfinite(steps).any()]
    reach = _NEAR * max(medians, default=np.inf)
    frames, lines = scan.status.shape
    near = np.zeros((frames, lines), np.uint8)
    for a, b in ((0, 1), (1, -1), (1, 0), (1, 1)):
        ahead = slice(a, frames), slice(max(b, 0), lines + min(b, 0))
        behind = slice(0, frames - a), slice(max(-b, 0), lines + min(-b, 0))
        close = np.linalg.norm(scan.points_m[ahead] - scan.points_m[behind], axis=-1) < reach
        near[ahead] += close
        near[behind] += close
    alone = (scan.status == ScanStatus.MEASURED) & (near < (2 if frames > 1 else 1))
    scan.status[alone] = ScanStatus.ISOLATED
    for values in (scan.points_m, scan.deviation_m, scan.uv_px):
        values[alone] = np.nan
