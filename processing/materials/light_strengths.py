"""How strong each light of others' pictures was, from the pictures themselves."""

from dataclasses import replace

import numpy as np

from processing.errors import ImageError
from processing.materials.photometric_stereo import find_normals
from processing.products import LightStack
from processing.products.arrays import Float32, Float64

_PIXELS = 2000
_FEWEST = 20  # of them with a normal
_ROUNDS = 30
_SETTLED = 1e-3
_STEP = 1.5  # of the whole correction: normals follow the strengths, so that each round closes only part of the gap
_CURVED = 0.1  # RMS sine of the normals about their mean, both ways: a flat surface shows a strength as a tilt
_LEAST_LIGHTS = 6
_LIT = 0.3  # of the brightest light of a pixel: fainter ones tell a strength badly


def light_strengths(stack: LightStack) -> Float64:
    """Strength of each light (light,) relative to their geometric mean, for values that no white card was seen with.

    Normals that all lights but one explain tell how bright that one must be; medians over the surface, in turns with
    the normals. A curved surface under six lights or more, not all in a plane, determines them. Lights are distant.
    A few percent remain, because turns end before they reach what would fit best, on purpose: where lights stand in a
    narrow cone (under 40 deg about the view, up to 8 %), strengths and a tilt of the surface differ so little that the
    best fit to a real surface, which is never quite matt, is off by more. Lights equal to that are better left alone.
    Raises ImageError where lights are fewer, too little shows a matt surface under all of them, or it is flat.
    """
    if len(stack.light_directions) < _LEAST_LIGHTS:
        raise ImageError(f"strengths of {len(stack.light_directions)} lights: pictures tell those of six or more")
    pixels = _some_pixels(stack)
    strengths = np.ones(len(stack.light_directions))
    for _ in range(_ROUNDS):
        found = find_normals(divided(pixels, strengths))
        _check(found.normals[found.measured])
        grey = found.normals[found.measured] * found.albedo[found.measured].mean(axis=1, keepdims=True) / np.pi
        shown = pixels.reflectance_cos[:, found.measured].mean(axis=-1) / strengths[:, None]
        ratio = _ratios(shown, stack.light_directions @ grey.T)
        strengths *= ratio**_STEP
        strengths /= np.exp(np.log(strengths).mean())
        if np.abs(ratio - 1).max() < _SETTLED:
            break
    return strengths


def divided(stack: LightStack, strengths: Float64) -> LightStack:
    """The stack as if all lights were equally strong."""
    scale = strengths[:, None, None, None].astype(np.float32)
    return replace(stack, reflectance_cos=stack.reflectance_cos / scale, variance=stack.variance / scale**2)


def _some_pixels(stack: LightStack) -> LightStack:
    """A column of pixels that every light shows."""
    value, variance = (part.reshape(len(part), -1, 3) for part in (stack.reflectance_cos, stack.variance))
    whole = np.flatnonzero(np.isfinite(value).all(axis=(0, 2)))
    whole = whole[:: max(len(whole) // _PIXELS, 1)]
    distant = np.full(len(value), np.inf)
    value, variance = value[:, whole, None], variance[:, whole, None]
    return replace(stack, reflectance_cos=value, variance=variance, light_distances_m=distant)


def _check(normals: Float32) -> None:
    """Raises ImageError where normals (n, 3) are few or alike."""
    if len(normals) < _FEWEST:
        raise ImageError("the pictures do not tell how strong their lights are: too little of them is matt and lit")
    if np.linalg.eigvalsh(np.cov(normals[:, :2].T.astype(np.float64)))[0] < _CURVED**2:
        raise ImageError("the pictures do not tell how strong their lights are: what they show is nearly flat")


def _ratios(shown: Float64, model: Float64) -> Float64:
    """Median of what is seen over what is predicted (light, pixel), of samples that are well lit."""
    lit = (model > _LIT * model.max(axis=0)) & (shown > 0)
    ratios = np.where(lit, shown / np.where(lit, model, 1.0), np.nan)
    return np.array([np.median(ratio[np.isfinite(ratio)]) if np.isfinite(ratio).any() else 1.0 for ratio in ratios])
