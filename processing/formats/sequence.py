"""Image sequences of other people's: a folder of pictures, or an animation."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, overload

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageSequence, UnidentifiedImageError

from processing.errors import ImageError

Picture = NDArray[Any]  # (h, w) or (h, w, 3) RGB, uint8 or uint16
PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".tga")
ANIMATIONS = (".gif", ".webp")
_UNREADABLE = (OSError, SyntaxError, ValueError, EOFError, IndexError, Image.DecompressionBombError)


@dataclass(frozen=True)
class PictureFiles(Sequence[Picture]):
    """Files that are read when they are asked for. Getting one raises ImageError where it cannot be read."""

    files: tuple[Path, ...]

    def __len__(self) -> int:
        return len(self.files)

    @overload
    def __getitem__(self, index: int) -> Picture: ...
    @overload
    def __getitem__(self, index: slice) -> "PictureFiles": ...
    def __getitem__(self, index: int | slice) -> "Picture | PictureFiles":
        if isinstance(index, slice):
            return PictureFiles(self.files[index])
        return read_picture(self.files[index])


def read_sequence(source: Path) -> Sequence[Picture]:
    """The frames of a folder in the order of their names (frame2 before frame10), or of an animation.

    Raises ImageError where there are none, one cannot be read, or sizes are mixed.
    """
    if source.is_file() and source.suffix.lower() in ANIMATIONS:
        return list(read_animation(source))
    if not source.is_dir():
        raise ImageError(f"{source}: neither a folder of pictures nor an animation ({', '.join(ANIMATIONS)}).")
    return PictureFiles(picture_files(source))


def picture_files(source: Path) -> tuple[Path, ...]:
    """The pictures of a folder in the order of their names, of one size. Raises ImageError as `read_sequence`."""
    # Hidden files are no pictures: copies from other systems leave some with a picture's ending.
    found = (path for path in source.iterdir() if path.suffix.lower() in PICTURES and path.name[0] != ".")
    files = sorted(found, key=natural_order)
    if not files:
        raise ImageError(f"{source}: no picture in it ({', '.join(PICTURES)}).")
    first = _size(files[0])
    for path in files:
        if _size(path) != first:
            raise ImageError(
                f"{path}: {_size(path)[0]} x {_size(path)[1]} pixels, but {first[0]} x {first[1]} in {files[0].name}; "
                "a sequence has one size."
            )
    return tuple(files)


def read_animation(path: Path) -> NDArray[np.uint8]:
    """All frames (t, h, w, 3) of an animated picture. Raises ImageError where it cannot be read."""
    try:
        with Image.open(path) as animation:
            return np.stack([np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(animation)])
    except _UNREADABLE as error:
        raise ImageError(f"{path}: not a readable animation: {error}") from error


def read_picture(path: Path) -> Picture:
    """A picture (h, w) or (h, w, 3) RGB, uint8 or uint16 as it is stored; orientation tags are left alone.

    Raises ImageError where it is missing, truncated, or has neither 8 nor 16 bits.
    """
    try:
        with Image.open(path) as picture:
            # In colour the decoder halves 16 bits; OpenCV keeps them.
            deep = bool(picture.tile) and "16" in str(picture.tile[0][3]) and picture.mode in ("RGB", "RGBA", "LA")
            picture.load()  # raises where the file is cut off, which OpenCV passes over
            if not deep:
                return _as_stored(picture, path)
    except UnidentifiedImageError:
        pass  # TIFF of 16 bits in colour, or no picture at all
    except _UNREADABLE as error:
        raise ImageError(f"{path}: not a readable image: {error}") from error
    decoded = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED) if path.stat().st_size else None
    if decoded is None or decoded.dtype not in (np.uint8, np.uint16):
        raise ImageError(f"{path}: not a readable image of 8 or 16 bits.")
    return decoded if decoded.ndim == 2 else np.ascontiguousarray(decoded[..., 2::-1])


def _as_stored(picture: Image.Image, path: Path) -> Picture:
    if picture.mode == "F":
        raise ImageError(f"{path}: floating-point pixels; 8 or 16 bits are needed.")
    if picture.mode.startswith("I"):
        counts = np.asarray(picture)
        if not 0 <= counts.min() <= counts.max() <= np.iinfo(np.uint16).max:
            raise ImageError(f"{path}: counts from {counts.min()} to {counts.max()}; 8 or 16 bits are needed.")
        return counts.astype(np.uint16)
    return np.asarray(picture if picture.mode == "L" else picture.convert("RGB"))


def _size(path: Path) -> tuple[int, int]:
    """Width and height, of the header where that says it."""
    try:
        with Image.open(path) as picture:
            return picture.size
    except UnidentifiedImageError:
        height, width = read_picture(path).shape[:2]
        return width, height
    except _UNREADABLE as error:
        raise ImageError(f"{path}: not a readable image: {error}") from error


def natural_order(path: Path) -> list[tuple[int, str]]:
    """Key of the order of names in which numbers count as numbers: frame2 before frame10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name)]
