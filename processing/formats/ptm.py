"""Polynomial texture maps, .ptm version 1.2 (Malzbender and Gelb, "Polynomial Texture Map (.ptm) File Format", 2001).

A text header of format, size, six scales and six biases, then bytes: coefficient = (byte - bias) * scale, in codes of 0
to 255 and in the order u^2, v^2, uv, u, v, 1. Rows run from the bottom to the top. RGB: all of red, then green, then
blue, six bytes a pixel. LRGB: six bytes a pixel of luminance, then R, G, B of every pixel; the two are multiplied.
"""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.formats.coefficient_bytes import TOP, Bytes, Steps, to_bytes, value_range
from processing.products import RelightableImage, ResidualBasis
from processing.products.arrays import Float32, Float64

# Places of the file's coefficients among 1, u, v, u^2, uv, v^2.
_ORDER = (3, 5, 4, 1, 2, 0)
_RGB, _LRGB = "PTM_FORMAT_RGB", "PTM_FORMAT_LRGB"
_HEADER = re.compile(rb"PTM_1\.([0-2])\s+(\w+)\s+" + rb"\s+".join([rb"([-+.\w]+)"] * 14) + rb" ?\r?\n")


def write_ptm(path: Path, image: RelightableImage) -> None:
    """Write a biquadratic image: RGB, or LRGB where it has a colour of its own.

    Raises ImageError where the image is over another basis.
    """
    if image.basis is not ResidualBasis.BIQUADRATIC:
        raise ImageError(f"{path}: a .ptm holds a biquadratic image, not one over {image.basis}; write .rti instead")
    steps, scale, bias = _steps(image)
    codes = to_bytes(image, steps)[list(_ORDER), ::-1]
    height, width = codes.shape[1:3]
    header = [
        "PTM_1.2", _RGB if image.colour is None else _LRGB, f"{width}", f"{height}",
        " ".join(map(_text, scale[list(_ORDER)])), " ".join(f"{b:d}" for b in bias[list(_ORDER)]),
    ]  # fmt: skip
    parts = [("\n".join(header) + "\n").encode("ascii"), np.moveaxis(codes, (3, 0), (0, 3)).tobytes()]
    if image.colour is not None:
        parts.append(np.rint(np.clip(image.colour[::-1], 0, 1) * TOP).astype(np.uint8).tobytes())
    path.write_bytes(b"".join(parts))


def _steps(image: RelightableImage) -> tuple[Steps, Float64, NDArray[np.int64]]:
    """Steps of the coefficients, and what the header says of them: scales of codes, whole biases."""
    ranges = np.array([value_range(values) for values in image.coefficients])
    low, high = np.minimum(ranges[:, 0], 0), np.maximum(ranges[:, 1], 0)
    # One step is for the bias, which is whole; the steps are those of the header's decimals.
    scale = np.array([float(_text(s)) for s in np.maximum((high - low) / (TOP - 1), 1e-9) * TOP])
    bias = np.ceil(-low * TOP / scale).astype(np.int64)
    return Steps(scale / TOP, -bias * scale / TOP), scale, bias


def _text(number: float) -> str:
    return f"{number:.9g}"


def read_ptm(path: Path) -> RelightableImage:
    """Read a .ptm of format RGB or LRGB, versions 1.0 to 1.2.

    Raises ImageError where the file is missing, truncated, of another kind, or compressed with JPEG.
    """
    content = file_content(path)
    header = _HEADER.match(content)
    if header is None:
        raise ImageError(f"{path}: not a polynomial texture map: no header PTM_1.2 with its size, scales and biases.")
    old, kind = header[1] != b"2", header[2].decode("ascii")
    if kind not in (_RGB, _LRGB):
        raise ImageError(f"{path}: of format {kind}; {_RGB} and {_LRGB} are read. Save it without compression.")
    try:
        width, height = int(header[3]), int(header[4])
        scale, bias = (np.array([float(token) for token in header.groups()[i : i + 6]]) for i in (4, 10))
    except ValueError as error:
        raise ImageError(f"{path}: its header says {error} where a number is needed.") from error
    steps = Steps(scale / TOP, -bias * scale / TOP)
    pixels = pixel_bytes(path, content[header.end() :], (height, width), 18 if kind == _RGB else 9)
    if kind == _RGB:
        codes = pixels.reshape(3, height, width, 6)
        return _image(codes, steps)
    if old:
        coefficients, colour = np.split(pixels.reshape(height, width, 9), [6], axis=-1)
    else:
        coefficients, colour = (part.reshape(height, width, -1) for part in np.split(pixels, [6 * width * height]))
    return _image(coefficients[None], steps, (colour[::-1] / np.float32(TOP)).astype(np.float32))


def file_content(path: Path) -> bytes:
    """All of a file; raises ImageError where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise ImageError(f"{path}: cannot be read ({error.strerror}).") from error


def pixel_bytes(path: Path, content: bytes, size: tuple[int, int], bytes_per_pixel: int) -> Bytes:
    """The bytes of height x width pixels; raises ImageError where there are fewer."""
    expected = size[0] * size[1] * bytes_per_pixel
    if not 0 < expected <= len(content):
        raise ImageError(
            f"{path}: {size[1]} x {size[0]} pixels need {expected} bytes, but {len(content)} follow. Copy it again."
        )
    return np.frombuffer(content, np.uint8, expected)


def _image(codes: Bytes, steps: Steps, colour: Float32 | None = None) -> RelightableImage:
    """From bytes (channel, y from the bottom, x, 6)."""
    values = np.moveaxis(steps.values(codes)[:, ::-1], (3, 0), (0, 3))
    in_order = np.empty(values.shape, np.float32)
    in_order[list(_ORDER)] = values
    return RelightableImage(in_order, ResidualBasis.BIQUADRATIC, colour)
