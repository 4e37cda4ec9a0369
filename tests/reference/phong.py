"""Blinn-Phong by a general least-squares solver, from several starts: slow, and sure of itself."""

import numpy as np
from scipy.optimize import least_squares

STARTS = (3.0, 15.0, 80.0, 400.0)


def model(parameters, cos_light, cos_half):
    """f (m, 3) of [k_d (3), k_s (3), n]."""
    lobe = np.maximum(cos_half, 0.0) ** parameters[6]
    return cos_light[:, None] * parameters[:3] + lobe[:, None] * parameters[3:6]


def half_angle_sums(value, weights, cos_light, cos_half, count):
    """Sums (bin, 3, channel) of w, w N.L, w value by half angle: each sample shared by the two nearest bins."""
    share = np.maximum(1 - np.abs(np.arccos(cos_half)[:, None] / (np.pi / 2) * (count - 1) - np.arange(count)), 0)
    moments = np.stack([weights, weights * cos_light[:, None], weights * value], axis=1)
    return np.einsum("mb,mkc->bkc", share, moments)


def fit(value, cos_light, cos_half, sigma, bounds):
    """The best parameters (7,) of all starts and their cost."""
    scale = np.abs(value).max()

    def error(parameters):
        return ((model(parameters, cos_light, cos_half) - value) / sigma).ravel()

    low, high = np.array([0.0] * 6 + [bounds[0]]), np.array([np.inf] * 6 + [bounds[1]])
    starts = [np.array([scale / 2] * 6 + [min(n, 0.9 * bounds[1])]) for n in STARTS]
    fits = [least_squares(error, start, bounds=(low, high), x_scale="jac", max_nfev=400) for start in starts]
    best = min(fits, key=lambda one: one.cost)
    return best.x, 2 * best.cost
