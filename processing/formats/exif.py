"""Tags of TIFF and EXIF, as plain numbers and text."""

import io
import logging
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any

import exifread
import numpy as np

logging.getLogger("exifread").addHandler(logging.NullHandler())  # else it complains on standard error by itself
_LABEL_TOLERANCE = 0.08  # shutter dials round: 1/30 stands for 1/32, 1/15 for 1/16


def read_tags(content: bytes) -> dict[str, Any]:
    """Values of all tags by bare name, unknown ones as '0xC761'; the first directory that has a tag wins.

    A file that carries none, or damaged ones, gives what could be read: whether it is an image is for its decoder.
    """
    try:
        found = exifread.process_file(io.BytesIO(content), details=False, extract_thumbnail=False)
    except (ValueError, IndexError, KeyError, TypeError, OverflowError, MemoryError):
        return {}
    values: dict[str, Any] = {}
    for key, tag in found.items():
        value = getattr(tag, "values", tag)
        if isinstance(value, list):  # floating-point numbers come as tuples of one each
            value = [item[0] if isinstance(item, tuple) else item for item in value]
        values.setdefault(key.split(" ")[-1], value)
    return values


def number(tags: dict[str, Any], name: str) -> float:
    """First value of a numeric tag, NaN where there is none."""
    values = tags.get(name)
    if not isinstance(values, Iterable) or isinstance(values, str | bytes):
        return float("nan")
    try:
        return float(next(iter(values), float("nan")))
    except ZeroDivisionError:
        return float("nan")


def text(tags: dict[str, Any], name: str) -> str:
    """A tag as text, empty where there is none."""
    value = tags.get(name, "")
    decoded = value if isinstance(value, str) else bytes(value).decode("ascii", "replace")
    return decoded.strip("\0 ")


def exposure_s(tags: dict[str, Any]) -> float:
    """Exposure time, NaN where there is none.

    ExposureTime of a photograph is what the dial says; where ShutterSpeedValue (APEX: time = 2^-value, EXIF 2.32,
    annex C) agrees with it up to the dial's rounding, that is the time of the shutter.
    """
    label = number(tags, "ExposureTime")
    shutter = float(np.exp2(-np.clip(number(tags, "ShutterSpeedValue"), -60, 60)))
    return shutter if abs(shutter - label) < _LABEL_TOLERANCE * label else label


def taken_s(tags: dict[str, Any]) -> float:
    """When a photograph was taken, in seconds by the camera's clock; NaN where it is not told."""
    try:
        taken = datetime.strptime(text(tags, "DateTimeOriginal"), "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        return float("nan")
    part = text(tags, "SubSecTimeOriginal")
    return taken.timestamp() + (float(f"0.{part}") if part.isdecimal() else 0.0)
