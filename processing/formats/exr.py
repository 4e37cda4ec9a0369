"""OpenEXR files: linear images with named float32 layers and text beside them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from processing.errors import ImageError

Image = NDArray[np.float32]
_COLOURS = ("R", "G", "B")


@dataclass(frozen=True)
class ExrImage:
    """`image` (h, w) or (h, w, 3), further `layers` of the same height and width by name, `metadata` as text."""

    image: Image
    layers: Mapping[str, Image] = field(default_factory=dict)
    metadata: Mapping[str, str] = field(default_factory=dict)


def write_exr(path: Path, exr: ExrImage) -> None:
    """Write float32 channels, losslessly compressed: R, G, B or Y of the image, name.R ... or name.Y of each layer.

    Raises ImageError where a layer's shape does not fit or the file cannot be written.
    """
    channels: dict[str, Image] = {}
    for name, layer in {"": exr.image, **exr.layers}.items():
        if layer.shape[:2] != exr.image.shape[:2] or (layer.ndim != 2 and layer.shape[2:] != (3,)):
            raise ImageError(f"{path}: layer {name!r} of shape {layer.shape} beside an image of {exr.image.shape}.")
        prefix = f"{name}." if name else ""
        planes = {"Y": layer} if layer.ndim == 2 else {c: layer[..., i] for i, c in enumerate(_COLOURS)}
        channels |= {prefix + key: np.ascontiguousarray(plane, np.float32) for key, plane in planes.items()}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **exr.metadata}
    try:
        with OpenEXR.File(header, channels) as file:
            file.write(str(path))
    except (RuntimeError, OSError) as error:
        raise ImageError(f"{path}: cannot be written: {error}") from error


def read_exr(path: Path) -> ExrImage:
    """Inverse of `write_exr`; of other writers' files, the channels R G B or Y and layers of the same kind.

    Raises ImageError that names the file where it is missing, damaged or has no such image.
    """
    if not path.is_file():
        raise ImageError(f"{path}: no such file.")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            planes = {name: np.asarray(channel.pixels, np.float32) for name, channel in file.channels().items()}
            metadata = {key: value for key, value in file.header().items() if isinstance(value, str)}
    except (RuntimeError, OSError, ValueError) as error:
        raise ImageError(f"{path}: not a readable OpenEXR file: {error}") from error
    prefixes = sorted({name.rpartition(".")[0] for name in planes})
    layers = {prefix: layer for prefix in prefixes if (layer := _layer(planes, prefix)) is not None}
    if "" not in layers:
        raise ImageError(f"{path}: has neither R, G, B nor Y, but {', '.join(planes)}.")
    return ExrImage(layers.pop(""), layers, metadata)


def _layer(planes: Mapping[str, Image], prefix: str) -> Image | None:
    names = [f"{prefix}.{c}" if prefix else c for c in _COLOURS]
    if all(name in planes for name in names):
        return np.stack([planes[name] for name in names], axis=-1)
    return planes.get(f"{prefix}.Y" if prefix else "Y")
