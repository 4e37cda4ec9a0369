"""Scenes and brackets of the simulated camera of 8-bit pictures, whose curves are known."""

import io

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from simulators.picture import CURVES, PictureCamera

SENSITIVITY = 2.88  # a middle grey of 0.18 in one second at f/4: then a scene about 1 suits exposures about 1 s


INSIDE = slice(20, 236)  # codes of a curve that every method determines


def curve_rms(curve, truth):
    """Error of ln(exposure) over codes and channels; a factor per channel is free."""
    error = (curve - truth)[INSIDE]
    return float(np.sqrt(np.mean((error - error.mean(axis=0)) ** 2)))


def scene(seed=0, shape=(160, 240), decades=4.0):
    """Radiance about 1 (h, w, 3): smooth shading over some decades, blocks, colours, and texture in places."""
    rng = np.random.default_rng(seed)
    shading, texture, roughness, *colours = (
        gaussian_filter(rng.normal(size=shape), width) for width in (16, 2, 10, 12, 12, 12)
    )
    shading = (shading - shading.min()) / np.ptp(shading)
    log_radiance = np.log(10) * decades * shading
    log_radiance += 0.18 * np.clip(roughness / roughness.std(), 0, 2) * texture / texture.std()
    for _ in range(12):
        y, x = rng.integers(0, shape[0] - 30), rng.integers(0, shape[1] - 30)
        log_radiance[y : y + rng.integers(8, 30), x : x + rng.integers(8, 30)] += rng.normal(0, 1)
    tint = np.stack([colour / colour.std() * 0.25 for colour in colours], axis=-1)
    radiance = np.exp(log_radiance[..., None] + tint)
    return radiance / np.median(radiance)


def camera(curve="srgb", **settings):
    return PictureCamera(curve=curve, sensitivity=SENSITIVITY, **settings)


def bracket(shooter, radiance, times, *, coded=True, seed=0):
    """Codes (k, h, w, 3) of one bracket, as JPEG or before coding."""
    if not coded:
        return np.stack([shooter.develop(radiance, t, (seed, i)) for i, t in enumerate(times)])
    files = (shooter.photograph(radiance, t, (seed, i)) for i, t in enumerate(times))
    return np.stack([np.asarray(Image.open(io.BytesIO(content))) for content in files])


def true_value(shooter, radiance):
    """What the merge must find with exposures in seconds: 1 is the radiance that gives code 128 in one second."""
    x = np.linspace(0, 1, 200_001)
    middle = [np.interp(128 / 255, curve(x), x) for curve in CURVES[shooter.curve]]
    return radiance * shooter.sensitivity * shooter.iso / 100 / shooter.f_number**2 / middle
