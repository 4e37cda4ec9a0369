"""Photographs of a still object under one light after another, taken by another camera: pictures and their .lp."""

from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.formats.light_positions import read_lp
from processing.formats.sequence import Picture, read_picture
from processing.products import LightStack, Provenance
from processing.products.arrays import Float32, Float64
from processing.radiometry.display import linear_of_srgb, srgb

ENDING = ".lp"
_NOISE = 1 / 255  # assumed of every code: a camera's noise at low sensitivity, and the rounding
_FULL = 0.996  # share of the largest code from which a channel may be clipped: the last two codes of 8 bits

Counts = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, eq=False)
class LightPhotographs:
    """Counts (light, y, x, 3) of 8 or 16 bits under unit directions (light, 3), 0 outside of `mask` (y, x).

    Counts are sRGB encoded, or, where `linear` says so, in proportion to the light.
    """

    names: tuple[str, ...]
    counts: Counts
    lights: Float64
    mask: NDArray[np.bool_]
    linear: bool

    def display_values(self) -> Counts | Float32:
        """What a display shows: the counts themselves where they are encoded."""
        return srgb(self._shares()).astype(np.float32)[self.counts] if self.linear else self.counts

    def stack(self, pixel_m: float) -> LightStack:
        """Reflectance of which a white card facing camera and light has 1 / pi; saturated channels are NaN.

        Exposure and strength of the lights are taken to be the same in all photographs, the lights to be distant.
        """
        shares = self._shares()
        light = np.where(shares >= _FULL, np.nan, shares if self.linear else linear_of_srgb(shares))
        around = np.clip(shares, _NOISE / 2, 1 - _NOISE / 2)
        low, high = (around + sign * _NOISE / 2 for sign in (-1, 1))
        spread = high - low if self.linear else linear_of_srgb(high) - linear_of_srgb(low)
        reflectance = (light / np.pi).astype(np.float32)[self.counts]
        variance = ((spread / np.pi) ** 2).astype(np.float32)[self.counts]
        reflectance[:, ~self.mask] = np.nan
        directions, distances_m = self.lights, np.full(len(self.lights), np.inf)
        provenance = Provenance(self.names, "", {"linear": self.linear})
        return LightStack(reflectance, variance, directions, distances_m, pixel_m, provenance)

    def _shares(self) -> Float64:
        """Every code as a share of the largest."""
        return np.linspace(0.0, 1.0, int(np.iinfo(self.counts.dtype.type).max) + 1)


def read_photographs(source: Path, mask: Path | None = None, *, linear: bool = False) -> LightPhotographs:
    """Read the photographs that an .lp names: the file itself, or the folder that it lies in.

    Pictures are looked for where the file says, then beside it. `mask` is a picture, not black where the object is.
    Raises ImageError where something is missing, mixed or damaged.
    """
    listing = _listing(source)
    names, lights = read_lp(listing)
    pictures = [_rgb(read_picture(_found(listing, name))) for name in names]
    for name, picture in zip(names, pictures, strict=True):
        if picture.shape != pictures[0].shape or picture.dtype != pictures[0].dtype:
            raise ImageError(
                f"{name}: {_told(picture)}, but {_told(pictures[0])} in {names[0]}. The camera must stand still; "
                "export all photographs alike."
            )
    counts: Picture = np.stack(pictures)
    inside = np.ones(counts.shape[1:3], np.bool_) if mask is None else _mask(mask, counts.shape[1:3])
    counts[:, ~inside] = 0
    return LightPhotographs(tuple(names), counts, lights, inside, linear)


def _listing(source: Path) -> Path:
    if source.is_file():
        return source
    found = sorted(path for path in source.glob("*") if path.suffix.lower() == ENDING) if source.is_dir() else []
    if len(found) != 1:
        told = f"{len(found)} of them are in it; name the one" if found else "none is there"
        raise ImageError(f"{source}: an {ENDING} that says where each photograph's light was is needed: {told}.")
    return found[0]


def _found(listing: Path, name: str) -> Path:
    """The picture as the list names it, or of that name beside the list: lists often tell another machine's folders."""
    beside = listing.parent / PureWindowsPath(name).name
    path = listing.parent / name
    if not path.is_file() and not beside.is_file():
        raise ImageError(f"{listing}: {name} is not there, nor {beside.name} beside the list.")
    return path if path.is_file() else beside


def _rgb(picture: Picture) -> Picture:
    return picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=-1)


def _told(picture: Picture) -> str:
    return f"{picture.shape[1]} x {picture.shape[0]} pixels of {8 * picture.itemsize} bits"


def _mask(path: Path, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    inside = np.asarray(_rgb(read_picture(path)).any(axis=-1), np.bool_)
    if inside.shape != shape:
        raise ImageError(f"{path}: {inside.shape[1]} x {inside.shape[0]} pixels; the photographs have others.")
    if not inside.any():
        raise ImageError(f"{path}: black all over; the object is where the mask is not black.")
    return inside
