"""Plain NumPy twin of the merging kernel."""

import numpy as np
from scipy.special import erfc


def merge_exposures(raw_dn, exposure_s, sensor, iterations=60):
    """Value and variance (h, w) in float64: Fisher scoring on the censored shifted-Poisson likelihood."""
    t = np.asarray(exposure_s, np.float64)[:, None, None]
    y = (raw_dn.astype(np.float64) - sensor.black_dn) * sensor.gain_e_per_dn
    saturated = raw_dn >= sensor.white_dn
    valid = np.isfinite(y) & ~saturated
    y = np.where(valid, y, 0.0)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        r = y.sum(0) / (t * valid).sum(0)
        for _ in range(iterations):
            v = np.maximum(r * t, 0) + sensor.dark_variance_e2
            a = (sensor.saturation_e - r * t) / np.sqrt(v)
            near = np.clip(a, -8, 8)
            hazard = np.where(a > 8, a + 1 / a, np.sqrt(2 / np.pi) * np.exp(-(near**2) / 2) / erfc(near / np.sqrt(2)))
            hazard = np.where(a < -8, 0, hazard)
            pull = np.where(saturated, hazard * (1 / np.sqrt(v) + a / (2 * v)), 0)
            info = np.where(saturated, hazard * (hazard - a) / v, 0)
            score = (t * (np.where(valid, (y - r * t) / v, 0) + pull)).sum(0)
            information = (t**2 * (np.where(valid, 1 / v, 0) + info)).sum(0)
            r = r + score / information
    return r, 1 / information
