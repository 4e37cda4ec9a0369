"""Camera RAW files: the untouched mosaic with everything that its radiometry needs."""

import io
import mmap
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import rawpy
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.formats import exif, tiff
from processing.radiometry.sensor import Sensor

ASSUMED_GAIN_E_PER_DN = 1.0
ASSUMED_READ_NOISE_DN = 2.0
_HEAD_ROWS = 32  # LibRaw refuses images of less than 22
_NOISE_PROFILE = "0xC761"  # DNG specification 1.7, tag numbers
_CAMERA_SERIAL = "0xC62F"
_UNIQUE_MODEL = "0xC614"
_COLOR_MATRIX = "0xC621"


@dataclass(frozen=True, slots=True)
class RawImage:
    """One frame as the sensor gave it.

    `mosaic` (h, w) uint16 raw_dn; `cfa` (2, 2) with 0 red, 1 green, 2 blue; `white_balance` (3,) as shot, green = 1;
    `camera_from_xyz` (3, 3), zero where the file has none; `exposure_s` NaN where the file has none.
    """

    mosaic: NDArray[np.uint16]
    cfa: NDArray[np.uint8]
    sensor: Sensor
    exposure_s: float
    iso: float
    f_number: float
    serial: str
    model: str
    unique_id: str
    white_balance: NDArray[np.float64]
    camera_from_xyz: NDArray[np.float64]


def read_raw(source: Path | bytes) -> RawImage:
    """Decode a DNG or another Bayer RAW file, given by path or as its bytes.

    Gain and read noise come from the DNG tag NoiseProfile. A camera without it gets gain 1 e-/dn and 2 dn of read
    noise, and `sensor.assumed` is set. Where the channels' black levels differ, counts are shifted to a common one.
    Raises ImageError that names the file where it is missing, truncated or not a Bayer RAW file.
    """
    name = "frame" if isinstance(source, bytes) else str(source)
    content = source if isinstance(source, bytes) else _read(source)
    tags = exif.read_tags(content)
    _check_whole(name, content, tags)
    try:
        with rawpy.imread(io.BytesIO(content)) as raw:
            return _raw_image(raw, tags)
    except (rawpy.LibRawError, rawpy.NotSupportedError) as error:
        raise ImageError(
            f"{name}: not a readable RAW image ({_text(error)}): truncated, or not RAW. Copy or take it again."
        ) from error
    except ImageError as error:
        raise ImageError(f"{name}: {error}") from error


def map_raw(path: Path) -> RawImage:
    """Read a RAW file like `read_raw`, but leave the samples of an uncompressed DNG where they are.

    Its `mosaic` is then a read-only view of the file: the system fetches the pages that are touched, no others, and
    the file must not be cut meanwhile. Every number about it is LibRaw's, from the same tags over the first rows
    alone. Any other file is decoded whole, also where LibRaw changes the samples: crop, linearisation, black levels
    of the channels that differ. Raises what `read_raw` raises.
    """
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            block = tiff.sample_block(content)
            if block is None or block.end > len(content) or block.shape[0] <= _HEAD_ROWS:
                return read_raw(path)
            head = read_raw(tiff.first_rows(content, block, _HEAD_ROWS))
    except (OSError, ValueError, ImageError):
        return read_raw(path)  # which says what is wrong with it, by its name
    samples: NDArray[np.uint16] = np.memmap(path, np.uint16, mode="r", offset=block.start, shape=block.shape)
    same = np.array_equal(head.mosaic, samples[:_HEAD_ROWS])
    return replace(head, mosaic=samples) if same else read_raw(path)


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ImageError(f"{path}: cannot be read: {error.strerror}.") from error


def _check_whole(name: str, content: bytes, tags: dict[str, Any]) -> None:
    """Refuse a file that was cut off before LibRaw does, which also writes about it to standard error."""
    starts, counts = tags.get("StripOffsets"), tags.get("StripByteCounts")
    if not isinstance(starts, list) or not isinstance(counts, list):
        return
    end = max((start + count for start, count in zip(starts, counts, strict=False)), default=0)
    if end > len(content):
        raise ImageError(f"{name}: truncated: {len(content)} bytes where {end} are promised. Copy or take it again.")


def _text(error: Exception) -> str:
    message = error.args[0] if error.args else error
    return message.decode(errors="replace") if isinstance(message, bytes) else str(message)


def _raw_image(raw: rawpy.RawPy, tags: dict[str, Any]) -> RawImage:
    if raw.raw_pattern is None or raw.raw_pattern.shape != (2, 2) or raw.color_desc not in (b"RGBG", b"RGGB"):
        raise ImageError("not a Bayer mosaic; only cameras with a 2x2 RGB pattern can be used.")
    mosaic, black_dn, white_dn = _level(raw)
    cfa = np.where(raw.raw_pattern == 3, 1, raw.raw_pattern).astype(np.uint8)
    balance = np.asarray(raw.camera_whitebalance, np.float64)[:3]
    return RawImage(
        mosaic=mosaic,
        cfa=cfa,
        sensor=_sensor(tags, black_dn, white_dn),
        exposure_s=exif.exposure_s(tags),
        iso=exif.number(tags, "ISOSpeedRatings"),
        f_number=exif.number(tags, "FNumber"),
        serial=exif.text(tags, _CAMERA_SERIAL) or exif.text(tags, "BodySerialNumber"),
        model=exif.text(tags, _UNIQUE_MODEL) or exif.text(tags, "Model"),
        unique_id=exif.text(tags, "ImageUniqueID"),
        white_balance=balance / balance[1] if np.all(balance > 0) else np.ones(3),
        camera_from_xyz=_camera_from_xyz(raw, tags),
    )


def _camera_from_xyz(raw: rawpy.RawPy, tags: dict[str, Any]) -> NDArray[np.float64]:
    """LibRaw's matrix for the model, else the file's own ColorMatrix1."""
    known = np.asarray(raw.rgb_xyz_matrix, np.float64)[:3]
    own = [float(v) for v in tags.get(_COLOR_MATRIX, ())]
    return np.reshape(own, (3, 3)) if not known.any() and len(own) == 9 else known


def _level(raw: rawpy.RawPy) -> tuple[NDArray[np.uint16], float, float]:
    """Counts with one black and one white level for all channels: each channel shifted up to the highest black."""
    black = np.asarray(raw.black_level_per_channel, np.int64)
    shift = black.max() - black
    mosaic: NDArray[np.uint16] = np.array(raw.raw_image_visible, np.uint16)
    if shift.any():
        shifted = mosaic.astype(np.int64) + shift[raw.raw_colors_visible]
        mosaic = np.minimum(shifted, 65535).astype(np.uint16)
    return mosaic, float(black.max()), float(raw.white_level)


def _sensor(tags: dict[str, Any], black_dn: float, white_dn: float) -> Sensor:
    profile = np.asarray(tags.get(_NOISE_PROFILE, ()), np.float64)
    if profile.size < 2 or profile.size % 2:
        read_noise_e = ASSUMED_READ_NOISE_DN * ASSUMED_GAIN_E_PER_DN
        return Sensor(black_dn, white_dn, ASSUMED_GAIN_E_PER_DN, read_noise_e, assumed=True)
    slope, offset = profile.reshape(-1, 2).mean(axis=0)
    return Sensor.from_noise_profile(black_dn, white_dn, float(slope), float(offset))
