"""Photographs as cameras and phones deliver them: 8-bit JPEG, TIFF or PNG with EXIF."""

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from processing.errors import ImageError
from processing.formats import exif


@dataclass(frozen=True, slots=True)
class Photograph:
    """`srgb8` (h, w, 3) uint8; exposure time, f-number and ISO NaN and model empty where EXIF does not say them."""

    srgb8: NDArray[np.uint8]
    exposure_s: float
    f_number: float
    iso: float
    model: str


def read_photo(path: Path) -> Photograph:
    """Read one photograph. Raises ImageError that names the file where it is missing, truncated or no image."""
    try:
        content = path.read_bytes()
        with Image.open(io.BytesIO(content)) as image:
            srgb8 = np.asarray(image.convert("RGB"))
    except UnidentifiedImageError as error:
        raise ImageError(f"{path}: not a picture, or of an unknown format. Copy it again, or leave it out.") from error
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise ImageError(f"{path}: not a readable picture ({error}). Copy it again, or leave it out.") from error
    tags = exif.read_tags(content)
    return Photograph(
        srgb8=srgb8,
        exposure_s=exif.exposure_s(tags),
        f_number=exif.number(tags, "FNumber"),
        iso=exif.number(tags, "ISOSpeedRatings"),
        model=exif.text(tags, "Model"),
    )
