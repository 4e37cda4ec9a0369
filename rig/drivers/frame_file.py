"""What a camera's file says of itself: raw or JPEG, whose, how long exposed, at which ISO, and when."""

import io
from dataclasses import dataclass
from datetime import datetime
from math import nan
from typing import Any

import exifread

from rig.devices import FileFormat
from rig.errors import FrameCheckError

_SERIALS = ("Image Tag 0xC62F", "EXIF BodySerialNumber")  # CameraSerialNumber (DNG specification 1.7); Exif 2.3
_EXPOSURE = ("EXIF ExposureTime", "Image ExposureTime")  # cameras differ in the directory that they put it in
_ISO = ("EXIF ISOSpeedRatings", "EXIF PhotographicSensitivity")
_EPOCH = datetime(2000, 1, 1)  # near enough for microseconds in a float
_MILLISECONDS = 3  # digits
_MOMENT = ("EXIF DateTimeOriginal", "EXIF SubSecTimeOriginal")
_EXTENTS = (("Image StripOffsets", "Image StripByteCounts"), ("Image TileOffsets", "Image TileByteCounts"))
_JPEG, _SCAN, _END = b"\xff\xd8\xff", 0xDA, b"\xff\xd9"  # ITU-T T.81, table B.1: SOI, SOS, EOI


@dataclass(frozen=True, slots=True)
class FileFacts:
    """Who took the file, how long it was exposed, at which ISO (NaN where it does not say), and when.

    `stamp_s` is the moment by the camera's own clock, good for differences; None where it tells no milliseconds.
    """

    serial: str
    exposure_s: float
    stamp_s: float | None
    iso: float
    file_format: FileFormat


def read_facts(camera: str, data: bytes) -> FileFacts:
    """Facts from the tags of a DNG or a JPEG. Raises FrameCheckError where it is neither, is cut, or silent."""
    file_format = FileFormat.JPEG if data.startswith(_JPEG) else FileFormat.RAW
    tags = exifread.process_file(io.BytesIO(data), details=False)
    exposure = _first(tags, _EXPOSURE)
    serial = next((text for text in (_text(tags, name) for name in _SERIALS) if text), "")
    if exposure is None or not exposure > 0 or not serial:
        raise FrameCheckError(
            f"{camera}: the frame of {len(data)} bytes is no DNG or JPEG with serial number and exposure time."
        )
    least = _jpeg_extent(data) if file_format is FileFormat.JPEG else _raw_extent(tags)
    if least > len(data) or least == 0:
        raise FrameCheckError(
            f"{camera}: the frame is cut: {len(data)} bytes of at least {least or 'an unknown number of'}."
        )
    iso = _first(tags, _ISO)
    return FileFacts(serial, exposure, _stamp_s(tags), nan if iso is None else iso, file_format)


def _stamp_s(tags: dict[str, Any]) -> float | None:
    moment, fraction = (_text(tags, name) for name in _MOMENT)
    if not (fraction.isdecimal() and len(fraction) >= _MILLISECONDS):
        return None
    try:
        return (datetime.strptime(moment, "%Y:%m:%d %H:%M:%S") - _EPOCH).total_seconds() + float(f"0.{fraction}")
    except ValueError:
        return None


def _first(tags: dict[str, Any], names: tuple[str, ...]) -> float | None:
    """The first of these numbers that is there."""
    found = next((tags[name].values for name in names if name in tags), None)
    try:
        return float(found[0]) if found else None
    except (ValueError, TypeError, ZeroDivisionError):
        return None


def _text(tags: dict[str, Any], name: str) -> str:
    return str(tags[name].values).strip("\0 ") if name in tags else ""


def _raw_extent(tags: dict[str, Any]) -> int:
    """Bytes up to the end of the last strip or tile; 0 where there are none."""
    return max((_end(tags, *names) for names in _EXTENTS), default=0)


def _end(tags: dict[str, Any], offsets: str, counts: str) -> int:
    if offsets not in tags or counts not in tags:
        return 0
    parts = zip(tags[offsets].values, tags[counts].values, strict=False)
    return max((offset + count for offset, count in parts), default=0)


def _jpeg_extent(data: bytes) -> int:
    """Bytes up to the end of the image; one more than there are where it is cut, 0 where no image begins."""
    at = 2
    while at + 4 <= len(data) and data[at] == _JPEG[0]:
        length = int.from_bytes(data[at + 2 : at + 4], "big")
        if data[at + 1] == _SCAN:  # a preview's end lies in the segments before
            end = data.find(_END, at + 2 + length)
            return end + 2 if end >= 0 else len(data) + 1
        at += 2 + length
    return 0 if at + 4 <= len(data) else len(data) + 1
