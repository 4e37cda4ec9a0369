"""Radiance pictures (.hdr): linear light, 8 bits a channel with a common exponent."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError

Image = NDArray[np.float32]


def read_hdr(path: Path) -> Image:
    """Linear picture (h, w, 3); raises ImageError that names the file where it is missing or no such picture."""
    try:
        content = np.frombuffer(path.read_bytes(), np.uint8)
        picture = cv2.imdecode(content, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR) if content.size else None
    except (OSError, cv2.error) as error:
        raise ImageError(f"{path}: cannot be read: {error}") from error
    if picture is None or picture.dtype != np.float32:
        raise ImageError(f"{path}: not a Radiance picture of linear light")
    return np.ascontiguousarray(picture[..., ::-1], np.float32)


def write_hdr(path: Path, picture: Image) -> None:
    """Write a linear picture (h, w, 3), correct to 1 part in 256 of a pixel's largest channel.

    Raises ImageError where the file cannot be written.
    """
    encoded, content = cv2.imencode(".hdr", np.ascontiguousarray(picture[..., ::-1], np.float32))
    try:
        path.write_bytes(content.tobytes() if encoded else b"")
    except OSError as error:
        raise ImageError(f"{path}: cannot be written: {error.strerror}.") from error
