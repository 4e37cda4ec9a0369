"""What a raw file says about itself: the camera's serial number and the exposure time."""

import io
from dataclasses import dataclass
from typing import Any

import exifread

from rig.errors import FrameCheckError

_SERIAL = "Image Tag 0xC62F"  # CameraSerialNumber (DNG specification 1.7)
_EXPOSURE = ("EXIF ExposureTime", "Image ExposureTime")  # cameras differ in the directory that they put it in
_EXTENTS = (("Image StripOffsets", "Image StripByteCounts"), ("Image TileOffsets", "Image TileByteCounts"))


@dataclass(frozen=True, slots=True)
class FileFacts:
    """Who took the file, and how long it was exposed."""

    serial: str
    exposure_s: float


def read_facts(camera: str, data: bytes) -> FileFacts:
    """Facts from the tags of a DNG. Raises FrameCheckError where it is none, is cut, or leaves them out."""
    tags = exifread.process_file(io.BytesIO(data), details=False)
    exposure = next((tags[name] for name in _EXPOSURE if name in tags), None)
    if exposure is None or _SERIAL not in tags:
        raise FrameCheckError(
            f"{camera}: the frame of {len(data)} bytes is no DNG with serial number and exposure time."
        )
    end = max((_end(tags, *names) for names in _EXTENTS), default=0)
    if end > len(data) or end == 0:
        raise FrameCheckError(
            f"{camera}: the frame is cut: {len(data)} bytes of at least {end or 'an unknown number of'}."
        )
    return FileFacts(str(tags[_SERIAL].values).strip("\0 "), float(exposure.values[0]))


def _end(tags: dict[str, Any], offsets: str, counts: str) -> int:
    """Where the last strip or tile ends; 0 where there are none."""
    if offsets not in tags or counts not in tags:
        return 0
    parts = zip(tags[offsets].values, tags[counts].values, strict=False)
    return max((offset + count for offset, count in parts), default=0)
