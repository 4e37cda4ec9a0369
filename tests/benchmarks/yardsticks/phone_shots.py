"""A phone with a clip-on fish-eye lens that photographs a known environment twice, front and back.

Each photograph is a bracket of JPEG files by a camera whose response the analysis does not know, with noise, a dark
border around the image circle, and reflections of the lens's frame: patches near the rim, at the same places of both
pictures, which hide a part of the scene and add light of their own.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from processing import geometry
from processing.cameras.lens import Fisheye
from processing.environment.equirectangular import Panorama, cubemap_of
from processing.formats.exr import read_exr
from processing.products import Environment
from simulators import fisheye, places
from simulators.picture import CURVES, PictureCamera
from tests.public_data import DATA

REAL = DATA / "environments"
FIELD_RAD = np.radians(190.0)
STEP_STOPS, LONGEST_STOPS, SHORTEST_S = 2.5, 2.0, 1 / 32_000
METERED = 0.2  # of full scale, for the median of the picture
_TRUE_SCALE = 1.004  # of the focal length that the stated field and the circle give


@dataclass(frozen=True)
class PhoneShots:
    """Files of the two brackets, and what is true of them: lens, frames, hidden pixels and the environment."""

    front: tuple[Path, ...]
    back: tuple[Path, ...]
    lens: Fisheye
    world_from_front: np.ndarray
    world_from_back: np.ndarray
    mask: np.ndarray
    panorama: Panorama
    camera: PictureCamera
    clipped: float

    @cached_property
    def unit(self) -> np.ndarray:
        """What the camera's relative radiance must be multiplied by, per channel, to be the environment's."""
        x = np.linspace(0, 1, 200_001)
        middle = [np.interp(128 / 255, curve(x), x) for curve in CURVES[self.camera.curve]]
        return np.array(middle) / self.camera.sensitivity

    def truth(self, size: int) -> Environment:
        """The environment as a cubemap."""
        return cubemap_of(self.panorama, size)


def photograph(
    panorama: Panorama,
    folder: Path,
    *,
    seed: int,
    radius_px: float,
    curve: str = "soft shoulder",
    tilt_deg: float = 4.0,
) -> PhoneShots:
    """Shoot both brackets into a folder; a hand turns the phone, so the back is off by some degrees about each axis."""
    rng = np.random.default_rng((5, seed))
    size = (round(2.16 * radius_px), round(2.5 * radius_px))
    centre = np.array([size[1], size[0]]) / 2 - 0.5 + rng.uniform(-0.02, 0.02, 2) * radius_px
    focal = _TRUE_SCALE * radius_px / (FIELD_RAD / 2)
    lens = Fisheye(np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]]), np.zeros(4))
    layout = fisheye.FisheyeLayout(size[1], size[0], (float(centre[0]), float(centre[1])), radius_px, focal)
    front = geometry.look_at(np.zeros(3), (1, 0, 0))[:3, :3]
    turned = np.diag([-1.0, 1.0, -1.0])  # half a turn about the camera's vertical
    off = geometry.rigid_from_vectors(np.radians(rng.uniform(-tilt_deg, tilt_deg, 3)), np.zeros(3))[:3, :3]
    back = front @ turned @ off
    camera = PictureCamera(curve, sensitivity=16.0, full_e=12_000.0, read_noise_e=8.0, f_number=1.8, quality=95,
                           subsampling="4:2:0", white_balance=(1.8, 1.0, 1.6), model="Phone P3")  # fmt: skip
    frame = fisheye.reflections(seed)
    files, clipped = [], []
    for number, (name, world_from_camera) in enumerate((("front", front), ("back", back))):
        picture, inside = fisheye.picture(panorama.picture, layout, world_from_camera, frame)
        times = _bracket(picture[inside > 0.5], camera)
        paths = []
        for shot, time_s in enumerate(times):
            path = folder / f"{name}{shot}.jpg"
            path.write_bytes(camera.photograph(picture, time_s, (seed, number, shot)))
            paths.append(path)
        files.append(tuple(paths))
        full = camera.f_number**2 / (camera.sensitivity * min(times))
        clipped.append(float(np.maximum(picture - full, 0)[inside > 0.5].sum() / picture[inside > 0.5].sum()))
    return PhoneShots(*files, lens, front, back, frame.hidden(layout)[0] > 0.1, panorama, camera, max(clipped))


def _bracket(radiance: np.ndarray, camera: PictureCamera) -> list[float]:
    """Times from two stops over the metered one, until nothing is clipped or the shutter is no faster."""
    unit = camera.sensitivity / camera.f_number**2
    metered = METERED / (np.median(radiance.mean(axis=-1)) * unit)
    times = [metered * 2.0**LONGEST_STOPS]
    while len(times) < 3 or (radiance.max() * unit * times[-1] > 0.95 and times[-1] / 2**STEP_STOPS > SHORTEST_S):
        times.append(times[-1] / 2.0**STEP_STOPS)
    return times


def environments(height: int = 256) -> dict[str, Panorama]:
    """Synthetic ones by name, and those of the public data where they are here."""
    found = {"sky": sky(1, height), "room": room(1, height)}
    if REAL.is_dir():
        for path in sorted(REAL.glob("*.exr")):
            panorama = Panorama(np.maximum(read_exr(path).image, 0).astype(np.float64))
            while panorama.picture.shape[0] > height:
                panorama = panorama.halved()
            found[path.stem] = panorama
    return found


def sky(seed: int, height: int) -> Panorama:
    """The simulators' sky."""
    return Panorama(places.sky(seed, height))


def room(seed: int, height: int) -> Panorama:
    """The simulators' room."""
    return Panorama(places.room(seed, height))
