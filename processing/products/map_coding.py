"""Eigenmaps as codes of one or two bytes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32, Int32

Maps = NDArray[np.float32] | NDArray[np.float16] | NDArray[np.uint8]
_CODES = 255


@dataclass(frozen=True, eq=False)
class MapCoding:
    """Value = `least` + `step` * code, both (k, light) float32: a map and light has a range of its own."""

    least: Float32
    step: Float32

    def decode(self, codes: Maps, k: int, lights: Int32 | slice) -> Float32:
        """Values of codes of eigenmap `k`; `lights` name the light of each, or of each along the first axis."""
        least, step = self.least[k, lights], self.step[k, lights]
        if isinstance(lights, slice):
            least, step = (some.reshape(-1, *[1] * (codes.ndim - 1)) for some in (least, step))
        else:
            least, step = least[..., None], step[..., None]
        return np.asarray(least + step * codes.astype(np.float32), np.float32)


def encode(maps: Float32, kind: type[np.uint8] | type[np.float16]) -> tuple[Maps, MapCoding]:
    """Codes of maps (k, light, y, x, channel), and what they mean.

    uint8 divides the range of each map and light evenly, which leaves half a 255th of it; float16 is a share of the
    largest value, to 2^-11 of itself.
    """
    least, step = np.zeros((2, *maps.shape[:2]), np.float32)
    codes: Maps = np.empty(maps.shape, np.dtype(kind))
    for k, light in np.ndindex(maps.shape[:2]):
        values = maps[k, light].astype(np.float64)
        if kind is np.uint8:
            least[k, light] = values.min()
            step[k, light] = (values.max() - least[k, light]) / _CODES or 1.0
            codes[k, light] = np.clip(np.rint((values - least[k, light]) / step[k, light]), 0, _CODES)
        else:
            step[k, light] = np.abs(values).max() or 1.0
            codes[k, light] = values / step[k, light]
    return codes, MapCoding(least, step)
