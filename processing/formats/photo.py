"""Photographs as cameras and phones deliver them: 8-bit JPEG, TIFF or PNG with EXIF."""

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError
from PIL.JpegImagePlugin import JpegImageFile, get_sampling

from processing.errors import ImageError
from processing.formats import exif
from processing.radiometry.chroma import unmixed_colours

_QUARTERED = 2  # Pillow's number of 4:2:0
_PNG_DEPTH = 24  # byte of the header that says the bits per channel (PNG specification, 11.2.2)


@dataclass(frozen=True, slots=True)
class Photograph:
    """`srgb8` (h, w, 3) uint8, upright; exposure time, f-number, ISO NaN and model empty where EXIF says none."""

    srgb8: NDArray[np.uint8]
    exposure_s: float
    f_number: float
    iso: float
    model: str


def read_photo(path: Path) -> Photograph:
    """Read one photograph, turned upright as EXIF says, colours of a JPEG of 4:2:0 shared out by `unmixed_colours`.

    Raises ImageError that names the file where it is missing, truncated, no image, or not of 8 bits per channel.
    """
    try:
        content = path.read_bytes()
        with Image.open(io.BytesIO(content)) as image:
            deep = image.mode[0] in "IF" or (image.format == "PNG" and content[_PNG_DEPTH] == 16)
            srgb8 = np.asarray(ImageOps.exif_transpose(image).convert("RGB"))
            quartered = isinstance(image, JpegImageFile) and get_sampling(image) == _QUARTERED
    except UnidentifiedImageError as error:
        raise ImageError(f"{path}: not a picture, or of an unknown format. Copy it again, or leave it out.") from error
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise ImageError(f"{path}: not a readable picture ({error}). Copy it again, or leave it out.") from error
    if deep:
        raise ImageError(f"{path}: more than 8 bits per channel. Merge the camera's JPEG files, or its RAW files.")
    tags = exif.read_tags(content)
    return Photograph(
        srgb8=unmixed_colours(srgb8) if quartered else srgb8,
        exposure_s=exif.exposure_s(tags),
        f_number=exif.number(tags, "FNumber"),
        iso=exif.number(tags, "ISOSpeedRatings"),
        model=exif.text(tags, "Model"),
    )
