"""Light from all around: an equirectangular picture of radiance, and directional lights that stand for it."""

import heapq
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from render.arrays import Float32, Float64, Rows, unit
from render.errors import SceneError
from render.picture import LUMINANCE
from render.scene import Light

Region = tuple[int, int, int, int]  # first row and column, and those after the last


@dataclass(frozen=True, eq=False)
class Environment:
    """Linear `radiance` (h, w, 3) float32 from every direction, as seen from inside: equirectangular, w = 2 h.

    The first row is straight above (+Z). The middle of the picture lies at `azimuth_rad` from +X toward +Y; right of it
    is clockwise from above. Raises SceneError for other shapes, and for values that are negative or no numbers.
    """

    radiance: Float32
    azimuth_rad: float = 0.0

    def __post_init__(self) -> None:
        shape = self.radiance.shape
        if len(shape) != 3 or shape[2] != 3 or shape[1] != 2 * shape[0] or not shape[0]:
            raise SceneError(f"an environment is (h, 2 h, 3), twice as wide as high; this one is {shape}")
        if not (np.isfinite(self.radiance).all() and self.radiance.min() >= 0.0):
            raise SceneError("an environment of values that are negative or no numbers is no light")

    @property
    def directions(self) -> Float64:
        """Unit vectors (h, w, 3) from the object toward the middle of each pixel, in the world frame."""
        height, width = self.radiance.shape[:2]
        polar_rad = np.pi * (np.arange(height)[:, None] + 0.5) / height
        azimuth_rad = self.azimuth_rad + np.pi - 2.0 * np.pi * (np.arange(width) + 0.5) / width
        level = np.sin(polar_rad)
        parts = level * np.cos(azimuth_rad), level * np.sin(azimuth_rad), np.cos(polar_rad) + 0.0 * azimuth_rad
        return np.stack(parts, axis=-1)

    @property
    def irradiance(self) -> Float64:
        """What each pixel sheds on a surface that faces it, (h, w, 3): radiance times its solid angle."""
        height, width = self.radiance.shape[:2]
        border = np.cos(np.pi * np.arange(height + 1) / height)
        return np.asarray(self.radiance * ((border[:-1] - border[1:]) * 2.0 * np.pi / width)[:, None, None])


def median_cut(environment: Environment, count: int) -> tuple[Light, ...]:
    """At most `count` directional lights that together shed all of the environment's light, none lost.

    The region of the sphere with most luminance is cut in two halves of like luminance, across its longer side, until
    there are enough; each becomes a light in the middle of its luminance. Fewer where pixels run out: with `count` at
    the number of pixels, each that sheds light is one. Source: Debevec, A Median Cut Algorithm for Light Probe
    Sampling, 2005, which cuts every region at each step. Raises SceneError where there is no light at all.
    """
    irradiance, directions = environment.irradiance, environment.directions
    luminance = irradiance @ LUMINANCE
    lights = [_light(irradiance[where], luminance[where], directions[where]) for where in _regions(luminance, count)]
    if not lights:
        raise SceneError("the environment is black all around: nothing would be seen")
    return tuple(lights)


def _regions(luminance: Float64, count: int) -> Iterator[tuple[slice, slice]]:
    """The regions after all cuts that hold any light, those that cannot be cut first."""
    height, width = luminance.shape
    sums = np.pad(luminance.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    left: list[tuple[float, Region]] = [(-float(luminance.sum()), (0, 0, height, width))]
    whole = 0
    while left and left[0][0] < 0.0 and whole + len(left) < count:
        _, region = heapq.heappop(left)
        parts = _halves(sums, region)
        if len(parts) == 1:
            whole += 1
            yield _slices(region)
            continue
        for part in parts:
            heapq.heappush(left, (-float(luminance[_slices(part)].sum()), part))
    yield from (_slices(region) for energy, region in left if energy < 0.0)


def _halves(sums: Float64, region: Region) -> tuple[Region, ...]:
    """The region cut across its longer side where both parts are most alike; itself where it is one pixel."""
    top, left, bottom, right = region
    height, width = sums.shape[0] - 1, sums.shape[1] - 1
    # On the sphere: rows are pi / h high, columns narrow toward the poles.
    across = 2.0 * (right - left) / width * np.sin(0.5 * np.pi * (top + bottom) / height)
    if right - left > 1 and (across >= (bottom - top) / height or bottom - top == 1):
        column = left + _middle(sums[bottom, left : right + 1] - sums[top, left : right + 1])
        return (top, left, bottom, column), (top, column, bottom, right)
    if bottom - top > 1:
        row = top + _middle(sums[top : bottom + 1, right] - sums[top : bottom + 1, left])
        return (top, left, row, right), (row, left, bottom, right)
    return (region,)


def _middle(running: Float64) -> int:
    """Which step of a running sum is nearest to half of it, its ends left out."""
    half = 0.5 * (running[0] + running[-1])
    return 1 + int(np.argmin(np.abs(running[1:-1] - half)))


def _slices(region: Region) -> tuple[slice, slice]:
    return slice(region[0], region[2]), slice(region[1], region[3])


def _light(irradiance: Rows, luminance: Rows, directions: Rows) -> Light:
    mean = np.einsum("yx,yxi->i", luminance, directions)
    if np.linalg.norm(mean) < 1e-9 * luminance.sum():  # light from opposite sides alike
        mean = directions[luminance.shape[0] // 2, luminance.shape[1] // 2]
    return Light(unit(mean), irradiance.sum(axis=(0, 1)))
