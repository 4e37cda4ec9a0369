"""Other ways to find a laser stripe, in time (per pixel) and in space (per row of a frame), on frames (t, h, w) raw_dn.

Each in the best set-up that we found; the black level is known to all, and light that a pixel has all the time is taken
off before where a method asks for it.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeWarning, curve_fit

from processing.laser.ridge import stripe_ridge

SHARE = 0.2  # of the highest sample, over the background: where a centre of mass begins to count
LEAST_DN = 20.0  # five times the read noise and more: what is fainter is no stripe


@dataclass(frozen=True)
class Peer:
    """`find(frames, about)`: times (h, w) of a method in time, or columns (t, h) of one in space; NaN where none.

    `about`: the stripe's standard deviation, in frames and in pixels. A slow one looks at `share` of the pixels.
    """

    name: str
    find: Callable[[np.ndarray, tuple[float, float]], np.ndarray]
    settings: str
    in_space: bool = False
    slow: bool = False


def argmax(frames, _=None):
    """The frame of the highest sample."""
    return np.argmax(frames, axis=0).astype(float)


def parabola(frames, _=None):
    """The top of a parabola through the highest sample and its neighbours."""
    return _three_points(frames, lambda values: values)


def log_parabola(frames, _=None):
    """The same of the logarithms: exact for a Gaussian pulse without noise."""
    return _three_points(_signal(frames), lambda values: np.log(np.maximum(values, 1.0)))


def _three_points(values, change):
    top = np.clip(np.argmax(values, axis=0), 1, len(values) - 2)[None]
    before, at, after = (change(np.take_along_axis(values, top + k, 0)[0].astype(float)) for k in (-1, 0, 1))
    bend = before - 2 * at + after
    with np.errstate(divide="ignore", invalid="ignore"):
        return top[0] + np.where(bend < 0, np.clip(0.5 * (before - after) / bend, -1, 1), 0.0)


def centre_of_mass(frames, _=None):
    """Of all samples over a fifth of the highest."""
    return _centroid(_signal(frames), axis=0)


def blais_rioux(frames, about):
    """Where a filter of eight samples (four for narrow stripes) crosses zero beside the highest sample."""
    reach = 2 if about[0] < 1.2 else 4
    values = np.pad(frames.astype(float), ((reach, reach + 1), (0, 0), (0, 0)), mode="edge")
    count = len(frames)
    filtered = sum(values[reach + k : reach + k + count] - values[reach - k : reach - k + count] for k in _taps(reach))
    top = np.clip(np.argmax(frames, axis=0), 1, count - 2)[None]
    before, at, after = (np.take_along_axis(filtered, top + k, 0)[0] for k in (-1, 0, 1))
    later = at > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.where(later, at / (at - after), -1 + before / (before - at))
    return top[0] + np.where(np.isfinite(place), np.clip(place, -1, 1), 0.0)


def _taps(reach):
    return range(1, reach + 1)


def gauss_fit(frames, about):
    """scipy's curve_fit of height, time, width and background, unweighted, from the highest sample."""
    moments = np.arange(len(frames), dtype=float)
    found = np.full(frames.shape[1:], np.nan)
    for place in np.ndindex(*found.shape):
        profile = frames[:, *place].astype(float)
        start = (np.ptp(profile), float(np.argmax(profile)), about[0], np.median(profile))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OptimizeWarning)
            try:
                found[place] = curve_fit(_bell, moments, profile, start, maxfev=400)[0][1]
            except RuntimeError:
                continue
    return np.where((found >= 0) & (found <= moments[-1]), found, np.nan)


def _bell(t, height, middle, width, background):
    return height * np.exp(-0.5 * ((t - middle) / width) ** 2) + background


def row_centroid(frames, _=None):
    """Centre of mass of every row of every frame, over a fifth of its highest sample, as Horus and FreeLSS do."""
    return _centroid(_signal(frames), axis=2)


def row_ridge(frames, about):
    """The ridge after Steger 1998 of every row of every frame, filtered at the stripe's own width.

    All frames in one picture, each continued beyond its ends as far as the filter reaches.
    """
    _, height, width = frames.shape
    sigma_px = max(about[1], 0.7)
    margin = int(np.ceil(4 * sigma_px)) + 1
    sheet = np.pad(_signal(frames), ((0, 0), (margin, margin), (0, 0)), mode="edge")
    uv_px = stripe_ridge(sheet.reshape(-1, width), sigma_px, LEAST_DN / 2).uv_px
    found = np.full(sheet.shape[:2], np.nan)
    found[np.divmod(np.rint(uv_px[:, 1]).astype(int), sheet.shape[1])] = uv_px[:, 0]
    return found[:, margin : margin + height]


def _signal(frames):
    """Counts over what each pixel shows most of the time."""
    return frames - np.median(frames, axis=0)


def _centroid(values, axis):
    top = values.max(axis=axis, keepdims=True)
    weight = np.where(values > SHARE * top, values, 0.0)
    places = np.arange(values.shape[axis]).reshape([-1 if k == axis else 1 for k in range(3)])
    with np.errstate(divide="ignore", invalid="ignore"):
        middle = (weight * places).sum(axis=axis) / weight.sum(axis=axis)
    return np.where(np.squeeze(top, axis) > LEAST_DN, middle, np.nan)


PEERS = (
    Peer("argmax", argmax, "highest sample"),
    Peer("parabola", parabola, "three samples"),
    Peer("log-parabola", log_parabola, "three samples, background off"),
    Peer("centre of mass", centre_of_mass, f"samples over {SHARE:g} of the highest, background off"),
    Peer("Blais-Rioux", blais_rioux, "eight taps, four where the pulse is narrower than 1.2 frames"),
    Peer("curve_fit", gauss_fit, "Gaussian and background, unweighted", slow=True),
    Peer("row centroid", row_centroid, f"samples over {SHARE:g} of the row's highest", in_space=True),
    Peer("row ridge", row_ridge, "Steger, sigma that of the stripe", in_space=True),
)
