"""Colours of JPEG files whose colour was stored at half the pixels (4:2:0)."""

import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float64

# ITU-T T.871; the two colour differences are in proportion to blue and red less luma.
_LUMA = np.array([0.299, 0.587, 0.114])
_MOST = 4.0  # times the mixed colour
_DARK = 8.0  # codes: luma under it does not say how the colour was shared


def unmixed_colours(srgb8: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A decoded picture (h, w, 3) with the colour of each four pixels shared out in proportion to their luma.

    A JPEG of 4:2:0 has one colour for four pixels, the mean of theirs: beside a dark pixel a bright one loses colour,
    and red of a red lamp counts as white. Light of one colour has colour differences in proportion to its luma, so what
    was averaged with the luma is divided by the same average of the luma, and multiplied by the pixel's own.
    """
    codes = srgb8.astype(np.float64)
    luma = codes @ _LUMA
    mixed = _spread(_mean_of_four(luma))[: luma.shape[0], : luma.shape[1]]
    gain = np.clip((luma + _DARK) / (mixed + _DARK), 0.0, _MOST)
    blue, red = ((codes[..., i] - luma) * gain for i in (2, 0))
    green = luma - (_LUMA[0] * red + _LUMA[2] * blue) / _LUMA[1]
    return np.asarray(np.rint(np.clip(np.stack([luma + red, green, luma + blue], axis=-1), 0, 255)), np.uint8)


def _mean_of_four(picture: Float64) -> Float64:
    """Means (h / 2, w / 2), rounded up, of squares of four; the last row and column stand in for what is missing."""
    height, width = picture.shape
    even = np.pad(picture, ((0, height % 2), (0, width % 2)), mode="edge")
    return np.asarray(even.reshape(even.shape[0] // 2, 2, even.shape[1] // 2, 2).mean(axis=(1, 3)))


def _spread(halves: Float64) -> Float64:
    """Twice as many rows and columns, as decoders make them: three parts of the nearest, one of the next."""
    for axis in (0, 1):
        before, after = (np.concatenate([halves.take([0], axis), halves], axis), np.concatenate(
            [halves, halves.take([-1], axis)], axis))  # fmt: skip
        count = halves.shape[axis]
        low = 0.75 * halves + 0.25 * before.take(range(count), axis)
        high = 0.75 * halves + 0.25 * after.take(range(1, count + 1), axis)
        shape = list(halves.shape)
        shape[axis] *= 2
        halves = np.stack([low, high], axis=axis + 1).reshape(shape)
    return halves
