"""Plain NumPy twin of the merging kernel."""

import numpy as np
from scipy.special import erfcx


def merge_exposures(raw_dn, exposure_s, sensor, halvings=80):
    """Value and variance (h, w) in float64: the root of the censored likelihood's score, by bisection."""
    t = np.asarray(exposure_s, np.float64)[:, None, None]
    y = (raw_dn.astype(np.float64) - sensor.black_dn) * sensor.gain_e_per_dn
    saturated = raw_dn >= sensor.white_dn
    valid = np.isfinite(y) & ~saturated

    def score_and_information(r):
        v = np.maximum(r * t, 0) + sensor.dark_variance_e2
        a = (sensor.saturation_e - r * t) / np.sqrt(v)
        hazard = np.sqrt(2 / np.pi) / erfcx(a / np.sqrt(2))
        pull = hazard * (1 / np.sqrt(v) + a / (2 * v))
        score = np.where(valid, (y - r * t) / v, np.where(saturated, pull, 0))
        information = np.where(valid, 1 / v, np.where(saturated, hazard * (hazard - a) / v, 0))
        return (t * score).sum(0), (t**2 * information).sum(0)

    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        above = 2 * sensor.saturation_e + 100 * np.sqrt(sensor.dark_variance_e2)  # no 'at least' pulls from there
        low = np.where(valid, y / t, np.inf).min(0)
        high = np.maximum(np.where(valid, y / t, -np.inf).max(0), np.where(saturated, above / t, -np.inf).max(0))
        low, high = (np.where(valid.any(0), end, np.nan) for end in (low, high))
        for _ in range(halvings):
            middle = 0.5 * (low + high)
            rising = score_and_information(middle)[0] > 0
            low, high = np.where(rising, middle, low), np.where(rising, high, middle)
        return middle, 1 / score_and_information(middle)[1]
