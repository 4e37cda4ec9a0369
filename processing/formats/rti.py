"""Hemispherical harmonics as Reflectance Transformation Imaging keeps them: .rti files of kind HSH.

A text header after a comment line, `#HSH1.2`: the kind 3; width, height, channels; terms, basis 2, bytes of an element.
Then a scale and an offset of each term, little-endian float32, and for every pixel from the top, every channel, every
term a byte: coefficient = byte / 255 * scale + offset. Values are 0 to 1, terms those of Gautron et al. 2004 in the
order of their azimuth's cosines and sines, those of cos(2 phi) and sin(2 phi) negative.
"""

import re
from pathlib import Path

import numpy as np

from processing.errors import ImageError
from processing.formats.coefficient_bytes import TOP, Steps, to_bytes, value_range
from processing.formats.ptm import file_content, pixel_bytes
from processing.products import RelightableImage, ResidualBasis

# Places of the file's terms among ours, which run from -l to l, and their signs, the same in both orders.
ORDER = (0, 3, 2, 1, 8, 7, 6, 5, 4)
SIGNS = np.array([1, 1, 1, 1, -1, 1, 1, 1, -1], np.float64)
_HEADER = re.compile(rb"#HSH1\.2[^\n]*\n(?:#[^\n]*\n)*3\s+(\d+)\s+(\d+)\s+(\d+)\s+(\d+)\s+(\d+)\s+(\d+) ?\r?\n")
_TERMS = (4, 9)


def write_rti(path: Path, image: RelightableImage) -> None:
    """Write an image over hemispherical harmonics, nine terms.

    Raises ImageError where the image is over another basis, or has a colour of its own.
    """
    if image.basis is not ResidualBasis.HEMISPHERICAL or image.colour is not None:
        raise ImageError(f"{path}: a .rti holds three channels of hemispherical harmonics; fit those to the pictures")
    ranges = np.array([value_range(sign * values) for sign, values in zip(SIGNS, image.coefficients, strict=True)])
    offset = ranges[:, 0].astype("<f4")
    scale = np.maximum(ranges[:, 1] - offset, 1e-9).astype("<f4")
    codes = to_bytes(image, Steps(SIGNS * scale / TOP, SIGNS * offset))[list(ORDER)]
    header = f"#HSH1.2\n3\n{codes.shape[2]} {codes.shape[1]} 3\n{len(ORDER)} 2 1\n".encode("ascii")
    order = list(ORDER)
    path.write_bytes(header + scale[order].tobytes() + offset[order].tobytes() + np.moveaxis(codes, 0, -1).tobytes())


def read_rti(path: Path) -> RelightableImage:
    """Read a .rti of kind HSH with four or nine terms and three channels.

    Raises ImageError where the file is missing, truncated or of another kind.
    """
    content = file_content(path)
    header = _HEADER.match(content)
    if header is None:
        raise ImageError(f"{path}: not hemispherical harmonics: no header #HSH1.2 of kind 3 with size and terms.")
    width, height, channels, terms, _, element = (int(token) for token in header.groups())
    if channels != 3 or terms not in _TERMS or element != 1:
        raise ImageError(
            f"{path}: {terms} terms, {channels} channels, {element} bytes an element; 4 or 9, 3 and 1 are read."
        )
    start = header.end() + 8 * terms
    numbers = np.frombuffer(content[header.end() : start].ljust(8 * terms, b"\0"), "<f4").astype(np.float64)
    codes = pixel_bytes(path, content[start:], (height, width), 3 * terms).reshape(height, width, 3, terms)
    values = Steps(numbers[:terms] / TOP, numbers[terms:]).values(codes) * SIGNS[:terms]
    coefficients = np.zeros((len(ORDER), height, width, 3), np.float32)
    coefficients[list(ORDER[:terms])] = np.moveaxis(values, -1, 0)
    return RelightableImage(coefficients, ResidualBasis.HEMISPHERICAL)
