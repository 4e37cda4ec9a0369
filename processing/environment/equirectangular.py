"""Equirectangular panoramas: geometry, files, and their way to a cubemap and back.

The first row is straight above (+Z); the middle of the picture lies at an azimuth from +X toward +Y, 0 unless told, and
what is right of it is clockwise from above, as seen from inside.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.environment.area_average import Targets, area_averages, cube_targets
from processing.environment.repair import repair
from processing.errors import ImageError
from processing.formats.exr import ExrImage, read_exr, write_exr
from processing.formats.radiance_hdr import read_hdr, write_hdr
from processing.products.arrays import Float32, Float64
from processing.products.light_environment import Environment, cube_solid_angles, cube_taps
from processing.products.provenance import Provenance

_FINER = 4.0  # a panorama finer than this many samples to a texel is averaged first
_NARROW = 0.5  # of a row's height: thinner samples near the poles count together


@dataclass(frozen=True, eq=False)
class Panorama:
    """Linear `picture` (h, 2 h, 3) of the sphere, its middle at `azimuth_rad`; the samples are its pixels."""

    picture: NDArray[np.floating]
    azimuth_rad: float = 0.0

    def __post_init__(self) -> None:
        shape = self.picture.shape
        if len(shape) != 3 or shape[2] != 3 or shape[1] != 2 * shape[0] or not shape[0]:
            raise ImageError(f"an equirectangular picture is (h, 2 h, 3), twice as wide as high; this one is {shape}")

    @property
    def radiance(self) -> Float64:
        """As of `Samples`."""
        return self.picture.reshape(-1, 3).astype(np.float64)

    @cached_property
    def solid_angles(self) -> Float64:
        """As of `Samples`: bands of the sphere, exactly."""
        return np.repeat(band_solid_angles(self.picture.shape[0]), self.picture.shape[1])

    @cached_property
    def groups(self) -> NDArray[np.intp]:
        """As of `Samples`: neighbours of a row, as many as it takes to make them half as wide as they are high."""
        height, width = self.picture.shape[:2]
        level = np.sin(np.pi * (np.arange(height) + 0.5) / height)
        wide = np.minimum(2.0 ** np.ceil(np.log2(_NARROW / level)).clip(0), width).astype(np.intp)
        in_row = np.arange(width)[None, :] // wide[:, None]
        counts = in_row[:, -1] + 1
        return np.asarray((in_row + (np.cumsum(counts) - counts)[:, None]).ravel(), np.intp)

    @property
    def spacing_rad(self) -> float:
        """As of `Samples`."""
        return float(_NARROW * np.pi / self.picture.shape[0]) * 1.5

    def taps(self, directions: Float64) -> tuple[NDArray[np.intp], Float64]:
        """As of `Samples`: linear between four pixels, across the picture's sides; at the poles along the row."""
        height, width = self.picture.shape[:2]
        x, y, z = directions.T
        column = ((self.azimuth_rad + np.pi - np.arctan2(y, x)) / (2 * np.pi) * width - 0.5) % width
        row = np.clip(np.arctan2(np.hypot(x, y), z) / np.pi * height - 0.5, 0, height - 1)
        left, top = np.floor(column).astype(np.intp), np.minimum(row.astype(np.intp), max(height - 2, 0))
        right, below = (left + 1) % width, np.minimum(top + 1, height - 1)
        across, down = column - left, row - top
        index = np.stack([top * width + left % width, top * width + right, below * width + left % width,
                          below * width + right], axis=-1)  # fmt: skip
        weight = np.stack([(1 - across) * (1 - down), across * (1 - down), (1 - across) * down, across * down], axis=-1)
        return index, weight

    def halved(self) -> "Panorama":
        """Half as many rows and columns, the light the same."""
        height, width = self.picture.shape[:2]
        weighted = (self.radiance * self.solid_angles[:, None]).reshape(height // 2, 2, width // 2, 2, 3)
        return replace(self, picture=weighted.sum(axis=(1, 3)) / band_solid_angles(height // 2)[:, None, None])


def band_solid_angles(height: int) -> Float64:
    """Solid angle (h,) of a pixel of each row of a panorama (h, 2 h)."""
    border = np.cos(np.pi * np.arange(height + 1) / height)
    return np.asarray((border[:-1] - border[1:]) * np.pi / height)


def cubemap_of(panorama: Panorama, size: int, provenance: Provenance | None = None) -> Environment:
    """A panorama's light on a cubemap of size n, its integral kept exactly but for float32.

    Values a little under zero, which compression and colours beyond the primaries leave, count as none.
    Raises ImageError where the picture holds values that are no numbers; `repair` mends them.
    """
    panorama = replace(panorama, picture=np.maximum(panorama.picture, 0.0))
    while panorama.picture.shape[0] % 2 == 0 and np.pi / panorama.picture.shape[0] * _FINER < 2.0 / size:
        panorama = panorama.halved()
    found = area_averages(panorama, cube_targets(size, panorama.spacing_rad))
    return Environment(found.reshape(6, size, size, 3), provenance or Provenance())


def panorama_of(environment: Environment, height: int) -> Panorama:
    """An environment as an equirectangular picture (h, 2 h, 3) float32, its integral kept."""
    texels = CubeTexels(environment)
    found = area_averages(texels, _band_targets(height, texels.spacing_rad))
    return Panorama(found.reshape(height, 2 * height, 3))


@dataclass(frozen=True, eq=False)
class CubeTexels:
    """The texels of a cubemap as samples."""

    environment: Environment

    @property
    def radiance(self) -> Float64:
        """As of `Samples`."""
        return self.environment.radiance.reshape(-1, 3).astype(np.float64)

    @property
    def solid_angles(self) -> Float64:
        """As of `Samples`."""
        return np.tile(cube_solid_angles(self.environment.size).ravel(), 6)

    @property
    def groups(self) -> NDArray[np.intp]:
        """As of `Samples`: each its own."""
        return np.arange(6 * self.environment.size**2)

    @property
    def spacing_rad(self) -> float:
        """As of `Samples`: near a face's edges, a little more than half of that in its middle."""
        return 1.2 / self.environment.size

    def taps(self, directions: Float64) -> tuple[NDArray[np.intp], Float64]:
        """As of `Samples`."""
        return cube_taps(directions, self.environment.size)


def _band_targets(height: int, spacing_rad: float) -> Targets:
    parts = max(2, int(np.ceil(np.pi / height / spacing_rad)))
    polar = np.pi * (np.arange(height * parts) + 0.5) / (height * parts)
    azimuth = np.pi - 2 * np.pi * (np.arange(2 * height * parts) + 0.5) / (2 * height * parts)
    level = np.sin(polar)[:, None]
    directions = np.stack(
        [level * np.cos(azimuth), level * np.sin(azimuth), np.cos(polar)[:, None] + 0 * azimuth], axis=-1
    )
    cells = directions.reshape(height, parts, 2 * height, parts, 3).swapaxes(1, 2)
    return Targets(
        cells.reshape(2 * height * height, parts * parts, 3), np.repeat(band_solid_angles(height), 2 * height)
    )


def read_environment(path: Path, size: int, *, azimuth_rad: float = 0.0) -> tuple[Environment, int]:
    """The cubemap of an equirectangular .exr or .hdr file, and how many of the picture's values were repaired.

    Raises ImageError that names the file where it is missing, no such picture, not twice as wide as high, or more than
    a hundredth of it is no numbers.
    """
    picture = read_hdr(path) if path.suffix.lower() in (".hdr", ".pic") else read_exr(path).image
    try:
        mended = repair(picture)
        provenance = Provenance((path.name,), parameters={"repaired_values": mended.count})
        return cubemap_of(Panorama(mended.picture, azimuth_rad), size, provenance), mended.count
    except ImageError as error:
        raise ImageError(f"{path}: {error}") from error


def write_panorama(path: Path, environment: Environment, height: int) -> None:
    """Write an equirectangular .exr (float32) or .hdr (8 bits and an exponent) of h x 2 h pixels.

    Raises ImageError where the name ends in neither or the file cannot be written.
    """
    if path.suffix.lower() not in (".exr", ".hdr"):
        raise ImageError(f"{path}: an environment is written as .exr or .hdr")
    picture: Float32 = np.asarray(panorama_of(environment, height).picture, np.float32)
    if path.suffix.lower() == ".hdr":
        write_hdr(path, picture)
    else:
        write_exr(path, ExrImage(picture, metadata={"comments": "linear radiance, equirectangular, first row above"}))
