"""The phone: a camera in the hand with a fish-eye before its lens, and the pictures that it takes of a place.

JPEG goes through a tone curve that no file states; DNG holds the sensor's counts. The front looks along +X with +Z up;
for the back the hand turns the phone by half a turn about its vertical, and a few degrees off.
"""

from dataclasses import dataclass, field, replace
from fractions import Fraction
from math import radians

import numpy as np
from PIL.TiffImagePlugin import IFDRational

from simulators.chance import Key
from simulators.dng import RawFile, encode_dng, stamp
from simulators.fisheye import FisheyeLayout, Reflections, picture, reflections
from simulators.layout import PHONE, Array, rotation
from simulators.light import SRGB_FROM_XYZ, through_filters
from simulators.picture import CURVES, PictureCamera
from simulators.places import PLACES
from simulators.sensor import Sensor

FACINGS = ("front", "back")
FIELD_DEG = 190.0
TRUE_SCALE = 1.004  # of the focal length that the stated field and the circle give
OFF_DEG = 4.0  # by which the hand misses half a turn, about each axis, at most
FRONT = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # rig from camera
HALF_TURN = np.diag([-1.0, 1.0, -1.0])
SIZES = {"small": (120.0, 256), "full": (600.0, 1024)}  # radius of the image circle, rows of a place's picture
CAMERA = PictureCamera(
    "soft shoulder", sensitivity=16.0, full_e=12_000.0, read_noise_e=8.0, f_number=1.8, quality=95,
    white_balance=(1.8, 1.0, 1.6), model="Virtual Phone",
)  # fmt: skip
FOCAL_LENGTH_MM = 1.2  # with the fish-eye
_MAKE, _BODY_SERIAL, _IMAGE_ID, _TAKEN, _TAKEN_SUBSECOND, _TIME = 0x010F, 0xA431, 0xA420, 0x9003, 0x9291, 0x829A
_SPEEDS = (
    "1/32000 1/25000 1/20000 1/16000 1/12500 1/10000 1/8000 1/6400 1/5000 1/4000 1/3200 1/2500 1/2000 1/1600 1/1250 "
    "1/1000 1/800 1/640 1/500 1/400 1/320 1/250 1/200 1/160 1/125 1/100 1/80 1/60 1/50 1/40 1/30 1/25 1/20 1/15 1/13 "
    "1/10 1/8 1/6 1/5 1/4 1/3 10/25 1/2 10/16 10/13 1/1 13/10 16/10 2/1 25/10 32/10 4/1"
)
SPEEDS = tuple((int(top), int(bottom)) for top, bottom in (speed.split("/") for speed in _SPEEDS.split()))


@dataclass(frozen=True)
class PhoneLayout:
    """What the phone's label says, and its true optics; `rig_from_camera` (3, 3) by where it looks."""

    lens: FisheyeLayout
    frame: Reflections
    rig_from_camera: dict[str, Array]
    rows: int  # of a place's picture
    name: str = PHONE
    serial: str = "PH-0001"
    model: str = CAMERA.model
    megabytes_per_s: float = 20.0

    @property
    def width_px(self) -> int:
        """Of a picture."""
        return self.lens.width_px

    @property
    def height_px(self) -> int:
        """Of a picture."""
        return self.lens.height_px


def build_phone(seed: int, size: str) -> PhoneLayout:
    """The phone of this seed."""
    radius, rows = SIZES[size]
    rng = np.random.default_rng([seed, 6])
    height, width = (2 * round(share * radius / 2) for share in (2.16, 2.5))
    right, down = np.array([width, height]) / 2 - 0.5 + rng.uniform(-0.02, 0.02, 2) * radius
    focal = TRUE_SCALE * radius / (radians(FIELD_DEG) / 2)
    lens = FisheyeLayout(width, height, (float(right), float(down)), radius, focal)
    off = rotation(np.radians(rng.uniform(-OFF_DEG, OFF_DEG, 3)))
    return PhoneLayout(lens, reflections(seed), {"front": FRONT, "back": FRONT @ HALF_TURN @ off}, rows)


