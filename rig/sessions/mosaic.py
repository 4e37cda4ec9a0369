"""What the session engine must know of a camera's file: its counts and their levels."""

import io
from dataclasses import dataclass

import exifread
import numpy as np
import rawpy
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from rig.errors import FrameCheckError

_NOISE_PROFILE = "0xC761"  # DNG specification 1.7, tag NoiseProfile


@dataclass(frozen=True, slots=True)
class Mosaic:
    """One decoded frame: `raw_dn` (h, w) uint16, `cfa` (2, 2) with 0 red, 1 green, 2 blue.

    Of a JPEG the counts are its luma codes, and there is no `cfa`.
    """

    raw_dn: NDArray[np.uint16]
    black_dn: float
    white_dn: float
    cfa: tuple[tuple[int, ...], ...] | None


def decode(data: bytes, camera: str) -> Mosaic:
    """Decode a camera's raw file. Raises FrameCheckError where it is truncated or not a raw image."""
    try:
        with rawpy.imread(io.BytesIO(data)) as raw:
            return Mosaic(
                raw_dn=np.array(raw.raw_image_visible, dtype=np.uint16),
                black_dn=float(max(raw.black_level_per_channel)),
                white_dn=float(raw.white_level),
                cfa=_cfa(raw),
            )
    except (rawpy.LibRawError, rawpy.NotSupportedError, ValueError) as error:
        raise FrameCheckError(f"{camera}: {len(data)} bytes came that are not a whole raw image ({error}).") from error


def decode_jpeg(data: bytes, camera: str) -> Mosaic:
    """Decode a camera's JPEG. Raises FrameCheckError where it is truncated or not one."""
    try:
        with Image.open(io.BytesIO(data), formats=("JPEG",)) as picture:
            luma = np.asarray(picture.convert("L"), np.uint16)
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise FrameCheckError(f"{camera}: {len(data)} bytes came that are not a whole JPEG ({error}).") from error
    return Mosaic(luma, 0.0, 255.0, None)


def noise_profile(data: bytes) -> tuple[float, ...] | None:
    """The DNG tag NoiseProfile (slope and offset, once or per channel), None where the file has none."""
    tags = exifread.process_file(io.BytesIO(data), details=False, extract_thumbnail=False)
    found = next((tag for name, tag in tags.items() if name.endswith(_NOISE_PROFILE)), None)
    return tuple(np.ravel(found.values).astype(float).tolist()) if found is not None else None


def _cfa(raw: rawpy.RawPy) -> tuple[tuple[int, ...], ...]:
    """LibRaw counts the second green as 3. Raises ValueError where the sensor has no colour filter array."""
    if raw.raw_pattern is None:
        raise ValueError("not a mosaic")
    return tuple(tuple(1 if colour == 3 else int(colour) for colour in row) for row in raw.raw_pattern)
