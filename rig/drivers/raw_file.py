"""What a raw file says about itself: the camera's serial number, the exposure time, and when it was taken."""

import io
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import exifread

from rig.errors import FrameCheckError

_SERIAL = "Image Tag 0xC62F"  # CameraSerialNumber (DNG specification 1.7)
_EXPOSURE = ("EXIF ExposureTime", "Image ExposureTime")  # cameras differ in the directory that they put it in
_EPOCH = datetime(2000, 1, 1)  # near enough for microseconds in a float
_MILLISECONDS = 3  # digits
_MOMENT = ("EXIF DateTimeOriginal", "EXIF SubSecTimeOriginal")
_EXTENTS = (("Image StripOffsets", "Image StripByteCounts"), ("Image TileOffsets", "Image TileByteCounts"))


@dataclass(frozen=True, slots=True)
class FileFacts:
    """Who took the file, how long it was exposed, and when.

    `stamp_s` is the moment by the camera's own clock, good for differences; None where it tells no milliseconds.
    """

    serial: str
    exposure_s: float
    stamp_s: float | None


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
    return FileFacts(_text(tags, _SERIAL), float(exposure.values[0]), _stamp_s(tags))


def _stamp_s(tags: dict[str, Any]) -> float | None:
    moment, fraction = (_text(tags, name) for name in _MOMENT)
    if not (fraction.isdecimal() and len(fraction) >= _MILLISECONDS):
        return None
    try:
        return (datetime.strptime(moment, "%Y:%m:%d %H:%M:%S") - _EPOCH).total_seconds() + float(f"0.{fraction}")
    except ValueError:
        return None


def _text(tags: dict[str, Any], name: str) -> str:
    return str(tags[name].values).strip("\0 ") if name in tags else ""


def _end(tags: dict[str, Any], offsets: str, counts: str) -> int:
    """Where the last strip or tile ends; 0 where there are none."""
    if offsets not in tags or counts not in tags:
        return 0
    parts = zip(tags[offsets].values, tags[counts].values, strict=False)
    return max((offset + count for offset, count in parts), default=0)
