"""What a fish-eye clipped before a phone's lens shows: an image circle on black, and the lens's frame mirrored in it.

Angles from the axis are in proportion to the distance from the image's centre. Camera axes are OpenCV's. The frame's
reflections are patches near the rim, at the same places of every picture: they hide a part of the scene and add light
of their own.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulators.places import look

Array = NDArray[np.float64]
Patch = tuple[float, float, float, float, float, float]
SUB = 2  # rays per pixel along each axis
STRAY = 1e-4  # light outside of the image circle, of the picture's mean
EDGE_PX = 4.0  # over which a reflection fades


@dataclass(frozen=True)
class FisheyeLayout:
    """A picture's size, its circle, and the lens: `focal_px` per radian from the axis, `centre_px` (column, row)."""

    width_px: int
    height_px: int
    centre_px: tuple[float, float]
    radius_px: float
    focal_px: float

    def from_centre_px(self, across: float = 0.0, down: float = 0.0) -> tuple[Array, Array]:
        """Columns and rows (h, w) from the image's centre, of places that far from the pixels' middles."""
        columns, rows = np.meshgrid(np.arange(self.width_px), np.arange(self.height_px))
        x, y = columns + across - self.centre_px[0], rows + down - self.centre_px[1]
        return x.astype(np.float64), y.astype(np.float64)


@dataclass(frozen=True)
class Reflections:
    """Patches of the frame's reflection, the same in every picture of a lens.

    Each is azimuth and half width in rad, radius and half height in image radii, share of the scene that it hides, and
    its own radiance in means of the picture.
    """

    patches: tuple[Patch, ...]

    def hidden(self, lens: FisheyeLayout) -> tuple[Array, Array]:
        """Share hidden and own light of each pixel (h, w)."""
        x, y = lens.from_centre_px()
        azimuth_rad, radius = np.arctan2(y, x), np.hypot(x, y) / lens.radius_px
        share, light = np.zeros(radius.shape), np.zeros(radius.shape)
        for azimuth, half_width, middle, half_height, opacity, own in self.patches:
            across = (np.abs((azimuth_rad - azimuth + np.pi) % (2 * np.pi) - np.pi) - half_width) * radius
            along = np.abs(radius - middle) - half_height
            outside = np.hypot(np.maximum(across, 0), np.maximum(along, 0)) + np.minimum(np.maximum(across, along), 0)
            part = opacity / (1 + np.exp(np.clip(4 * outside * lens.radius_px / EDGE_PX, -50, 50)))
            light = light * (1 - part) + part * own
            share = share + part - share * part
        return share, light


def reflections(seed: int) -> Reflections:
    """Dark and bright patches in a ring near the rim."""
    rng = np.random.default_rng((77, seed))
    count = int(rng.integers(3, 6))
    azimuths = 2 * np.pi * (np.arange(count) + rng.uniform(-0.25, 0.25, count)) / count + rng.uniform(0, 7)
    patches: list[Patch] = []
    for number, azimuth in enumerate(azimuths):
        opacity, own = (rng.uniform(0.85, 0.97), rng.uniform(0.02, 0.1)) if number % 2 else (
            rng.uniform(0.5, 0.8), rng.uniform(1.5, 4.0))  # fmt: skip
        patches.append((float(azimuth), np.radians(rng.uniform(4, 14)), rng.uniform(0.86, 0.93),
                        rng.uniform(0.02, 0.04), opacity, own))  # fmt: skip
    return Reflections(tuple(patches))


def picture(panorama: Array, lens: FisheyeLayout, world_from_camera: Array, frame: Reflections) -> tuple[Array, Array]:
    """Radiance (h, w, 3) of each pixel, and the share of it inside of the image circle."""
    seen, inside = _seen(panorama, lens, world_from_camera)
    mean = seen[inside > 0.5].mean()
    share, own = frame.hidden(lens)
    shown = (seen * (1 - share[..., None]) + mean * own[..., None]) * inside[..., None]
    return shown + STRAY * mean, inside


def _seen(panorama: Array, lens: FisheyeLayout, world_from_camera: Array) -> tuple[Array, Array]:
    """Mean radiance (h, w, 3) over each pixel, and the share of it inside of the image circle."""
    shape = lens.height_px, lens.width_px
    total, inside = np.zeros((*shape, 3)), np.zeros(shape)
    part = (np.arange(SUB) + 0.5) / SUB - 0.5
    near = np.hypot(*lens.from_centre_px()) < lens.radius_px + 2
    for down in part:
        for across in part:
            x, y = (place[near] for place in lens.from_centre_px(across, down))
            out = np.hypot(x, y)
            polar = np.minimum(out / lens.focal_px, np.pi)
            level = np.sin(polar) / np.maximum(out, 1e-12)
            rays = np.stack([level * x, level * y, np.cos(polar)], axis=-1)
            total[near] += look(panorama, rays @ world_from_camera.T)
            inside[near] += np.clip(lens.radius_px - out + 0.5, 0, 1)
    return total / SUB**2, inside / SUB**2