@dataclass(frozen=True, slots=True)
class FrameLabel:
    """What a file says of itself beside its exposure."""

    serial: str
    time_s: float
    unique_id: str


@dataclass
class Phone:
    """The phone of one rig, in its places; pictures are kept once they are drawn."""

    layout: PhoneLayout
    seed: int
    _places: dict[str, Array] = field(default_factory=dict)
    _pictures: dict[tuple[str, str], Array] = field(default_factory=dict)

    def place(self, name: str) -> Array:
        """The light of a place (h, 2 h, 3). Raises ValueError where there is none of this name."""
        if name not in PLACES:
            raise ValueError(f"no place {name!r}: one of {', '.join(PLACES)}")
        if name not in self._places:
            self._places[name] = PLACES[name](self.seed, self.layout.rows)
        return self._places[name]

    def radiance(self, place: str, facing: str) -> Array:
        """What falls on the sensor (h, w, 3)."""
        if (place, facing) not in self._pictures:
            turn = self.layout.rig_from_camera[facing]
            self._pictures[place, facing] = picture(self.place(place), self.layout.lens, turn, self.layout.frame)[0]
        return self._pictures[place, facing]

    def jpeg(self, radiance: Array, exposure_s: float, key: Key, label: FrameLabel) -> bytes:
        """The JPEG file of one exposure."""
        taken, subsecond = stamp(label.time_s)
        exposure = Fraction(exposure_s).limit_denominator(100_000)
        tags = {_TIME: IFDRational(exposure.numerator, exposure.denominator), _TAKEN: taken,
                _TAKEN_SUBSECOND: subsecond, _BODY_SERIAL: label.serial, _IMAGE_ID: label.unique_id}  # fmt: skip
        return CAMERA.photograph(radiance, exposure_s, key, {_MAKE: "Virtual"}, tags)

    def dng(self, radiance: Array, exposure_s: float, key: Key, label: FrameLabel) -> bytes:
        """The DNG file of one exposure."""
        balance = np.array(CAMERA.white_balance)
        share_s = CAMERA.sensitivity / CAMERA.f_number**2
        mosaic = np.empty(radiance.shape[:2], np.float32)
        gains = np.asarray(CAMERA.full_e * share_s / balance)
        through_filters(np.asarray(radiance, np.float32), gains, mosaic)
        raw = RawFile(
            serial=label.serial, model=CAMERA.model, black_dn=SENSOR.black_dn, white_dn=SENSOR.white_dn,
            noise_profile=SENSOR.noise_profile(), color_matrix=SRGB_FROM_XYZ / balance[:, None],
            neutral=(float(1 / balance[0]), 1.0, float(1 / balance[2])), exposure_s=exposure_s, iso=CAMERA.iso,
            f_number=CAMERA.f_number, focal_length_mm=FOCAL_LENGTH_MM, time_s=label.time_s,
            unique_id=label.unique_id,
        )  # fmt: skip
        return encode_dng(SENSOR.expose(mosaic, exposure_s, key), raw)

    def unit_of_raw(self) -> Array:
        """Radiance (3,) that is an electron a second, white-balanced."""
        return np.full(3, CAMERA.f_number**2 / (CAMERA.sensitivity * CAMERA.full_e))

    def unit_of_jpeg(self) -> Array:
        """Radiance (3,) that gives code 128 within 1 s at f/1 and ISO 100."""
        x = np.linspace(0, 1, 200_001)
        return np.array([np.interp(128 / 255, curve(x), x) for curve in CURVES[CAMERA.curve]]) / CAMERA.sensitivity


SENSOR = replace(Sensor(), gain_e_per_dn=CAMERA.full_e / (4095 - 256), read_noise_e=CAMERA.read_noise_e)
