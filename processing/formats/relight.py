"""Relightable images for web viewers: a folder with info.json and coefficient planes as JPEG, as Relight writes it.

OpenLIME and other viewers of that project open it. Each JPEG holds three planes: of RGB, one coefficient of the three
channels; of LRGB, which is read only, first the colour, then three coefficients each. Coefficient = (byte / 255 - bias)
* scale, display values 0 to 1, in the order 1, x, y, x^2, xy, y^2, or the terms of a .rti. Row 0 is the top.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from processing.errors import ImageError
from processing.formats import rti
from processing.formats.coefficient_bytes import TOP, Bytes, Steps, to_bytes, value_range
from processing.products import RelightableImage, ResidualBasis
from processing.products.arrays import Float32, Float64

INFO = "info.json"
QUALITY = 95  # of JPEG; what it costs is a row of `rig bench srf`
_TYPES = {ResidualBasis.BIQUADRATIC: "ptm", ResidualBasis.HEMISPHERICAL: "hsh"}


def write_relight(folder: Path, image: RelightableImage) -> None:
    """Write info.json and plane_0.jpg and so on into `folder`, which is made.

    Raises ImageError for images with a colour of their own: OpenLIME makes their luminance the transparency too.
    """
    if image.colour is not None:
        raise ImageError(f"{folder}: web viewers show luminance times colour wrongly; write it as .ptm")
    pictures, scale, bias = _planes(image)
    folder.mkdir(parents=True, exist_ok=True)
    for number, picture in enumerate(pictures):
        Image.fromarray(np.ascontiguousarray(picture)).save(
            folder / f"plane_{number}.jpg", quality=QUALITY, subsampling="4:4:4", keep_rgb=True
        )
    description = {
        "width": image.coefficients.shape[2], "height": image.coefficients.shape[1], "format": "jpg",
        "type": _TYPES[image.basis], "colorspace": "rgb", "nplanes": 3 * len(pictures),
        "quality": QUALITY, "materials": [{"scale": _listed(scale), "bias": _listed(bias)}],
    }  # fmt: skip
    if image.lights is not None:
        description["lights"] = _listed(image.lights)
    (folder / INFO).write_text(json.dumps(description, indent=1) + "\n", encoding="utf-8")


def _planes(image: RelightableImage) -> tuple[Bytes, Float64, Float64]:
    """A picture (y, x, 3) for each term, and scale and bias of every plane (term, channel)."""
    order, signs = _terms(image.basis)
    planes = np.moveaxis(image.coefficients, -1, 1) * signs[:, None, None, None].astype(np.float32)
    ranges = np.array([[value_range(plane) for plane in term] for term in planes])  # (k, channel, 2)
    low, scale = ranges[..., 0], np.maximum(np.ptp(ranges, axis=-1), 1e-9)
    codes = to_bytes(image, Steps(signs[:, None] * scale / TOP, signs[:, None] * low))
    return codes[order], scale[order], -low[order] / scale[order]


def _terms(basis: ResidualBasis) -> tuple[list[int], Float64]:
    """Places of the file's terms among ours, and the signs of ours."""
    if basis is ResidualBasis.HEMISPHERICAL:
        return list(rti.ORDER), rti.SIGNS
    return list(range(basis.size)), np.ones(basis.size)


def _listed(values: Float64) -> list[float]:
    return [float(f"{value:.9g}") for value in np.ravel(values)]


def read_relight(folder: Path) -> RelightableImage:
    """Read a folder of type ptm or hsh, colour space rgb or lrgb, with whole JPEG planes (no tiles).

    Raises ImageError where a file is missing, damaged, or of another kind.
    """
    info = _info(folder / INFO)
    basis = {name: basis for basis, name in _TYPES.items()}.get(str(info.get("type")))
    if basis is None or info.get("colorspace") not in ("rgb", "lrgb"):
        told = f"{info.get('type')} in {info.get('colorspace')}"
        raise ImageError(f"{folder / INFO}: {told}; ptm and hsh in rgb or lrgb are read.")
    try:
        count, material = int(info["nplanes"]), info["materials"][0]
        scale, bias = (np.array(material[name], np.float64) for name in ("scale", "bias"))
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise ImageError(f"{folder / INFO}: has no planes with scale and bias ({error})") from error
    if count not in (3 + basis.size, 3 * basis.size) or scale.shape != (count,) or bias.shape != (count,):
        raise ImageError(f"{folder / INFO}: {count} planes with {scale.size} scales do not make a {info['type']}")
    planes = [_plane(folder / f"plane_{n}.jpg") for n in range(count // 3)]
    if len({plane.shape for plane in planes}) > 1:
        raise ImageError(f"{folder}: its planes are not of one size; copy it again")
    return _image(basis, Steps(scale / TOP, -bias * scale).values(np.concatenate(planes, axis=-1)))


def _image(basis: ResidualBasis, planes: Float32) -> RelightableImage:
    """From values (y, x, plane)."""
    order, signs = _terms(basis)
    colour = planes[..., :3] if planes.shape[-1] == 3 + basis.size else None
    terms = planes.reshape(*planes.shape[:2], -1, 3) if colour is None else planes[..., 3:, None]
    coefficients = np.empty((basis.size, *planes.shape[:2], terms.shape[-1]), np.float32)
    coefficients[order] = np.moveaxis(terms, 2, 0) * signs[:, None, None, None]
    return RelightableImage(coefficients, basis, colour)


def _info(path: Path) -> Mapping[str, Any]:
    try:
        info = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ImageError(f"{path}: not the description of a relightable image ({error})") from error
    if not isinstance(info, dict):
        raise ImageError(f"{path}: not the description of a relightable image")
    return info


def _plane(path: Path) -> Bytes:
    try:
        with Image.open(path) as picture:
            return np.asarray(picture.convert("RGB"))
    except (OSError, ValueError, SyntaxError) as error:
        raise ImageError(f"{path}: not a readable plane ({error}); tiled folders are not read") from error
