"""Camera raw files: one uncompressed Bayer mosaic in a TIFF container.

Source: Adobe, Digital Negative (DNG) Specification 1.4.0.0; TIFF revision 6.0; Exif 2.3 for the exposure's own tags.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

EPOCH = datetime(2026, 1, 1, 8, 0, 0, tzinfo=UTC)  # what the simulated cameras' clocks show at time 0

# TIFF 6.0, section 2, "Types": code, struct letter, size in bytes
_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _UNDEFINED, _SRATIONAL, _DOUBLE = 1, 2, 3, 4, 5, 7, 10, 12
_LETTERS = {_BYTE: "B", _SHORT: "H", _LONG: "I", _RATIONAL: "II", _SRATIONAL: "ii", _DOUBLE: "d"}

Entry = tuple[int, int, int, bytes]  # tag, type, count, value bytes


@dataclass(frozen=True)
class RawFile:
    """What a camera writes beside the pixels.

    `color_matrix` (3, 3) leads from XYZ to the camera's channels under D65, `neutral` is white in those channels,
    `noise_profile` is (S, O) on the range from black to white, `unique_id` has 32 hexadecimal digits.
    """

    serial: str
    model: str
    black_dn: int
    white_dn: int
    noise_profile: tuple[float, float]
    color_matrix: NDArray[np.float64]
    neutral: tuple[float, float, float]
    exposure_s: float
    iso: int
    f_number: float
    focal_length_mm: float
    time_s: float
    unique_id: str


def encode_dng(mosaic_dn: NDArray[np.uint16], raw: RawFile) -> bytes:
    """The DNG file of an RGGB mosaic (h, w)."""
    height, width = mosaic_dn.shape
    pixels = np.ascontiguousarray(mosaic_dn, "<u2").tobytes()
    exif = _exif_entries(raw)
    main = _main_entries(width, height, len(pixels), raw)
    exif_at = 8 + _ifd_size(main)
    pixels_at = exif_at + _ifd_size(exif)
    where = {0x0111: pixels_at, 0x8769: exif_at}
    main = [
        (tag, kind, count, struct.pack("<I", where[tag]) if tag in where else value) for tag, kind, count, value in main
    ]
    return b"".join([struct.pack("<2sHI", b"II", 42, 8), _ifd(main, 8), _ifd(exif, exif_at), pixels])


def _main_entries(width: int, height: int, size: int, raw: RawFile) -> list[Entry]:
    taken, _ = stamp(raw.time_s)
    return [
        _numbers(0x00FE, _LONG, [0]),  # NewSubFileType: the full image
        _numbers(0x0100, _LONG, [width]),
        _numbers(0x0101, _LONG, [height]),
        _numbers(0x0102, _SHORT, [16]),  # BitsPerSample
        _numbers(0x0103, _SHORT, [1]),  # Compression: none
        _numbers(0x0106, _SHORT, [32803]),  # PhotometricInterpretation: colour filter array
        _text(0x010F, "Virtual"),  # Make
        _text(0x0110, raw.model),
        _numbers(0x0111, _LONG, [0]),  # StripOffsets, filled in at the end
        _numbers(0x0112, _SHORT, [1]),  # Orientation: rows from the top
        _numbers(0x0115, _SHORT, [1]),  # SamplesPerPixel
        _numbers(0x0116, _LONG, [height]),  # RowsPerStrip
        _numbers(0x0117, _LONG, [size]),  # StripByteCounts
        _numbers(0x011C, _SHORT, [1]),  # PlanarConfiguration
        _text(0x0131, "appearance rig simulators"),  # Software
        _text(0x0132, taken),
        _numbers(0x828D, _SHORT, [2, 2]),  # CFARepeatPatternDim
        _numbers(0x828E, _BYTE, [0, 1, 1, 2]),  # CFAPattern: RG GB
        _numbers(0x8769, _LONG, [0]),  # Exif IFD, filled in at the end
        _numbers(0xC612, _BYTE, [1, 4, 0, 0]),  # DNGVersion
        _numbers(0xC613, _BYTE, [1, 3, 0, 0]),  # DNGBackwardVersion
        _text(0xC614, raw.model),  # UniqueCameraModel
        _numbers(0xC616, _BYTE, [0, 1, 2]),  # CFAPlaneColor
        _numbers(0xC617, _SHORT, [1]),  # CFALayout: rectangular
        _numbers(0xC619, _SHORT, [1, 1]),  # BlackLevelRepeatDim
        _numbers(0xC61A, _SHORT, [raw.black_dn]),  # BlackLevel
        _numbers(0xC61D, _SHORT, [raw.white_dn]),  # WhiteLevel
        _numbers(0xC61F, _LONG, [0, 0]),  # DefaultCropOrigin
        _numbers(0xC620, _LONG, [width, height]),  # DefaultCropSize
        _fractions(0xC621, _SRATIONAL, [round(float(x) * 10000) for x in raw.color_matrix.ravel()], 10000),
        _fractions(0xC628, _RATIONAL, [round(x * 10000) for x in raw.neutral], 10000),  # AsShotNeutral
        _text(0xC62F, raw.serial),  # CameraSerialNumber
        _numbers(0xC65A, _SHORT, [21]),  # CalibrationIlluminant1: D65
        _numbers(0xC761, _DOUBLE, raw.noise_profile),  # NoiseProfile, the same for all planes
    ]


def _exif_entries(raw: RawFile) -> list[Entry]:
    taken, subsecond = stamp(raw.time_s)
    exposure = Fraction(raw.exposure_s).limit_denominator(1_000_000)
    return [
        _numbers(0x829A, _RATIONAL, [exposure.numerator, exposure.denominator]),  # ExposureTime
        _fractions(0x829D, _RATIONAL, [round(raw.f_number * 10)], 10),  # FNumber
        _numbers(0x8827, _SHORT, [raw.iso]),  # PhotographicSensitivity
        (0x9000, _UNDEFINED, 4, b"0230"),  # ExifVersion
        _text(0x9003, taken),  # DateTimeOriginal
        _text(0x9291, subsecond),  # SubSecTimeOriginal
        _fractions(0x920A, _RATIONAL, [round(raw.focal_length_mm * 10)], 10),  # FocalLength
        _text(0xA420, raw.unique_id),  # ImageUniqueID
        _text(0xA431, raw.serial),  # BodySerialNumber
    ]


def stamp(time_s: float) -> tuple[str, str]:
    """Exif's date and time, and the microseconds that it leaves out."""
    moment = EPOCH + timedelta(seconds=time_s)
    return moment.strftime("%Y:%m:%d %H:%M:%S"), f"{moment.microsecond:06d}"


