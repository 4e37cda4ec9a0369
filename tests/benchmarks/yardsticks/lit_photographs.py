"""Objects photographed by others under one light after another, as stacks of linear pictures.

`photometric-stereo`: gray sphere, chrome sphere and cat, 512 x 340, 12 lights (Seitz, University of Washington).
`psbox`: an object and two chrome spheres, 12 lights (Xiong, PSBox). Pictures of both are linear in light: on the gray
sphere the values are proportional to the cosine of incidence but for a few percent. No irradiance was measured: values
are shares of full scale, over pi.
"""

from pathlib import Path

import numpy as np
from PIL import Image
from scipy import ndimage

from processing.materials.chrome_sphere import light_directions, sphere_of_mask
from processing.materials.limb import SphereImage
from processing.products import LightStack
from tests.public_data import DATA

SEITZ, PSBOX = DATA / "photometric-stereo", DATA / "psbox"
LIGHTS = 12
CODE_SIGMA = 1.0  # of a pixel, in codes of 8 bit: rounding is 0.3 of it, the camera's noise was not told
BURNT = 254


def pictures(paths: list[Path]) -> np.ndarray:
    """Codes (light, y, x, 3)."""
    return np.stack([np.asarray(Image.open(path).convert("RGB")) for path in paths]).astype(np.float32)


def seitz_pictures(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Codes (light, y, x, 3) of `gray`, `chrome` or `cat`, and its mask (y, x)."""
    folder = SEITZ / name
    mask = np.asarray(Image.open(folder / f"{name}.mask.tga").convert("L")) > 127
    return pictures([folder / f"{name}.{number}.tga" for number in range(LIGHTS)]), mask


def seitz_lights() -> np.ndarray:
    """The directions (light, 3) that come with the pictures."""
    lights = np.loadtxt(SEITZ / "lights.txt", skiprows=1)
    return lights / np.linalg.norm(lights, axis=1, keepdims=True)


def psbox_pictures() -> np.ndarray:
    """Codes (light, y, x, 3) of the object."""
    return pictures([PSBOX / "Objects" / f"Image_{number:02d}.png" for number in range(1, LIGHTS + 1)])


def psbox_lights() -> np.ndarray:
    """The directions (light, 3) that come with the pictures."""
    return np.loadtxt(PSBOX / "light_directions.txt").T


def psbox_probe_lights(number: int) -> np.ndarray:
    """Directions (light, 3) by the highlights on one of the chrome spheres, whose circle comes with the pictures."""
    folder = PSBOX / f"LightProbe-{number}"
    probes = pictures([folder / f"Image_{light:02d}.JPG" for light in range(1, LIGHTS + 1)])
    column, up, radius = np.loadtxt(folder / "circle_data.txt")  # counted from 1, rows from the bottom
    centre = np.array([column - 1, probes.shape[1] - up])
    circle = SphereImage(centre, float(radius), np.eye(3), np.zeros((0, 2)))
    return light_directions(probes.mean(axis=-1), circle)


def stack_of_codes(codes: np.ndarray, lights: np.ndarray, mask: np.ndarray | None = None) -> LightStack:
    """A stack of pictures in codes; burnt pixels and those beside the mask are not measured."""
    missing = codes >= BURNT
    if mask is not None:
        missing |= ~mask[..., None]
    unit = 1 / (255 * np.pi)
    value = np.where(missing, np.nan, codes * unit).astype(np.float32)
    variance = np.full(codes.shape, (CODE_SIGMA * unit) ** 2, np.float32)
    return LightStack(value, variance, lights, np.full(len(lights), np.inf), 1e-4)


def psbox_mask(codes: np.ndarray) -> np.ndarray:
    """The object (y, x): the largest region that is bright under any light, without its border."""
    bright = codes.max(axis=(0, 3)) > 30
    regions, _ = ndimage.label(bright)
    object_ = regions == 1 + np.argmax(np.bincount(regions.ravel())[1:])
    return ndimage.binary_erosion(ndimage.binary_fill_holes(object_), iterations=2)


def sphere_normals(mask: np.ndarray) -> np.ndarray:
    """Normals (y, x, 3) of the sphere of a mask, seen from far away; NaN outside and within a pixel of its limb."""
    sphere = sphere_of_mask(mask)
    row, column = np.indices(mask.shape)
    x = (column - sphere.centre_px[0]) / sphere.radius_px
    y = (sphere.centre_px[1] - row) / sphere.radius_px
    squared = 1 - x**2 - y**2
    inside = np.hypot(x, y) < 1 - 1 / sphere.radius_px
    normals = np.stack([x, y, np.sqrt(np.maximum(squared, 0))], axis=-1)
    return np.where(inside[..., None], normals, np.nan)
