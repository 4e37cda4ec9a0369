"""Environments from OpenEXR and Radiance (.hdr) files."""

from pathlib import Path

import cv2
import numpy as np
import OpenEXR

from render.arrays import Float32
from render.environment import Environment
from render.errors import SceneError


def load_environment(path: Path, *, azimuth_rad: float = 0.0) -> Environment:
    """An equirectangular environment, its middle at an azimuth from +X toward +Y.

    Values a little under zero, which compression and colours beyond the primaries leave, count as none.
    Raises SceneError where the file is missing, no such picture, not twice as wide as high, or holds no numbers.
    """
    if not path.is_file():
        raise SceneError(f"{path}: no such file")
    read = _exr if path.suffix.lower() == ".exr" else _radiance
    radiance = read(path)
    try:
        return Environment(np.maximum(radiance, np.float32(0.0)), azimuth_rad)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error


def _exr(path: Path) -> Float32:
    try:
        with OpenEXR.File(str(path)) as image:
            channels = image.channels()
            colour = channels["RGB"] if "RGB" in channels else channels["RGBA"]
            return np.asarray(colour.pixels, np.float32)[:, :, :3]
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        raise SceneError(f"{path}: not an OpenEXR picture with channels R, G and B") from error


def _radiance(path: Path) -> Float32:
    try:
        picture = cv2.imread(str(path), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
    except cv2.error:
        picture = None
    if picture is None or picture.dtype != np.float32:
        raise SceneError(f"{path}: not a picture of linear light; an environment is .exr or .hdr")
    return np.asarray(picture[:, :, ::-1], np.float32)
