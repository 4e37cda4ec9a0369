"""A bracketed stack whose truth is known, and the smallest error that any unbiased merge of it can have.

12 bit, 4 e-/DN, black 256, read noise 4 e-; five exposures from 1/30 s to 2 s; radiance rises by 5.46 decades from the
left column to the right one, to just under saturation of the shortest exposure.
"""

from functools import cache

import numpy as np
from scipy.stats import norm, poisson

from processing.radiometry.sensor import Sensor

SENSOR = Sensor(black_dn=256.0, white_dn=4095.0, gain_e_per_dn=4.0, read_noise_e=4.0)
EXPOSURE_S = 60.0 ** (np.arange(5) / 4) / 30
DARKEST_E_S, BRIGHTEST_E_S = 1.5, 4.3e5


def ramp(width):
    """Radiance of the columns in electrons per second."""
    return np.geomspace(DARKEST_E_S, BRIGHTEST_E_S, width)


def photograph(rng, height, radiance):
    """Counts (k, height, width) of a scene whose columns have this radiance: Poisson, read noise, rounded, clipped."""
    stack = np.empty((len(EXPOSURE_S), height, len(radiance)), np.uint16)
    for frame, exposure_s in zip(stack, EXPOSURE_S, strict=True):
        electrons = rng.poisson(radiance * exposure_s, frame.shape).astype(np.float32)
        electrons += SENSOR.read_noise_e * rng.standard_normal(frame.shape, np.float32)
        frame[:] = np.clip(np.rint(SENSOR.black_dn + electrons / SENSOR.gain_e_per_dn), 0, SENSOR.white_dn)
    return stack


def bound_e_s(radiance):
    """Cramer-Rao standard deviation: from the exact Fisher information of the rounded and clipped counts."""
    mean_e, information = _information_table()
    exposed = EXPOSURE_S[:, None] * radiance
    per_frame = np.exp(np.interp(np.log(exposed), np.log(mean_e), np.log(information)))
    return (EXPOSURE_S[:, None] ** 2 * per_frame).sum(axis=0) ** -0.5


@cache
def _information_table():
    """Means in electrons, closest where a frame saturates, and the Fisher information about them in one sample."""
    full, spread = SENSOR.saturation_e, np.sqrt(SENSOR.saturation_e)
    shoulder = full + spread * np.linspace(-10, 10, 161)
    mean_e = np.concatenate([np.geomspace(0.01, shoulder[0] * 0.999, 240), shoulder, [shoulder[-1] * 1.01, 1e7]])
    return mean_e, np.array([max(_information(mean), 1e-30) for mean in mean_e])


def _information(mean_e):
    """Sum over all codes of (dP / dmean)^2 / P."""
    low, high = (int(mean_e + sign * (9 * np.sqrt(mean_e) + 12)) for sign in (-1, 1))
    electrons = np.arange(max(low, 0), high + 1)
    chance = poisson.pmf(electrons, mean_e)
    slope = chance * (electrons / mean_e - 1)
    reach = int(7 * SENSOR.read_noise_e)
    edges = np.arange(-reach, reach + 2) / SENSOR.read_noise_e
    # Chance that the signal with read noise lies in [n, n + 1), in electrons; then over the width of a code.
    signal = np.arange(electrons[0] - reach, electrons[-1] + reach + 1)
    code = np.floor(signal / SENSOR.gain_e_per_dn + 0.5).astype(int) + int(SENSOR.black_dn)
    code = np.clip(code, 0, int(SENSOR.white_dn))
    blurred = [np.bincount(code - code[0], np.convolve(part, np.diff(norm.cdf(edges)))) for part in (chance, slope)]
    likely = blurred[0] > 1e-30
    return float((blurred[1][likely] ** 2 / blurred[0][likely]).sum())
