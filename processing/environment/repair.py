"""Values of a panorama that are no numbers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.environment.poisson import fill
from processing.errors import ImageError
from processing.products.arrays import Float64

_MOST = 0.01


@dataclass(frozen=True, slots=True)
class Repaired:
    """A `picture` (h, w, 3) of finite numbers, and the `count` of values that were none."""

    picture: Float64
    count: int


def repair(picture: NDArray[np.floating]) -> Repaired:
    """Put something sensible where a linear picture (h, w, 3) is not finite.

    Positive infinity, which half floats give for a sun, becomes the picture's largest value: less light than there was.
    What is no number is filled smoothly from around it. Raises ImageError where that is over a hundredth of all values.
    """
    values = np.asarray(picture, np.float64)
    bad = ~np.isfinite(values)
    count = int(np.count_nonzero(bad))
    if count == 0:
        return Repaired(values, 0)
    if count > _MOST * values.size:
        raise ImageError(f"{count} of {values.size} values are no numbers; write the picture again")
    bright = np.isposinf(values)
    values = np.where(bright, values[~bad].max(), values)
    unknown = np.asarray(~np.isfinite(values).all(axis=-1), np.bool_)
    return Repaired(fill(values, unknown), count)