def _numbers(tag: int, kind: int, values: Sequence[float]) -> Entry:
    """`values` as that type; a rational takes two numbers, numerator and denominator."""
    letters = _LETTERS[kind]
    repeats = len(values) // len(letters)
    return tag, kind, repeats, struct.pack("<" + letters * repeats, *values)


def _fractions(tag: int, kind: int, numerators: Sequence[int], denominator: int) -> Entry:
    return _numbers(tag, kind, [number for top in numerators for number in (top, denominator)])


def _text(tag: int, text: str) -> Entry:
    value = text.encode("ascii") + b"\0"
    return tag, _ASCII, len(value), value


def _ifd_size(entries: Sequence[Entry]) -> int:
    outside = sum(len(value) + len(value) % 2 for *_, value in entries if len(value) > 4)
    return 2 + 12 * len(entries) + 4 + outside


def _ifd(entries: Sequence[Entry], offset: int) -> bytes:
    """One image file directory at this offset, values that do not fit into it behind (TIFF 6.0, section 2)."""
    rows, outside = [], b""
    value_at = offset + 2 + 12 * len(entries) + 4
    for tag, kind, count, value in sorted(entries):
        if len(value) <= 4:
            field = value.ljust(4, b"\0")
        else:
            field = struct.pack("<I", value_at + len(outside))
            outside += value + b"\0" * (len(value) % 2)
        rows.append(struct.pack("<HHI4s", tag, kind, count, field))
    return struct.pack("<H", len(entries)) + b"".join(rows) + struct.pack("<I", 0) + outside
