"""A DNG written from an array: the smallest TIFF 6.0 file with the DNG 1.4 tags that processing reads."""

import struct
from fractions import Fraction

import numpy as np

_SIZE = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 10: 8, 12: 8}


def _pack(kind, values):
    if kind in (1, 2):
        return bytes(values)
    if kind in (5, 10):
        fractions = [Fraction(v).limit_denominator(10_000_000) for v in values]
        flat = [n for f in fractions for n in (f.numerator, f.denominator)]
        return struct.pack(f"<{len(flat)}{'I' if kind == 5 else 'i'}", *flat)
    return struct.pack(f"<{len(values)}{ {3: 'H', 4: 'I', 12: 'd'}[kind] }", *values)


def _directory(entries, offset):
    """Bytes of one image file directory that starts at `offset`, long values behind it."""
    head, tail = struct.pack("<H", len(entries)), b""
    after = offset + 2 + 12 * len(entries) + 4
    for tag, kind, values in sorted(entries):
        data = _pack(kind, values)
        count = len(data) // _SIZE[kind]
        if len(data) > 4:
            head += struct.pack("<HHII", tag, kind, count, after + len(tail))
            tail += data + b"\0" * (len(data) % 2)
        else:
            head += struct.pack("<HHI", tag, kind, count) + data.ljust(4, b"\0")
    return head + struct.pack("<I", 0) + tail


def dng(mosaic, *, exposure_s=0.1, black=(256,), white=4095, noise_profile=None, serial="T-1", unique_id="1", iso=100):
    """Bytes of an uncompressed RGGB DNG of `mosaic` (h, w) uint16."""
    height, width = mosaic.shape
    pixels = np.ascontiguousarray(mosaic, "<u2").tobytes()
    exif = [(0x829A, 5, [exposure_s]), (0x829D, 5, [4]), (0x8827, 3, [iso]), (0xA420, 2, unique_id.encode() + b"\0")]
    entries = [
        (0x00FE, 4, [0]), (0x0100, 4, [width]), (0x0101, 4, [height]), (0x0102, 3, [16]), (0x0103, 3, [1]),
        (0x0106, 3, [32803]), (0x010F, 2, b"Test\0"), (0x0110, 2, b"Array\0"), (0x0112, 3, [1]),
        (0x0115, 3, [1]), (0x0116, 4, [height]), (0x0117, 4, [len(pixels)]), (0x011C, 3, [1]), (0x828D, 3, [2, 2]),
        (0x828E, 1, [0, 1, 1, 2]), (0xC612, 1, [1, 4, 0, 0]), (0xC613, 1, [1, 1, 0, 0]), (0xC614, 2, b"Test Array\0"),
        (0xC619, 3, [2, 2] if len(black) == 4 else [1, 1]), (0xC61A, 3, list(black)), (0xC61D, 3, [white]),
        (0xC621, 10, [1, 0, 0, 0, 1, 0, 0, 0, 1]), (0xC628, 5, [0.5, 1, 0.8]), (0xC62F, 2, serial.encode() + b"\0"),
        (0xC65A, 3, [21]),
    ]  # fmt: skip
    if noise_profile is not None:
        entries.append((0xC761, 12, list(noise_profile)))

    def directories(exif_at, pixels_at):
        image = [*entries, (0x8769, 4, [exif_at]), (0x0111, 4, [pixels_at])]
        first = _directory(image, 8)
        return first, first + _directory(exif, 8 + len(first))

    first, both = directories(0, 0)
    _, both = directories(8 + len(first), 8 + len(both))
    return struct.pack("<2sHI", b"II", 42, 8) + both + pixels
