"""A phone with a clip-on fish-eye lens that photographs a known environment twice, front and back.

Each photograph is a bracket of JPEG files by a camera whose response the analysis does not know, with noise, a dark
border around the image circle, and reflections of the lens's frame: patches near the rim, at the same places of both
pictures, which hide a part of the scene and add light of their own.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from processing import geometry
from processing.cameras.lens import Fisheye
from processing.environment.equirectangular import Panorama, cubemap_of
from processing.formats.exr import read_exr
from processing.products import Environment
from simulators.picture import CURVES, PictureCamera
from tests.public_data import DATA

REAL = DATA / "environments"
FIELD_RAD = np.radians(190.0)
STEP_STOPS, LONGEST_STOPS, SHORTEST_S = 2.5, 2.0, 1 / 32_000
METERED = 0.2  # of full scale, for the median of the picture
_BORDER = 1e-4  # stray light outside of the image circle, of the mean radiance
_SUB = 2
_TRUE_SCALE = 1.004  # of the focal length that the stated field and the circle give
Patch = tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class Reflections:
    """Patches of the frame's reflection, the same in every picture of a lens.

    Each is azimuth and half width in rad, radius and half height in image radii, share of the scene that it hides, and
    its own radiance in means of the picture.
    """

    patches: tuple[Patch, ...]

    def hidden(self, azimuth_rad: np.ndarray, radius: np.ndarray, edge: float) -> tuple[np.ndarray, np.ndarray]:
        """Share hidden and own light at places of the image circle; `edge` is the softness in image radii."""
        share, light = np.zeros(radius.shape), np.zeros(radius.shape)
        for azimuth, half_width, middle, half_height, opacity, own in self.patches:
            across = (np.abs((azimuth_rad - azimuth + np.pi) % (2 * np.pi) - np.pi) - half_width) * radius
            along = np.abs(radius - middle) - half_height
            outside = np.hypot(np.maximum(across, 0), np.maximum(along, 0)) + np.minimum(np.maximum(across, along), 0)
            part = opacity / (1 + np.exp(np.clip(4 * outside / edge, -50, 50)))
            light = light * (1 - part) + part * own
            share = share + part - share * part
        return share, light


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


def reflections(seed: int) -> Reflections:
    """Dark and bright patches in a ring near the rim."""
    rng = np.random.default_rng((77, seed))
    count = int(rng.integers(3, 6))
    azimuths = 2 * np.pi * (np.arange(count) + rng.uniform(-0.25, 0.25, count)) / count + rng.uniform(0, 7)
    patches = []
    for number, azimuth in enumerate(azimuths):
        opacity, own = (rng.uniform(0.85, 0.97), rng.uniform(0.02, 0.1)) if number % 2 else (
            rng.uniform(0.5, 0.8), rng.uniform(1.5, 4.0))  # fmt: skip
        patches.append((azimuth, np.radians(rng.uniform(4, 14)), rng.uniform(0.86, 0.93), rng.uniform(0.02, 0.04),
                        opacity, own))  # fmt: skip
    return Reflections(tuple(patches))


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
    front = geometry.look_at(np.zeros(3), (1, 0, 0))[:3, :3]
    turned = np.diag([-1.0, 1.0, -1.0])  # half a turn about the camera's vertical
    off = geometry.rigid_from_vectors(np.radians(rng.uniform(-tilt_deg, tilt_deg, 3)), np.zeros(3))[:3, :3]
    back = front @ turned @ off
    camera = PictureCamera(curve, sensitivity=16.0, full_e=12_000.0, read_noise_e=8.0, f_number=1.8, quality=95,
                           subsampling="4:4:4", white_balance=(1.8, 1.0, 1.6), model="Phone P3")  # fmt: skip
    frame = reflections(seed)
    share, own = _reflected(frame, lens, size, radius_px)
    files, clipped = [], []
    for number, (name, world_from_camera) in enumerate((("front", front), ("back", back))):
        seen, inside = _seen(panorama, lens, world_from_camera, size, radius_px)
        mean = seen[inside > 0.5].mean()
        picture = (seen * (1 - share[..., None]) + mean * own[..., None]) * inside[..., None]
        picture += _BORDER * mean
        times = _bracket(picture[inside > 0.5], camera)
        paths = []
        for shot, time_s in enumerate(times):
            path = folder / f"{name}{shot}.jpg"
            path.write_bytes(camera.photograph(picture, time_s, (seed, number, shot)))
            paths.append(path)
        files.append(tuple(paths))
        full = camera.f_number**2 / (camera.sensitivity * min(times))
        clipped.append(float(np.maximum(picture - full, 0)[inside > 0.5].sum() / picture[inside > 0.5].sum()))
    return PhoneShots(*files, lens, front, back, share > 0.1, panorama, camera, max(clipped))


def _bracket(radiance: np.ndarray, camera: PictureCamera) -> list[float]:
    """Times from two stops over the metered one, until nothing is clipped or the shutter is no faster."""
    unit = camera.sensitivity / camera.f_number**2
    metered = METERED / (np.median(radiance.mean(axis=-1)) * unit)
    times = [metered * 2.0**LONGEST_STOPS]
    while len(times) < 3 or (radiance.max() * unit * times[-1] > 0.95 and times[-1] / 2**STEP_STOPS > SHORTEST_S):
        times.append(times[-1] / 2.0**STEP_STOPS)
    return times


def _seen(
    panorama: Panorama, lens: Fisheye, world_from_camera: np.ndarray, size: tuple[int, int], radius_px: float
) -> tuple[np.ndarray, np.ndarray]:
    """Mean radiance (h, w, 3) over each pixel, and the share of it inside of the image circle."""
    total, inside = np.zeros((*size, 3)), np.zeros(size)
    part = (np.arange(_SUB) + 0.5) / _SUB - 0.5
    columns, rows = np.meshgrid(np.arange(size[1]), np.arange(size[0]))
    focal, centre, light = lens.matrix[0, 0], lens.matrix[:2, 2], panorama.radiance
    near = np.hypot(columns - centre[0], rows - centre[1]) < radius_px + 2
    for down in part:
        for across in part:
            x, y = (columns[near] + across - centre[0]), (rows[near] + down - centre[1])
            out = np.hypot(x, y)
            polar = np.minimum(out / focal, np.pi)
            level = np.sin(polar) / np.maximum(out, 1e-12)
            rays = np.stack([level * x, level * y, np.cos(polar)], axis=-1)
            index, weight = panorama.taps(rays @ world_from_camera.T)
            total[near] += np.einsum("nt,ntc->nc", weight, light[index])
            inside[near] += np.clip(radius_px - out + 0.5, 0, 1)
    return total / _SUB**2, inside / _SUB**2


def _reflected(
    frame: Reflections, lens: Fisheye, size: tuple[int, int], radius_px: float
) -> tuple[np.ndarray, np.ndarray]:
    columns, rows = np.meshgrid(np.arange(size[1]), np.arange(size[0]))
    x, y = (columns - lens.matrix[0, 2]) / radius_px, (rows - lens.matrix[1, 2]) / radius_px
    return frame.hidden(np.arctan2(y, x), np.hypot(x, y), edge=4.0 / radius_px)


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


def _directions(height: int) -> np.ndarray:
    polar = np.pi * (np.arange(height)[:, None] + 0.5) / height
    azimuth = np.pi - np.pi * (np.arange(2 * height) + 0.5) / height
    parts = np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar) + 0 * azimuth
    return np.stack(parts, axis=-1)


def _texture(rng: np.random.Generator, shape: tuple[int, int], finest: float, octaves: int = 5) -> np.ndarray:
    """Noise of variance 1 that falls with the frequency, the same left and right."""
    total = np.zeros(shape)
    for octave in range(octaves):
        grain = gaussian_filter(rng.normal(size=shape), finest * 2.0**octave, mode=("nearest", "wrap"))
        total += grain / grain.std() * 1.6**octave
    # Plain where columns run together: a star at the pole would be no texture.
    return np.asarray(total / total.std()) * np.sin(np.pi * (np.arange(shape[0])[:, None] + 0.5) / shape[0])


def sky(seed: int, height: int) -> Panorama:
    """A sky with clouds and a veiled sun over ground, trees along the horizon."""
    rng = np.random.default_rng((11, seed))
    directions, shape = _directions(height), (height, 2 * height)
    up = directions[..., 2]
    clouds = np.clip(_texture(rng, shape, 1.5), 0, 2)[..., None]
    blue = np.array([0.35, 0.6, 1.0]) * (1.2 - 0.6 * np.abs(up))[..., None]
    above = blue + clouds * 0.5
    ground = np.array([0.25, 0.22, 0.12]) * np.exp(0.5 * _texture(rng, shape, 0.8))[..., None]
    skyline = 0.03 + 0.1 * np.abs(gaussian_filter1d(rng.normal(size=2 * height), 3, mode="wrap")) * 3
    trees = np.array([0.05, 0.08, 0.03]) * np.exp(0.6 * _texture(rng, shape, 0.8))[..., None]
    picture = np.where((up > skyline)[..., None], above, np.where((up > 0)[..., None], trees, ground))
    azimuth, elevation = rng.uniform(-3, 3), np.radians(38)
    sun = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    apart = np.arccos(np.clip(directions @ sun, -1, 1))
    glow = 400.0 * np.exp(-0.5 * (apart / np.radians(1.2)) ** 2) + 4.0 * np.exp(-apart / np.radians(8))
    return Panorama(picture + glow[..., None] * np.array([1.0, 0.9, 0.75]))


def room(seed: int, height: int) -> Panorama:
    """A box-shaped room with papered walls, pictures, windows and a lamp."""
    rng = np.random.default_rng((13, seed))
    directions = _directions(height)
    half = np.array([2.6, 2.1, 1.4])
    distance = (half / np.maximum(np.abs(directions), 1e-9)).min(axis=-1)
    place = directions * distance[..., None]
    wall = np.argmax(np.abs(place) / half, axis=-1)
    side = np.take_along_axis(place, wall[..., None], -1)[..., 0] > 0
    face = 2 * wall + side
    u = np.where(wall == 0, place[..., 1], place[..., 0])
    v = np.where(wall == 2, place[..., 1], place[..., 2])
    colours = rng.uniform(0.25, 0.8, (6, 3)) * np.array([1.0, 0.92, 0.8])
    shade = 0.3 + 0.25 * np.exp(-distance / 3)
    picture = colours[face] * shade[..., None] * np.exp(0.15 * _texture(rng, face.shape, 0.8))[..., None]
    for number in range(26):
        here = face == rng.integers(0, 6)
        middle, extent = rng.uniform(-1.8, 1.8, 2), rng.uniform(0.1, 0.6, 2)
        patch = here & (np.abs(u - middle[0]) < extent[0]) & (np.abs(v - middle[1]) < extent[1])
        picture[patch] = rng.uniform(0.02, 0.9, 3) * 0.5
        if number % 9 == 4:  # windows
            picture[patch] = np.array([14.0, 17.0, 22.0]) * rng.uniform(0.5, 1.5)
    lamp = directions @ (place[height // 5, height // 2] / np.linalg.norm(place[height // 5, height // 2]))
    picture += 30.0 * np.exp(-0.5 * (np.arccos(np.clip(lamp, -1, 1)) / np.radians(2)) ** 2)[..., None]
    return Panorama(picture)
