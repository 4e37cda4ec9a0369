"""Plain NumPy twin of the search for hot pixels."""

import warnings

import numpy as np

from processing.radiometry.defects import (
    ADJACENT_SHARE,
    ADJACENT_SIGMA,
    FRAME_PX,
    PEAK_RATIO,
    PEAK_SIGMA,
    TEXTURE_SIGMA,
)


def find_hot_pixels(value, variance):
    """Mask (h, w) by whole images shifted against each other."""
    wide = np.pad(value, 3, constant_values=np.nan)
    spread = np.pad(variance, 3, constant_values=np.nan)

    def at(image, dy, dx):
        return image[3 + dy : 3 + dy + value.shape[0], 3 + dx : 3 + dx + value.shape[1]]

    def alike(dy, dx):
        steps = [(y, x) for y in (-2, 0, 2) for x in (-2, 0, 2) if (y, x) != (0, 0)]
        return np.stack([at(np.pad(wide, 3, constant_values=np.nan), 3 + dy + y, 3 + dx + x) for y, x in steps])

    with warnings.catch_warnings(), np.errstate(invalid="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)
        brightest = np.nanmax(alike(0, 0), axis=0)
        own = value - brightest
        suspect = (own > 0) & (value > PEAK_RATIO * brightest) & (own > PEAK_SIGMA * np.sqrt(variance))
        excess, unsure = 0.0, 0.0
        for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            near = alike(dy, dx)
            middle = np.nanmedian(near, axis=0)
            excess = excess + np.abs(at(wide, dy, dx) - middle)
            unsure = unsure + ADJACENT_SIGMA**2 * at(spread, dy, dx)
            unsure = unsure + TEXTURE_SIGMA**2 * np.nanmean((near - middle) ** 2, axis=0)
        hot = suspect & ((excess + np.sqrt(unsure)) / 4 < ADJACENT_SHARE * own)
    inside = np.zeros(value.shape, bool)
    inside[FRAME_PX:-FRAME_PX, FRAME_PX:-FRAME_PX] = True
    return hot & inside
