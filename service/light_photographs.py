"""Photographs of a still object under one light after another, taken by another camera: pictures and their lights."""

from dataclasses import dataclass, replace
from pathlib import Path, PureWindowsPath

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.formats.light_positions import read_lp
from processing.formats.sequence import Picture, picture_files, read_picture
from processing.materials.chrome_sphere import light_directions, sphere_of_mask
from processing.materials.light_strengths import light_strengths
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

    Counts are sRGB encoded, or, where `linear` says so, in proportion to the light. `strengths` (light,) are those of
    the lights relative to each other.
    """

    names: tuple[str, ...]
    counts: Counts
    lights: Float64
    mask: NDArray[np.bool_]
    linear: bool
    strengths: Float64

    def display_values(self) -> Counts | Float32:
        """What a display shows, as if all lights were equally strong: the counts themselves where they are encoded."""
        if (self.strengths == 1).all():
            return srgb(self._shares()).astype(np.float32)[self.counts] if self.linear else self.counts
        tables = srgb(self._light() / self.strengths[:, None]).astype(np.float32)
        return np.stack([table[counts] for table, counts in zip(tables, self.counts, strict=True)])

    def of_equal_lights(self) -> "LightPhotographs":
        """The same with the strengths that the pictures tell; raises ImageError where they tell none."""
        return replace(self, strengths=light_strengths(self.stack(1.0)))

    def stack(self, pixel_m: float) -> LightStack:
        """Reflectance of which a white card facing camera and light has 1 / pi; saturated channels are NaN.

        Exposure is taken to be the same in all photographs, the lights to be distant.
        """
        shares = self._shares()
        light = np.where(shares >= _FULL, np.nan, self._light())
        around = np.clip(shares, _NOISE / 2, 1 - _NOISE / 2)
        low, high = (around + sign * _NOISE / 2 for sign in (-1, 1))
        spread = high - low if self.linear else linear_of_srgb(high) - linear_of_srgb(low)
        reflectance = (light / np.pi).astype(np.float32)[self.counts]
        variance = ((spread / np.pi) ** 2).astype(np.float32)[self.counts]
        reflectance[:, ~self.mask] = np.nan
        scale = self.strengths.astype(np.float32)[:, None, None, None]
        directions, distances_m = self.lights, np.full(len(self.lights), np.inf)
        provenance = Provenance(self.names, "", {"linear": self.linear, "strengths": self.strengths.tolist()})
        return LightStack(reflectance / scale, variance / scale**2, directions, distances_m, pixel_m, provenance)

    def _light(self) -> Float64:
        """The light that every code stands for, 1 for the largest."""
        return self._shares() if self.linear else np.asarray(linear_of_srgb(self._shares()), np.float64)

    def _shares(self) -> Float64:
        """Every code as a share of the largest."""
        return np.linspace(0.0, 1.0, int(np.iinfo(self.counts.dtype.type).max) + 1)


@dataclass(frozen=True)
class PhotographFiles:
    """Where photographs are, and what tells their lights.

    `source` is an .lp, or a folder with one. Where `chrome` is given, `source` is a folder, and the lights are those
    that a chrome sphere mirrors: `chrome` is a picture, not black where the sphere is, in the folder of the sphere's
    photographs, which may be `source`; those of another folder are as many, in the same order of names.
    `mask` is a picture, not black where the object is. `linear` is as in `LightPhotographs`.
    """

    source: Path
    mask: Path | None = None
    chrome: Path | None = None
    linear: bool = False


def read_photographs(files: PhotographFiles) -> LightPhotographs:
    """Read photographs and find their lights. Pictures of an .lp are looked for where it says, then beside it.

    Raises ImageError where something is missing, mixed or damaged.
    """
    names, counts, lights = _listed(files.source) if files.chrome is None else _mirrored(files, files.chrome)
    inside = np.ones(counts.shape[1:3], np.bool_) if files.mask is None else _mask(files.mask, counts.shape[1:3])
    counts[:, ~inside] = 0
    return LightPhotographs(tuple(names), counts, lights, inside, files.linear, np.ones(len(lights)))


def _listed(source: Path) -> tuple[list[str], Counts, Float64]:
    """Names, counts and lights of an .lp."""
    listing = _listing(source)
    names, lights = read_lp(listing)
    return names, _counts([_found(listing, name) for name in names]), lights


def _mirrored(files: PhotographFiles, chrome: Path) -> tuple[list[str], Counts, Float64]:
    """Names, counts and lights of a folder, by the highlights in a chrome sphere."""
    if not chrome.is_file():
        raise ImageError(f"{chrome}: not there; it is a picture that is not black where the chrome sphere is.")
    paths = _photographs(files.source, files)
    counts, of_sphere = _counts(paths), paths
    mirrored = counts
    if chrome.resolve().parent != files.source.resolve():
        of_sphere = _photographs(chrome.parent, files)
        mirrored = _counts(of_sphere)
    if len(mirrored) != len(counts):
        raise ImageError(
            f"{chrome.parent}: {len(mirrored)} photographs of the chrome sphere, but {len(counts)} in {files.source}; "
            "one for each light is needed, and no other picture beside them."
        )
    sphere = sphere_of_mask(_mask(chrome, mirrored.shape[1:3]))
    names = [path.name for path in of_sphere]
    return [path.name for path in paths], counts, light_directions(mirrored.mean(axis=-1), sphere, names)


def _photographs(folder: Path, files: PhotographFiles) -> list[Path]:
    if not folder.is_dir():
        raise ImageError(f"{folder}: not a folder; with a chrome sphere, all photographs of one are taken.")
    masks = {path.resolve() for path in (files.mask, files.chrome) if path is not None}
    found = [path for path in picture_files(folder) if path.resolve() not in masks]
    if not found:
        raise ImageError(f"{folder}: no photographs beside the masks.")
    return found


def _counts(paths: list[Path]) -> Counts:
    """Pictures of one size and depth (light, y, x, 3)."""
    pictures = [_rgb(read_picture(path)) for path in paths]
    for path, picture in zip(paths, pictures, strict=True):
        if picture.shape != pictures[0].shape or picture.dtype != pictures[0].dtype:
            raise ImageError(
                f"{path.name}: {_told(picture)}, but {_told(pictures[0])} in {paths[0].name}. The camera must stand "
                "still; export all photographs alike."
            )
    return np.stack(pictures)


def _listing(source: Path) -> Path:
    if source.is_file():
        return source
    found = sorted(path for path in source.glob("*") if path.suffix.lower() == ENDING) if source.is_dir() else []
    if len(found) != 1:
        told = f"{len(found)} of them are in it; name the one" if found else "none is there"
        raise ImageError(
            f"{source}: an {ENDING} that says where each photograph's light was is needed, or --chrome: {told}."
        )
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
