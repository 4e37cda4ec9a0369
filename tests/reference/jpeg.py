"""A grey JPEG as a camera writes it, with what EXIF says of it."""

import io
from fractions import Fraction

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

_EXIF_IFD, _TIME, _ISO, _TAKEN, _SUBSECOND, _SERIAL = 0x8769, 0x829A, 0x8827, 0x9003, 0x9291, 0xA431


def jpeg(codes, *, exposure_s=0.01, serial="PH-0001", iso=100, stamp=None):
    """Codes (h, w) at the best quality; what is None is not told."""
    exposure = None if exposure_s is None else Fraction(exposure_s).limit_denominator(100_000)
    told = {
        _TIME: None if exposure is None else IFDRational(exposure.numerator, exposure.denominator),
        _ISO: iso, _SERIAL: serial, _TAKEN: stamp and stamp[0], _SUBSECOND: stamp and stamp[1],
    }  # fmt: skip
    tags = Image.Exif()
    tags.get_ifd(_EXIF_IFD).update({tag: value for tag, value in told.items() if value is not None})
    content = io.BytesIO()
    Image.fromarray(np.asarray(codes, np.uint8)).save(content, "JPEG", quality=100, exif=tags)
    return content.getvalue()
