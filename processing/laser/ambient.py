"""Ambient light that moves during a sweep: a lamp that is turned up, daylight, flicker of six frames and more.

Faster flicker is as unlike from frame to frame as noise (successive differences of a sine of period six have its
variance): it is left in the samples.
"""

import numpy as np
from numpy.typing import NDArray

from processing.laser.block_maxima import WINDOW

_SAMPLE = 256  # pixels that are followed; two bytes each per frame
_REACH = 4.5  # pulse widths from the brightest frame beyond which a pixel sees ambient light alone
_RUN = 8  # neighbours among them: fewer cache lines
_ALIKE = 1.0  # ratio of successive differences to variance (2 for noise) under which the light moves
_FAINT = 10.0  # deviations of a frame's sum below which its light is too little to be followed
_LEAST = 0.005  # relative movement that matters


def sampled_pixels(pixels: int) -> NDArray[np.intp]:
    """Indices (k,) of pixels spread over an image, in short runs."""
    if pixels <= _SAMPLE:
        return np.arange(pixels)
    starts = np.linspace(0, pixels - _RUN, _SAMPLE // _RUN).astype(np.intp)
    return (starts[:, None] + np.arange(_RUN)).reshape(-1)


def ambient_change(sample_dn: NDArray[np.uint16], black_dn: float, width_frames: float) -> NDArray[np.float32]:
    """Change (n,) of the ambient light relative to its mean, from followed pixels (n, k); empty where it is steady.

    Each frame's light is the sum over pixels which the stripe is far from, over the sum of their own means: so it does
    not matter where the stripe is. It moves if successive frames are more alike than their scatter (von Neumann 1941).
    Light that the noise of a frame's sum could hide counts as steady: next to nothing, it has no relative change.
    """
    steady = np.zeros(0, np.float32)
    light = sample_dn.astype(np.float64) - black_dn
    reach = max(WINDOW / 2, _REACH * width_frames)
    frame = np.arange(len(light))[:, None]
    ends = np.argmax(light, axis=0), len(light) - 1 - np.argmax(light[::-1], axis=0)  # a clipped pulse has many maxima
    away = (np.abs(frame - ends[0]) > reach) & (np.abs(frame - ends[1]) > reach)
    light *= away
    if not np.all(away.any(axis=1)) or light.sum() <= 0.0:
        return steady
    pairs = away[1:] & away[:-1]
    noise = np.sum(np.diff(light, axis=0)[pairs] ** 2) / max(2 * np.count_nonzero(pairs), 1)
    level = np.ones(len(light))
    for _ in range(2):
        typical = light.sum(axis=0) / np.maximum(level @ away, 1.0)
        expected = away @ typical
        if np.any(expected < _FAINT * np.sqrt(noise * away.sum(axis=1))):
            return steady
        level = light.sum(axis=1) / expected
        level /= level.mean()
    if np.var(level) < _LEAST**2 or np.mean(np.diff(level) ** 2) > _ALIKE * np.var(level):
        return steady
    return (level - 1.0).astype(np.float32)
